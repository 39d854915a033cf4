"""Demonstrations for other people's learners, as Parquet or Minari: ``python -m pipelines.export_demos``.

``format=parquet`` writes ``transitions.parquet``, ``scenes.parquet`` and the card of the set; ``format=minari`` a data
set of ``visualrhp/ClutterManipulation-v0``, which Minari finds with ``MINARI_DATASETS_PATH=<the artefact>``. The
columns are in :mod:`visualrhp.learning.exports`.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from pipelines.app import app
from pipelines.config import ExportDemosConfig

STAGE = "export_demos"


@app(STAGE, ExportDemosConfig)
def main(config: ExportDemosConfig) -> None:
    export(config)


def export(config: ExportDemosConfig) -> Path:
    """Write the artefact; return its folder.

    Raises:
        ConfigError: Minari is not installed, or the name of the data set is none.
        DataError: the set is missing or damaged, of the other action space, or has nothing of that density.
    """
    from pipelines.work import publish
    from visualrhp.learning.demonstrations import DemonstrationSet
    from visualrhp.learning.exports import export_minari, export_parquet

    demonstrations = DemonstrationSet.open(config.demonstrations, config.action_space.name)
    target = Path(config.paths.artefact).absolute()
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as aside:
        folder = Path(aside) / "export"
        if config.format == "parquet":
            count = export_parquet(demonstrations, folder, config.num_objects)
            shutil.copyfile(Path(config.demonstrations) / "card.json", folder / "card.json")
        else:
            count = export_minari(demonstrations, folder, config.dataset_id, config.observation, config.num_objects)
        publish(folder, target)
    print(f"{count} demonstrations as {config.format} in {config.paths.artefact}")
    return target


if __name__ == "__main__":
    main()
