"""The camera's newest image, its time, and what becomes of it when the device fails."""

import time

import numpy as np
import pytest

from tests.embodiment.fake_ur import FakeCapture
from visualrhp.embodiment.opencv_camera import OpenCvCamera, OpenCvParameters
from visualrhp.errors import CellFault, ConfigError

SETTINGS = OpenCvParameters(width=64, height=48, latency_s=0.05, timeout_s=0.5)


def test_the_newest_image_is_rgb_with_the_time_of_its_exposure():
    capture = FakeCapture()
    camera = OpenCvCamera(SETTINGS, open_capture=lambda device: capture)
    time.sleep(0.1)
    before = time.monotonic()
    frame = camera.frame()
    assert frame.image.shape == (48, 64, 3) and frame.image.flags.c_contiguous
    assert frame.image[0, 0, 2] == 200, "blue is the last channel"
    assert 0.04 < before - frame.time_s < 0.15 and frame.image[0, 0, 0] > 3
    time.sleep(0.05)
    assert camera.frame().time_s > frame.time_s
    assert not np.array_equal(camera.frame().image, frame.image), "an image that was given does not change"
    camera.close()
    camera.close()
    assert capture.is_released


@pytest.mark.parametrize(
    ("capture", "words"),
    [
        (FakeCapture(fails_after=5), "gives no more images"),
        (FakeCapture(fails_after=5, error=RuntimeError("select timeout")), "select timeout"),
    ],
)
def test_a_device_that_fails_is_a_fault(capture, words):
    camera = OpenCvCamera(SETTINGS, open_capture=lambda device: capture)
    time.sleep(0.2)
    with pytest.raises(CellFault, match=words):
        camera.frame()
    camera.close()


@pytest.mark.parametrize(
    ("capture", "error", "words"),
    [
        (FakeCapture(is_open=False), ConfigError, "cannot be opened"),
        (FakeCapture(size=(32, 24)), ConfigError, "images of 32 x 24 px, not of 64 x 48"),
        (FakeCapture(fails_after=0), CellFault, "no more images"),
    ],
)
def test_a_device_that_cannot_be_used_is_named(capture, error, words):
    with pytest.raises(error, match=words):
        OpenCvCamera(SETTINGS, open_capture=lambda device: capture)
