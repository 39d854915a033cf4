"""Stand-ins for tkinter and for time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class FakeToolkit:
    """In place of tkinter: records what is shown.

    ``close_at`` is the picture at which the window is closed, ``lost_at`` that at which the display is lost.
    """

    class TclError(Exception):
        pass

    def __init__(self, close_at: int | None = None, lost_at: int | None = None) -> None:
        self.pictures: list[bytes] = []
        self.shown: list[Any] = []
        self.close_at, self.lost_at = close_at, lost_at
        self.destroyed = 0
        self.words = ""
        self._on_close: Callable[[], None] = lambda: None

    def Tk(self) -> FakeToolkit:
        return self

    def Label(self, root: Any, borderwidth: int) -> FakeToolkit:
        return self

    def PhotoImage(self, data: bytes, format: str) -> bytes:  # noqa: A002
        assert format == "PPM"
        self.pictures.append(data)
        return data

    def title(self, words: str) -> None:
        self.words = words

    def protocol(self, name: str, call: Callable[[], None]) -> None:
        assert name == "WM_DELETE_WINDOW"
        self._on_close = call

    def pack(self) -> None:
        pass

    def configure(self, image: Any) -> None:
        self.shown.append(image)

    def update(self) -> None:
        if len(self.shown) == self.lost_at:
            raise self.TclError("connection lost")
        if len(self.shown) == self.close_at:
            self._on_close()

    def destroy(self) -> None:
        self.destroyed += 1


class FakeTime:
    def __init__(self) -> None:
        self.now = 100.0

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
