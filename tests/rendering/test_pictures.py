import cv2
import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.rendering.pictures import encode_picture, write_picture

FRAME = np.zeros((8, 12, 3), np.uint8)
FRAME[2:5, 3:9] = (200, 100, 20)


def test_a_png_is_the_frame(tmp_path):
    write_picture(tmp_path / "new" / "frame.png", FRAME)
    read = cv2.imread(str(tmp_path / "new" / "frame.png"))
    assert read is not None
    np.testing.assert_array_equal(cv2.cvtColor(read, cv2.COLOR_BGR2RGB), FRAME)


def test_a_webp_is_nearly_the_frame():
    decoded = cv2.imdecode(np.frombuffer(encode_picture(FRAME, ".webp"), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None and decoded.shape == FRAME.shape
    assert abs(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB).astype(int) - FRAME).mean() < 20


def test_other_formats_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"\.png or \.webp, not as \.gif"):
        write_picture(tmp_path / "frame.gif", FRAME)
    assert not list(tmp_path.iterdir())
