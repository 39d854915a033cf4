"""A camera through OpenCV: a thread reads all its images, so that the newest one is never from a queue."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from visualrhp.embodiment.robot_cell import CameraFrame
from visualrhp.errors import CellFault, ConfigError
from visualrhp.parameters import Count, NonNegative, Positive, parameters


@parameters(kw_only=True)
class OpenCvParameters:
    """Parameters of the camera.

    Attributes:
        device: number of the camera, or a path or an address that OpenCV opens.
        width, height: of the images [px]; those with which it was calibrated.
        latency_s: from the exposure of an image to its arrival [s]: time stamps are those of arrival minus this. Rather
            too large, so that no image of a moving robot counts as one of a robot at rest.
        timeout_s: for the first image.
    """

    device: int | str = 0
    width: Count = 640
    height: Count = 480
    latency_s: NonNegative = 0.1
    timeout_s: Positive = 5.0


class OpenCvCamera:
    """The camera.

    Args:
        settings: see :class:`OpenCvParameters`.
        clock: of the cell [s].
        open_capture: opens the device; ``cv2.VideoCapture`` or an object that behaves like one.

    Raises:
        ConfigError: the device cannot be opened, or gives images of another size.
        CellFault: it gives no image.
    """

    def __init__(
        self,
        settings: OpenCvParameters | None = None,
        clock: Callable[[], float] = time.monotonic,
        open_capture: Callable[[int | str], Any] = lambda device: cv2.VideoCapture(device),
    ) -> None:
        self.settings = settings or OpenCvParameters()
        self._clock = clock
        self._capture = open_capture(self.settings.device)
        if not self._capture.isOpened():
            raise ConfigError(f"the camera {self.settings.device!r:.80} cannot be opened; OpenCV finds no such device")
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, self.settings.width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self.settings.height)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._lock = threading.Condition()
        self._newest: CameraFrame | None = None
        self._fault: str | None = None
        self._is_closed = False
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()
        with self._lock:
            self._lock.wait_for(lambda: self._newest or self._fault, self.settings.timeout_s)
        try:
            height, width = self.frame().image.shape[:2]
            if (width, height) != (self.settings.width, self.settings.height):
                raise ConfigError(
                    f"the camera {self.settings.device!r:.80} gives images of {width} x {height} px, not of "
                    f"{self.settings.width} x {self.settings.height}: set width and height, and calibrate with them"
                )
        except Exception:
            self.close()
            raise

    def frame(self) -> CameraFrame:
        """The newest image.

        Raises:
            CellFault: there is none.
        """
        with self._lock:
            if self._fault is not None:
                raise CellFault(f"the camera {self.settings.device!r:.80} {self._fault}")
            if self._newest is None:
                raise CellFault(
                    f"the camera {self.settings.device!r:.80} gave no image within {self.settings.timeout_s:g} s"
                )
            return self._newest

    def _read(self) -> None:
        while not self._is_closed:
            try:
                is_read, image = self._capture.read()
                problem, rgb = "gives no more images", None
                if is_read and image is not None:
                    rgb = np.ascontiguousarray(np.asarray(image)[..., ::-1])
            except Exception as error:  # of a driver
                problem, rgb = f"failed: {error!s:.200}", None
            with self._lock:
                if rgb is not None:
                    self._newest = CameraFrame(rgb, self._clock() - self.settings.latency_s)
                elif not self._is_closed:
                    self._fault = problem
                self._lock.notify_all()
                if self._fault is not None:
                    return

    def close(self) -> None:
        """Release the device; closing twice has no effect."""
        if not self._is_closed:
            self._is_closed = True
            self._thread.join(timeout=2.0)
            self._capture.release()
