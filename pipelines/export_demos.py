"""Export demonstrations as Parquet or Minari: ``python -m pipelines.export_demos``.

``format=parquet`` writes ``transitions.parquet``, ``scenes.parquet`` and the card of the set (columns:
:mod:`visualrhp.demonstrations.parquet`); ``format=minari`` writes a data set of ``visualrhp/ClutterManipulation-v0``,
which Minari finds with ``MINARI_DATASETS_PATH=<the artefact>``.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ExportDemosConfig

STAGE = "export_demos"


@app(STAGE)
def main(config: ExportDemosConfig) -> None:
    export(config)


def export(config: ExportDemosConfig) -> Path:
    """Write the artefact; return its folder.

    Raises:
        ConfigError: Minari is not installed, or the name of the data set is not valid.
        DataError: the set is missing or damaged, has the other action space, or has no demonstration with that number
            of objects.
    """
    from pipelines.workflow.artefacts import publish
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.demonstrations.minari import export_minari
    from visualrhp.demonstrations.parquet import export_parquet

    demonstrations = DemonstrationSet.open(config.demonstrations, config.action_space.name)
    target = Path(config.paths.artefact).absolute()
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as aside:
        folder = Path(aside) / "export"
        if config.format == "parquet":
            count = export_parquet(demonstrations, folder, config.num_objects)
            shutil.copyfile(Path(config.demonstrations) / "card.json", folder / "card.json")
        else:
            observation = config.observation.name
            count = export_minari(demonstrations, folder, config.dataset_id, observation, config.num_objects)
        publish(folder, target)
    print(f"{count} demonstrations as {config.format} in {config.paths.artefact}")
    return target


if __name__ == "__main__":
    main()
