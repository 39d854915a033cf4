"""Training curves and networks from folders."""

from pathlib import Path

import pandas as pd
import pytest

from visualrhp.errors import DataError
from visualrhp.evaluation.curves import read_curves, trained_networks


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
