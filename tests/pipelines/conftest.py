"""Networks for pipelines to load."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def untrained_heuristics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with networks for continuous actions: of images, and of Cartesian features for one and two objects."""
    import torch

    from visualrhp.heuristics.conversion import save_heuristic
    from visualrhp.heuristics.networks import make_network
    from visualrhp.observation import make_observation

    folder = tmp_path_factory.mktemp("heuristics")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        (folder / "continuous" / "image").mkdir(parents=True)
        (folder / "continuous" / "cartesian").mkdir()
        image = make_network("continuous", make_observation("image"))
        save_heuristic(folder / "continuous" / "image" / "heuristic.safetensors", image)
        for m in (1, 2):
            cartesian = make_network("continuous", make_observation("cartesian", m))
            save_heuristic(folder / "continuous" / "cartesian" / f"heuristic_m{m}.safetensors", cartesian)
    return folder
