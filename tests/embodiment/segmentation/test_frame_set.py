"""Sets of frames: what is written is read, and what was changed is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.embodiment.segmentation.painter import painted_frames
from visualrhp.embodiment.segmentation.frame_set import load_frame_set, read_card, write_card
from visualrhp.embodiment.segmentation.frames import write_frames
from visualrhp.errors import DataError

FRAMES = painted_frames(0, 5, 40)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    files = [tmp_path / "a.npz", tmp_path / "b.npz"]
    write_frames(files[0], FRAMES[:2])
    write_frames(files[1], FRAMES[2:])
    write_card(tmp_path, files, seed=3)
    return tmp_path


def test_a_set_is_read_in_order(folder: Path) -> None:
    np.testing.assert_array_equal(load_frame_set(folder).images, FRAMES.images)
    assert [entry.num_frames for entry in read_card(folder).files] == [2, 3]
    assert json.loads((folder / "card.json").read_text())["seed"] == 3


def test_the_hash_is_that_of_the_content(folder: Path) -> None:
    before = read_card(folder).content_hash
    write_card(folder, [folder / "a.npz"])
    assert read_card(folder).content_hash != before
    write_card(folder, [folder / "a.npz", folder / "b.npz"], seed=4)
    assert read_card(folder).content_hash == before


def test_a_file_that_was_replaced_is_refused(folder: Path) -> None:
    write_frames(folder / "b.npz", FRAMES[1:4])
    with pytest.raises(DataError, match=r"b\.npz.*not that which is on the card"):
        load_frame_set(folder)
    (folder / "b.npz").unlink()
    with pytest.raises(DataError, match=r"b\.npz does not exist"):
        load_frame_set(folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [("files", []), ("files", [{"file": "../a.npz", "num_frames": 2, "sha256": ""}]), ("content_hash", "0")],
)
def test_a_damaged_card_is_refused(folder: Path, key: str, value: object) -> None:
    content = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps(content | {key: value}))
    with pytest.raises(DataError, match=r"card\.json.*generate_frames"):
        read_card(folder)


def test_an_empty_folder_is_no_set(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"card\.json does not exist"):
        load_frame_set(tmp_path)
