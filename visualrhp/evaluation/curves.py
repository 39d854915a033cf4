"""Training curves and trained networks, read from the folders of trainings."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from visualrhp.errors import DataError


def read_curves(folder: Path) -> dict[str, pd.DataFrame]:
    """The training curves of the networks below ``folder`` (``<action space>/<observation>/curves.csv``), by name.

    Raises:
        DataError: a file is not a table of training curves.
    """
    curves = {}
    for path in sorted(folder.glob("*/*/curves.csv")):
        try:
            table = pd.read_csv(path)
            groups = list(table.groupby("network", sort=False))
        except (OSError, ValueError, KeyError) as error:
            raise DataError(f"{path} is not a table of training curves ({error}); rerun the training") from error
        space, observation = path.parent.parts[-2:]
        for network, rows in groups:
            names = (space, observation, str(network))
            curves[", ".join(dict.fromkeys(names))] = rows.dropna(axis="columns", how="all")
    return curves


def trained_networks(folder: Path) -> tuple[int, list[str]]:
    """How many networks have a card below ``folder``, and the folders that they are in ("continuous, image")."""
    cards = sorted(folder.glob("**/heuristic*.json"))
    return len(cards), sorted({", ".join(card.relative_to(folder).parent.parts) for card in cards})
