"""A window that shows frames as they come, made of what Python brings along (tkinter)."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from visualrhp.rendering.video import Frame


def has_screen(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> bool:
    """Whether a window can probably be shown: a display is named (or the system always has one), and tkinter is there.

    >>> has_screen({}, "linux")
    False
    """
    named = platform in ("darwin", "win32") or environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")
    return bool(named) and importlib.util.find_spec("tkinter") is not None


class Window:
    """Shows frames at the pace of a video. Once somebody closed it, it shows nothing more, and says so.

    Args:
        title: of the window.
        toolkit: ``tkinter``, or what behaves like it.
        clock: seconds, of no particular origin.
        sleep: waits for so many seconds.

    Raises:
        ConfigError: there is no tkinter, or it finds no display.
    """

    def __init__(
        self,
        title: str,
        toolkit: Any = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        from visualrhp.errors import ConfigError

        try:
            toolkit = toolkit or importlib.import_module("tkinter")
        except ImportError as error:
            raise ConfigError(
                "live=true needs tkinter, which this Python lacks (Debian: apt install python3-tk); live=false only "
                "writes the video"
            ) from error
        try:
            self._root = toolkit.Tk()
        except toolkit.TclError as error:
            raise ConfigError(f"live=true needs a screen ({error}); live=false only writes the video") from error
        self._toolkit = toolkit
        self._clock, self._sleep = clock, sleep
        self._due = -float("inf")
        self._root.title(title)
        self._root.protocol("WM_DELETE_WINDOW", self.close)
        self._label = toolkit.Label(self._root, borderwidth=0)
        self._label.pack()
        self._picture: Any = None
        self.is_open = True

    def show(self, frame: Frame, seconds: float) -> bool:
        """Show ``frame`` [H, W, 3] as soon as the previous one had its time; it will have at least ``seconds``.

        Returns:
            Whether the window is still open.
        """
        if not self.is_open:
            return False
        self._sleep(max(0.0, self._due - self._clock()))
        try:
            picture = self._toolkit.PhotoImage(data=ppm(frame), format="PPM")
            self._label.configure(image=picture)
            self._picture = picture  # tkinter does not keep it
            self._root.update()
        except self._toolkit.TclError:  # the screen went away: the video is still to be written
            self.is_open = False
        self._due = self._clock() + seconds
        return self.is_open

    def close(self) -> None:
        """Take the window away; closing twice does no harm."""
        if self.is_open:
            self.is_open = False
            self._root.destroy()


def ppm(frame: Frame) -> bytes:
    """A frame as a binary PPM picture."""
    height, width, _ = frame.shape
    return b"P6 %d %d 255 " % (width, height) + frame.tobytes()
