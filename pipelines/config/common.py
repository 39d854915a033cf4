"""Keys that all pipelines share."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from visualrhp.parameters import Count, Field, parameters
from visualrhp.types import ActionSpaceName

Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]
"""The seed of a run: what every library takes, and a column of integers."""


@parameters
class ActionSpaceConfig:
    """Group ``action_space``."""

    name: ActionSpaceName


@parameters
class PathsConfig:
    """Folders; paths are relative to the current folder (the root of the repository).

    Attributes:
        outputs: root of all artefacts.
        artefact: output folder of the pipeline.
        sweep: output folder of a job of a sweep; null for a folder named by the overrides of the job.
    """

    outputs: str
    artefact: str
    sweep: str | None

    def __post_init__(self) -> None:
        for name, path in (("outputs", self.outputs), ("artefact", self.artefact), ("sweep", self.sweep)):
            if path is not None and not path.strip():
                raise ValueError(f"{name} is empty: it should be the path of a folder.")


@parameters
class ExecutorConfig:
    """Group ``executor``: workers for the independent tasks of a stage; results do not depend on it.

    Attributes:
        name: ``loky`` (processes on this machine) or ``dask`` (a cluster).
        num_workers: number of tasks that run at the same time; null for all cores, 1 for the calling process (loky).
        address: of the scheduler of a Dask cluster.
    """

    name: Literal["loky", "dask"]
    num_workers: Count | None
    address: str | None

    def __post_init__(self) -> None:
        if self.name == "dask" and not self.address:
            raise ValueError(
                "address is missing: executor=dask needs the address of the scheduler, such as tcp://host:8786."
            )


@parameters
class TrackingConfig:
    """Group ``tracking``.

    Attributes:
        name: ``mlflow`` or ``none``.
        experiment: MLflow experiment of the runs.
        system_metrics: whether to record the load of the machine.
    """

    name: Literal["mlflow", "none"]
    experiment: str
    system_metrics: bool


@parameters
class PipelineConfig:
    """Keys that all pipelines share.

    Attributes:
        scale: group ``scale``: all budgets, which the primary files refer to.
        device: where networks are trained: ``cpu``, ``cuda``, ``cuda:<n>`` or ``mps``.
    """

    scale: dict[str, Any]
    seed: Seed
    action_space: ActionSpaceConfig
    device: str
    paths: PathsConfig
    executor: ExecutorConfig
    tracking: TrackingConfig

    def __post_init__(self) -> None:
        if not re.fullmatch(r"cpu|mps|cuda(:\d+)?", self.device):
            raise ValueError(f"device={self.device} is not known: it should be cpu, cuda, cuda:<number> or mps.")
