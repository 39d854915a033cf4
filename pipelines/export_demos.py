"""Export demonstrations as Parquet or Minari: ``python -m pipelines.export_demos``.

``format=parquet`` writes ``transitions.parquet``, ``scenes.parquet`` and the card of the set (columns:
:mod:`visualrhp.demonstrations.parquet`); ``format=minari`` writes a data set of ``visualrhp/ClutterManipulation-v0``,
which Minari finds with ``MINARI_DATASETS_PATH=<the artefact>``; data sets of other names are kept.
"""

from __future__ import annotations

import functools
import shutil
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
    from pipelines.workflow.publishing import check_destination, copy_artefacts, publish
    from pipelines.workflow.workspace import empty_folder, open_work, reserved_paths
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.demonstrations.minari import export_minari
    from visualrhp.demonstrations.parquet import export_parquet

    source = Path(config.demonstrations)
    card = DemonstrationSet.open(source, config.action_space.name).card
    folder = Path(config.paths.artefact).absolute()
    name = config.dataset_id if config.format == "minari" else ""
    num_objects = "all" if config.num_objects is None else config.num_objects
    identity = f"{config.format}, num_objects={num_objects}" + (f", {config.observation.name}" if name else "")
    check = functools.partial(check_destination, folder / name, STAGE, identity, reserved_paths(config))
    with open_work(config, STAGE, {"demonstrations": str(card["content_hash"])}, check) as work:
        copy = copy_artefacts(source, work / "inputs")
        demonstrations = DemonstrationSet.open(copy, config.action_space.name)
        made = empty_folder(work / "artefact")
        if config.format == "parquet":
            count = export_parquet(demonstrations, made, config.num_objects)
            shutil.copyfile(copy / "card.json", made / "card.json")
        else:
            observation = config.observation.name
            count = export_minari(demonstrations, made, config.dataset_id, observation, config.num_objects)
        publish(made / name, folder / name, STAGE, identity)
    print(f"{count} demonstrations as {config.format} in {config.paths.artefact}")
    return folder


if __name__ == "__main__":
    main()
