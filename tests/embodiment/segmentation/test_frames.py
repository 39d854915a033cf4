"""Frames: shrinking, sampled labels, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.embodiment.segmentation.painter import painted_frames
from visualrhp.embodiment.segmentation.frames import (
    LabelledFrames,
    Region,
    join,
    labelled_frame,
    network_input,
    read_frames,
    write_frames,
)
from visualrhp.errors import DataError


def test_the_region_is_the_largest_square_in_the_middle() -> None:
    assert Region.centred(480, 640) == Region(80, 0, 480)
    assert Region.centred(300, 200) == Region(0, 50, 200)
    image = np.arange(12).reshape(3, 4)
    assert Region(1, 0, 3).of(image).tolist() == [[1, 2, 3], [5, 6, 7], [9, 10, 11]]


def test_the_input_is_the_mean_of_the_pixels() -> None:
    generator = np.random.default_rng(0)
    image = generator.integers(256, size=(48, 64, 3)).astype(np.uint8)
    shrunk = network_input(image, Region.centred(48, 64), 24)
    part = image[:, 8:56].astype(float)
    mean = part.reshape(24, 2, 24, 2, 3).mean(axis=(1, 3))
    assert shrunk.shape == (24, 24, 3)
    assert np.abs(shrunk - mean).max() <= 0.5


def test_labels_are_sampled_within_their_pixel() -> None:
    """The mean over draws is the coverage of the pixel: here a vertical edge at 5 of 8 columns."""
    instances = np.zeros((32, 32), np.uint8)
    instances[:, :13] = 2
    image = np.zeros((32, 32, 3), np.uint8)
    generator = np.random.default_rng(1)
    drawn = np.mean(
        [labelled_frame(image, instances, [4], Region(0, 0, 32), generator, 4).instances[0] == 2 for _ in range(400)],
        axis=0,
    )
    assert (drawn[:, 0] == 1.0).all() and (drawn[:, 2:] == 0.0).all()
    assert drawn[:, 1] == pytest.approx(5 / 8, abs=0.1)


def test_objects_that_are_not_on_the_table_are_background() -> None:
    instances = np.full((8, 8), 3, np.uint8)
    instances[:4] = 2
    frame = labelled_frame(
        np.zeros((8, 8, 3), np.uint8), instances, [0, 5], Region(0, 0, 8), np.random.default_rng(0), 8
    )
    assert (frame.instances[0, :4] == 0).all() and (frame.instances[0, 4:] == 3).all()
    assert (frame.labels()[0, 4:] == 5).all() and (frame.labels()[0, :4] == 0).all()


def test_too_many_objects_are_refused() -> None:
    image, instances = np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8), np.uint8)
    with pytest.raises(ValueError, match="17 objects; at most 16"):
        labelled_frame(image, instances, [4] * 17, Region(0, 0, 8), np.random.default_rng(0), 8)


def test_files_round_trip_and_equal_frames_give_equal_bytes(tmp_path: Path) -> None:
    frames = painted_frames(0, 5)
    write_frames(tmp_path / "a.npz", frames)
    write_frames(tmp_path / "b.npz", frames)
    found = read_frames(tmp_path / "a.npz")
    for name in ("images", "instances", "classes"):
        np.testing.assert_array_equal(getattr(found, name), getattr(frames, name))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x03\x04 cut off"])
def test_damaged_files_are_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "frames.npz"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"frames\.npz .*damaged.*generate_frames"):
        read_frames(path)
    with pytest.raises(DataError, match="does not exist"):
        read_frames(tmp_path / "none.npz")


def test_a_file_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    write_frames(tmp_path / "whole.npz", painted_frames(0, 1, 40))
    content = (tmp_path / "whole.npz").read_bytes()
    for stop in np.linspace(1, len(content) - 1, 12).astype(int):
        (tmp_path / "cut.npz").write_bytes(content[:stop])
        with pytest.raises(DataError, match=r"cut\.npz"):
            read_frames(tmp_path / "cut.npz")


def test_arrays_that_do_not_match_are_refused() -> None:
    frames = painted_frames(0, 2, 40)
    for change in (
        {"instances": frames.instances[:1]},
        {"images": frames.images.astype(np.float32)},
        {"classes": np.full_like(frames.classes, 1)},
        {"classes": np.full_like(frames.classes, 9)},
        {"instances": np.full_like(frames.instances, 18)},
    ):
        with pytest.raises(ValueError, match=next(iter(change))):
            replace(frames, **change)


def test_parts_are_joined_in_order() -> None:
    frames = painted_frames(0, 4, 40)
    again = join([frames[:1], frames[1:]])
    assert len(again) == 4 and isinstance(again, LabelledFrames)
    np.testing.assert_array_equal(again.images, frames.images)
