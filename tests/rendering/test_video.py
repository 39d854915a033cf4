import numpy as np
import pytest

from visualrhp.errors import ConfigError, DataError
from visualrhp.rendering.video import read_video, side_by_side, write_video


def moving_square(count=5, height=40, width=56):
    frames = np.full((count, height, width, 3), (30, 90, 200), dtype=np.uint8)
    for index, frame in enumerate(frames):
        frame[8:24, 4 * index : 4 * index + 16] = (240, 200, 20)
    return list(frames)


def test_the_frames_written_are_the_frames_read(tmp_path):
    frames = moving_square()
    assert write_video(tmp_path / "deep" / "a.webm", frames, fps=7.0) == len(frames)
    decoded = read_video(tmp_path / "deep" / "a.webm")
    assert len(decoded) == len(frames)
    for written, read in zip(frames, decoded, strict=True):
        assert read.shape == written.shape
        assert np.abs(read.astype(int) - written).mean() < 6.0
        assert np.abs(read[12:20, :2].astype(int) - written[12:20, :2]).mean() < 25.0
    assert b"V_VP8" in (tmp_path / "deep" / "a.webm").read_bytes()


def test_the_same_frames_give_the_same_bytes_and_other_frames_do_not(tmp_path):
    for name, frames in (("a", moving_square()), ("b", moving_square()), ("c", moving_square()[::-1])):
        write_video(tmp_path / f"{name}.webm", frames)
    a, b, c = ((tmp_path / f"{name}.webm").read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_an_odd_size_is_padded_to_an_even_one(tmp_path):
    write_video(tmp_path / "odd.webm", moving_square(height=41, width=55))
    assert read_video(tmp_path / "odd.webm")[0].shape == (42, 56, 3)


def test_writing_prints_nothing(tmp_path, capfd):
    write_video(tmp_path / "quiet.webm", moving_square())
    assert capfd.readouterr() == ("", "")


def test_bad_input_is_refused_and_leaves_no_file(tmp_path):
    with pytest.raises(ConfigError, match=r"\.webm"):
        write_video(tmp_path / "a.mp4", moving_square())
    with pytest.raises(ConfigError, match="fps=0"):
        write_video(tmp_path / "a.webm", moving_square(), fps=0)
    with pytest.raises(DataError, match="at least one frame"):
        write_video(tmp_path / "a.webm", [])
    with pytest.raises(DataError, match=r"of one size"):
        write_video(tmp_path / "a.webm", [*moving_square(), *moving_square(height=44)])
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "broken.webm").write_bytes(b"no video")
    for name in ("broken.webm", "missing.webm"):
        with pytest.raises(DataError, match=name):
            read_video(tmp_path / name)


def test_a_grid_holds_the_last_frame_of_shorter_videos():
    long = [np.full((4, 6, 3), value, np.uint8) for value in (10, 11, 12)]
    short = [np.full((4, 6, 3), 20, np.uint8)]
    grid = list(side_by_side([long, short, short], columns=2, gap=2, background=99))
    assert [frame.shape for frame in grid] == [(10, 14, 3)] * 3
    assert [int(frame[0, 0, 0]) for frame in grid] == [10, 11, 12]
    assert all((frame[:4, 8:] == 20).all() and (frame[6:, :6] == 20).all() for frame in grid)
    assert all((frame[:, 6:8] == 99).all() and (frame[6:, 8:] == 99).all() for frame in grid)
    with pytest.raises(DataError, match="one size"):
        next(side_by_side([long, [np.zeros((5, 6, 3), np.uint8)]]))
    with pytest.raises(DataError, match="at least one"):
        next(side_by_side([long, []]))
    with pytest.raises(ConfigError, match="columns=0"):
        next(side_by_side([long], columns=0))
