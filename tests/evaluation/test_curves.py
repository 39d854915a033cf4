"""Training curves and networks from folders."""

import os
from pathlib import Path

import pandas as pd
import pytest

from visualrhp.errors import DataError
from visualrhp.evaluation.curves import read_curve_table, read_curves, trained_networks


def test_curves_are_named_by_action_space_observation_and_network(tmp_path: Path):
    for name, networks in (("continuous/image", ["image"]), ("discrete/cartesian", ["m=1", "m=4"])):
        (tmp_path / name).mkdir(parents=True)
        rows = [{"network": network, "epoch": epoch, "loss": 0.5} for network in networks for epoch in (0, 1)]
        pd.DataFrame(rows).assign(empty=None).to_csv(tmp_path / name / "curves.csv", index=False)
    curves = read_curves(tmp_path)
    assert list(curves) == ["continuous, image", "discrete, cartesian, m=1", "discrete, cartesian, m=4"]
    assert curves["continuous, image"]["epoch"].tolist() == [0, 1]
    assert "empty" not in curves["continuous, image"].columns


def test_a_file_of_something_else_is_named(tmp_path: Path):
    path = tmp_path / "continuous" / "image" / "curves.csv"
    path.parent.mkdir(parents=True)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match=r"curves\.csv is not a table of training curves"):
        read_curves(tmp_path)


def test_networks_are_counted_by_their_cards(tmp_path: Path):
    assert trained_networks(tmp_path) == (0, [])
    for name in ("continuous/image/heuristic", "discrete/cartesian/heuristic_m1", "discrete/cartesian/heuristic_m4"):
        path = tmp_path / f"{name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("{}")
    assert trained_networks(tmp_path) == (3, ["continuous, image", "discrete, cartesian"])


def refused(path: Path, words: str, *required: str):
    with pytest.raises(DataError, match=words) as caught:
        read_curve_table(path, *required)
    message = str(caught.value)
    assert "curves.csv" in message and "rerun the training" in message and len(message) < 2000 and "\n" not in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "0 bytes"),
        ("\n", "not a table of training curves"),
        ("network,epoch\n", "it has no rows"),
        ("network,epoch\nimage,1", "its last line was cut short"),
        ("epoch\n1\n", "it lacks the columns network"),
        ("network,epoch\nimage,many\n", "the column epoch has values that are not numbers"),
        ("network,epoch\nimage,True\n", "the column epoch has values that are not numbers"),
        ("network,epoch\nimage,1\n,2\n", "the column network has missing values"),
        ("network,epoch\nimage,inf\n", "the column epoch has infinite numbers"),
        ("network,epoch\nimage,1e999\n", "the column epoch has infinite numbers"),
        ("network,epoch\nimage,1,2\n", "more fields"),
        ("network,epoch\nimage,1\nimage,1,2\n", "not a table of training curves"),
        ("{}\n", "it lacks the columns network"),
        ('network,epoch\n"image,1\n', "not a table of training curves"),
        ("\0\0\0\n", "not a table of training curves"),
        ("network," + "x" * 5000 + "\nimage,a\n", "values that are not numbers"),
    ],
)
def test_what_is_no_table_is_named(tmp_path: Path, content: str, words: str):
    path = tmp_path / "curves.csv"
    path.write_text(content)
    refused(path, words, "network")


def test_what_cannot_be_read_is_named(tmp_path: Path):
    path = tmp_path / "continuous" / "image" / "curves.csv"
    refused(path, "does not exist")
    path.mkdir(parents=True)
    refused(path, "is a folder")
    with pytest.raises(DataError, match=r"curves\.csv is a folder"):
        read_curves(tmp_path)
    path.rmdir()
    path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(DataError, match=r"curves\.csv is a link to .*, which does not exist"):
        read_curves(tmp_path)
    path.unlink()
    os.mkfifo(path)
    refused(path, "not a regular file")
    path.unlink()
    path.write_bytes(b"network,epoch\nimage,\xff\n")
    refused(path, "not a table of training curves")
