"""The settings of an evaluation: composed from the command line and a suite, and checked before any work starts."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.config import EvaluateConfig, suite_overrides
from pipelines.networks import NetworkFile
from pipelines.workflow.app import command_line_overrides, compose, override_keys

if TYPE_CHECKING:
    from visualrhp.evaluation.episodes import Setting

_log = logging.getLogger(__name__)

_SINGLE = "single"


@dataclass(frozen=True)
class Point:
    """One setting: a planner on the first ``config.num_episodes`` task instances of a distribution.

    Attributes:
        experiment: name of its block in the suite.
        config: the complete configuration, without a suite.
        episodes: indices of the task instances that can be run.
        skipped: indices of those without a network for their number of objects (CartesianRHP, Sec. 7.5).
        networks: number of objects -> its network.
    """

    experiment: str
    config: EvaluateConfig
    episodes: tuple[int, ...] = ()
    skipped: tuple[int, ...] = ()
    networks: Mapping[int, NetworkFile] = field(default_factory=dict, repr=False)

    @cached_property
    def identity(self) -> str:
        """A text that is equal for settings with equal results, regardless of the number of episodes."""
        from pipelines.workflow.artefacts import content_hash, result_config

        return content_hash(result_config(self.config) | {"num_episodes": None, "suite": None})[:16]

    @cached_property
    def cell(self) -> str:
        """A hash of all that the results of a prepared point depend on: the content of networks, not their place."""
        from pipelines.workflow.artefacts import code_hash, content_hash, result_config_without_locations

        config = result_config_without_locations(self.config)
        config |= {"num_episodes": None, "suite": None, "heuristics": None, "reuse": None}
        networks = {str(m): file.sha256 for m, file in self.networks.items()}
        return content_hash({"config": config, "networks": networks, "code": code_hash()})[:16]

    @property
    def setting(self) -> Setting:
        """The columns of the setting in the table of episodes."""
        from visualrhp.evaluation.episodes import Setting

        config = self.config
        return Setting.of(
            self.experiment, config.planner, config.action_space.name, config.scene, config.noise_level, config.seed
        )

    @property
    def card(self) -> dict[str, Any]:
        """The entry of the setting on the card of the evaluation."""
        return asdict(self.setting) | {
            "num_episodes": len(self.episodes),
            "num_skipped": len(self.skipped),
            "planner_config": asdict(self.config.planner),
            "scene": asdict(self.config.scene),
            "physics": asdict(self.config.physics),
            "heuristics": self.config.heuristics,
        }


def compose_points(config: EvaluateConfig) -> list[Point]:
    """Compose the settings to evaluate: that of ``config``, or those of its suite.

    The settings of a suite are composed from the overrides of the command line and their own, which take precedence.
    Settings that differ only in the number of episodes are merged into one with the larger number, so that no episode
    counts twice.

    Raises:
        ConfigError: a setting of the suite is invalid.
    """
    if config.suite is None:
        return [Point(_SINGLE, config)]
    given = [override for override in command_line_overrides() if override_keys([override]) - {"suite"}]
    points: dict[str, Point] = {}
    for experiment, block in config.suite.items():
        for overrides in suite_overrides({experiment: block}):
            keys = override_keys(overrides)
            kept = [override for override in given if not override_keys([override]) & keys]
            composed = compose("evaluate", EvaluateConfig, [*kept, *overrides])
            touched = {key.partition(".")[0] for key in keys} | {"suite"}
            untouched = {item.name: getattr(config, item.name) for item in fields(config) if item.name not in touched}
            point = Point(experiment, replace(composed, **untouched, suite=None))
            known = points.get(point.identity)
            if known is None:
                points[point.identity] = point
            elif point.config.num_episodes > known.config.num_episodes:
                points[point.identity] = replace(known, config=point.config)
    return list(points.values())


def prepare(points: Sequence[Point]) -> list[Point]:
    """Determine the episodes that can be run, and read the networks, after building each planner once as a check.

    Raises:
        CheckpointError: a network is missing or damaged, or has another action space or observation. A missing network
            for one number of objects (CartesianRHP) is an error only if no other setting remains; otherwise such
            episodes are skipped.
        ConfigError: a parameter is out of range.
        DataError: no episode can be run.
    """
    from visualrhp.errors import DataError

    read: dict[Path, NetworkFile] = {}
    prepared = [_prepare(point, read, is_only=len(points) == 1) for point in points]
    if not any(point.episodes for point in prepared):
        raise DataError(
            "nothing can be evaluated: no setting has an episode with a network for its number of objects; train one "
            "with python -m pipelines.train_il observation=cartesian, or change the suite"
        )
    return prepared


def _prepare(point: Point, read: dict[Path, NetworkFile], is_only: bool) -> Point:
    """``read`` has the networks of other points, and gets those of this one."""
    from pipelines.planners import build_planner, find_network, fixes_num_objects, needed_network, network_name
    from visualrhp.scene.sampling import sampled_num_objects
    from visualrhp.streams import Split

    config = point.config
    planner, space, heuristics = config.planner, config.action_space.name, config.heuristics
    low, high = config.scene.num_objects
    networks = {m: needed_network(planner, space, heuristics, m) for m in range(low, high + 1)}
    missing = [m for m, path in networks.items() if path is not None and not os.path.lexists(path)]
    if len(missing) == len(networks) and (is_only or not fixes_num_objects(planner)):
        find_network(planner, space, heuristics, low)  # its error names the missing file
    found: dict[int, NetworkFile] = {}
    for m, path in networks.items():
        if m in missing:
            continue
        build_planner(planner, space, m, path)
        if path is not None:
            if path not in read:
                read[path] = NetworkFile.read(path, network_name(path, config.paths.outputs, heuristics))
            found[m] = read[path]
    indices = range(config.num_episodes)
    skipped: set[int] = set()
    if missing:
        skipped = {
            index
            for index in indices
            if len(missing) == len(networks)
            or sampled_num_objects(config.scene, config.seed, Split.EVALUATION, index) in missing
        }
        _log.warning(
            "%s (%s) has no network for %s objects: %d of %d episodes are skipped.",
            planner.name,
            space,
            ", ".join(str(m) for m in missing),
            len(skipped),
            config.num_episodes,
        )
    kept = tuple(index for index in indices if index not in skipped)
    return replace(point, episodes=kept, skipped=tuple(sorted(skipped)), networks=found)


def network_hashes(points: Sequence[Point]) -> dict[str, str]:
    """SHA-256 of every network of prepared points, by name."""
    return dict(sorted({file.name: file.sha256 for point in points for file in point.networks.values()}.items()))
