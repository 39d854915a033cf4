"""A window that shows frames live, with tkinter of the standard library."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

from visualrhp.errors import ConfigError
from visualrhp.rendering.video import Frame


def has_screen(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> bool:
    """Whether a window can probably be shown: there is a display, and tkinter is installed.

    >>> has_screen({}, "linux")
    False
    """
    named = platform in ("darwin", "win32") or environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")
    return bool(named) and importlib.util.find_spec("tkinter") is not None


class Window:
    """Shows frames at the pace of a video, until it is closed.

    Args:
        title: of the window.
        toolkit: ``tkinter``, or an equivalent.
        clock: returns the time [s].
        sleep: waits for a number of seconds.

    Raises:
        ConfigError: tkinter is missing, or finds no display.
    """

    def __init__(
        self,
        title: str,
        toolkit: Any = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        try:
            toolkit = toolkit or importlib.import_module("tkinter")
        except ImportError as error:
            raise ConfigError(
                "live=true needs tkinter, which this Python lacks (Debian: apt install python3-tk); live=false "
                "writes only the video"
            ) from error
        try:
            self._root = toolkit.Tk()
        except toolkit.TclError as error:
            raise ConfigError(f"live=true needs a screen ({error}); live=false writes only the video") from error
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
        """Show ``frame`` [H, W, 3] for at least ``seconds``, after the previous one has been shown for its duration.

        Returns:
            Whether the window is still open.
        """
        if not self.is_open:
            return False
        self._sleep(max(0.0, self._due - self._clock()))
        try:
            picture = self._toolkit.PhotoImage(data=ppm(frame), format="PPM")
            self._label.configure(image=picture)
            self._picture = picture  # tkinter does not keep a reference
            self._root.update()
        except self._toolkit.TclError:  # the display has closed; the video is still written
            self.is_open = False
        self._due = self._clock() + seconds
        return self.is_open

    def close(self) -> None:
        """Close the window; closing twice has no effect."""
        if self.is_open:
            self.is_open = False
            self._root.destroy()


def ppm(frame: Frame) -> bytes:
    """Encode a frame as a binary PPM picture."""
    height, width, _ = frame.shape
    return b"P6 %d %d 255 " % (width, height) + frame.tobytes()
