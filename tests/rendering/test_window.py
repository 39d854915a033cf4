"""A window shows frames as they are, at the pace of a video, until it is closed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.rendering.fake_window import FakeTime, FakeToolkit
from visualrhp.rendering.window import Window, has_screen, ppm


def test_a_frame_is_shown_as_it_is() -> None:
    frame = np.random.default_rng(0).integers(0, 256, (20, 31, 3), dtype=np.uint8)
    read = cv2.imdecode(np.frombuffer(ppm(frame), dtype=np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(read[..., ::-1], frame)


def test_frames_are_shown_at_the_pace_of_the_video() -> None:
    toolkit, passing = FakeToolkit(), FakeTime()
    window = Window("words", toolkit, passing.clock, passing.sleep)
    frame = np.zeros((2, 2, 3), dtype=np.uint8)
    for _ in range(4):
        assert window.show(frame, 0.25)
    assert toolkit.words == "words"
    assert passing.now == pytest.approx(100.75)  # the first one at once
    passing.now += 2.0  # the planner took its time
    window.show(frame, 0.25)
    assert passing.now == pytest.approx(102.75)
    window.close()
    window.close()
    assert toolkit.destroyed == 1


@pytest.mark.parametrize(
    ("environment", "platform", "expected"),
    [
        ({}, "linux", False),
        ({"DISPLAY": ""}, "linux", False),
        ({"DISPLAY": ":0"}, "linux", True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "linux", True),
        ({}, "darwin", True),
    ],
)
def test_where_a_screen_is(
    environment: dict[str, str], platform: str, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("visualrhp.rendering.window.importlib.util.find_spec", lambda name: object())
    assert has_screen(environment, platform) is expected
    monkeypatch.setattr("visualrhp.rendering.window.importlib.util.find_spec", lambda name: None)
    assert has_screen(environment, platform) is False
