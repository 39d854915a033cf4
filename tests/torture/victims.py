"""The files that :mod:`tests.torture.damage` damages: a small valid one of every kind, and how it is read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from tests.evaluation.samples import evaluation_card, report_table, sample_result
from tests.torture.contents import array_changes, journal_changes, json_changes, table_changes, tensor_changes
from visualrhp.demonstrations import blocks
from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.generate import generate_block
from visualrhp.demonstrations.shards import write_arrays
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.evaluation.curves import read_curves
from visualrhp.evaluation.episodes import EpisodeRow, episode_row, read_evaluation, write_episodes
from visualrhp.evaluation.journal import Journal
from visualrhp.evaluation.report_content import page_content
from visualrhp.evaluation.report_figures import sweep_figures
from visualrhp.evaluation.report_tables import detail_tables, main_table
from visualrhp.evaluation.sweeps import demonstration_batches, stability_trials
from visualrhp.evaluation.weight_search import TrialEpisode
from visualrhp.files import write_json
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.heuristics.conversion import load_network, save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.learning.expert_episodes import read_block, write_block
from visualrhp.learning.history import ImitationProgress, RoundHistory, read_history, read_summary
from visualrhp.learning.training_state import load_training_state, save_training_state
from visualrhp.observation import make_observation
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.scene.scene_file import load_task_instance, save_task_instance
from visualrhp.streams import Split

Change = Callable[[Path, bytes, np.random.Generator, Path], Any]
SCENES = SceneDistribution(num_objects=(1, 2))


@dataclass(frozen=True)
class Victim:
    """A file to damage.

    Attributes:
        name: of the kind.
        path: of the file.
        read: reads it as the library does, and uses what was read; equal results for equal content.
        changes: ways to write another content that is well-formed, by name.
        fatal: names of the changes after which the file cannot be used.
        has_checksum: every bit that is read is protected by a checksum.
        may_be_empty: a file without content is as good as none.
        lists_faults: the message has a line for each fault.
    """

    name: str
    path: Path
    read: Callable[[], Any]
    changes: Sequence[tuple[str, Change]] = ()
    fatal: frozenset[str] = frozenset()
    has_checksum: bool = False
    may_be_empty: bool = False
    lists_faults: bool = False


def make_victims(place: Path) -> list[Victim]:
    """Make a valid file of every kind in ``place``."""
    return [*_networks(place), *_states(place), *_demonstrations(place), *_evaluations(place), *_work_files(place)]


def _victim(name: str, path: Path, read: Callable[[], Any], changes: Any = ((), ()), **others: Any) -> Victim:
    every, fatal = changes
    return Victim(name, path, read, tuple(every), frozenset(fatal), **others)


def _networks(place: Path) -> Iterator[Victim]:
    torch.manual_seed(0)
    scene = sample_task_instance(SceneDistribution(num_objects=2), 0, Split.TUNING, 0)
    required = ("action_space", "observation", "num_objects", "card", "format")
    for space, name in (("discrete", "cartesian"), ("continuous", "image")):
        path = place / f"{space}_{name}" / "heuristic.safetensors"
        observation = make_observation(name, 2 if name == "cartesian" else None)
        save_heuristic(path, make_network(space, observation), {"seed": 0, "config": {"lr": 0.1}, "metrics": {}})

        def guided(path: Path = path, space: Any = space, observation: Any = observation) -> Any:
            guidance = load_heuristic(path, space, expect_observation=observation).guide([scene.scene], [scene.state])
            return _digest(guidance.values, guidance.mode()[0])

        def loaded(path: Path = path, space: Any = space) -> Any:
            network, card = load_network(path, space)
            return _digest(*network.state_dict().values()), dict(card)

        changes = tensor_changes(required, is_network=True)
        yield _victim(f"network ({space}, {name})", path, guided, changes, has_checksum=True)
        yield _victim(f"network in torch ({space}, {name})", path, loaded, changes, has_checksum=True)


def _states(place: Path) -> Iterator[Victim]:
    path = place / "state.safetensors"

    def parts(seed: int) -> dict[str, Any]:
        torch.manual_seed(seed)
        network = torch.nn.Linear(3, 2)
        optimizer = torch.optim.Adam(network.parameters(), lr=0.01)
        network(torch.ones(1, 3)).sum().backward()
        optimizer.step()
        noise = torch.Generator().manual_seed(seed)
        return {"network": network, "optimizer": optimizer, "noise": noise, "order": np.random.default_rng(seed)}

    history = [{"epoch": 1.0, "loss": 0.5}, {"epoch": 2.0, "loss": 0.25}]
    save_training_state(path, {**parts(0), "epoch": 2, "history": history, "array": np.arange(3)})

    def read() -> Any:
        training = parts(1)
        values = load_training_state(path, training, ImitationProgress)
        network, optimizer, noise, order = training.values()
        network(torch.rand(1, 3, generator=noise)).sum().backward()
        optimizer.step()
        return _digest(*network.state_dict().values()), float(order.random()), str(values)

    required = ("network", "optimizer", "noise", "order", "epoch", "history")
    yield _victim("training state", path, read, tensor_changes(required), has_checksum=True)


def _demonstrations(place: Path) -> Iterator[Victim]:
    arrays = generate_block(range(8), SCENES, "discrete", KinodynamicRRT(max_simulations=400), 3)
    folder = place / "demonstrations"
    writer = DemonstrationWriter(folder, "discrete", 4, shard_size=2)
    writer.add(arrays)
    writer.finish(seed=3, config={"physics": {}})

    def read() -> Any:
        stored = DemonstrationSet.open(folder, "discrete")
        episodes = [(task.scene.target.radius, episode.rewards, episode.actions) for task, episode in stored]
        return episodes, stored.num_transitions, stored.lengths.tolist(), stored.returns().tolist()

    required = ("kind", "format", "action_space", "num_demonstrations", "num_transitions", "shards", "content_hash")
    yield _victim("shard", folder / "shard-00001.npz", read, array_changes(every_is_fatal=True), has_checksum=True)
    yield _victim("card of demonstrations", folder / "card.json", read, json_changes(required))

    block = place / "block-000000.npz"
    write_arrays(block, arrays)

    def read_attempts() -> Any:
        found = blocks.read_attempts(block)
        return _digest(*(found[name] for name in sorted(arrays)))

    yield _victim("block of attempts", block, read_attempts, array_changes(), has_checksum=True)
    expert = place / "block_00000000.npz"
    write_block(
        expert,
        {
            "observation": np.zeros((3, 4), np.float32),
            "gripper_closed": np.zeros(3, np.bool_),
            "action": np.arange(3),
            "returns": np.ones(3, np.float32),
            "steps_to_go": np.arange(3, 0, -1),
            "episode": np.zeros(3, np.int64),
            "is_target": np.ones(3, np.bool_),
            "is_valued": np.ones(3, np.bool_),
            "num_objects": np.array([1]),
            "success": np.array([True]),
            "dropped": np.array([False]),
            "num_actions": np.array([3]),
            "is_greedy": np.array([False]),
        },
    )

    def read_episodes() -> Any:
        found = read_block(expert)
        return {name: values.tolist() for name, values in found.items()}

    yield _victim("block of episodes", expert, read_episodes, array_changes(), has_checksum=True)


def _evaluations(place: Path) -> Iterator[Victim]:
    folder = place / "evaluate"
    table = report_table().iloc[::2].reset_index(drop=True)
    card = evaluation_card(table)
    for point in card["points"]:
        point["num_episodes"] = 5
    write_episodes(folder / "episodes.parquet", table)
    write_json(folder / "evaluation.json", card)

    def read() -> Any:
        episodes, found = read_evaluation(folder)
        content = page_content("Title", episodes, found, {}, [], [], None)
        return str(main_table(episodes)), str(detail_tables(episodes)), str(content.points), str(content.run_facts)

    required = tuple(set(card) - {"commit"})
    table_path = folder / "episodes.parquet"
    yield _victim("table of episodes", table_path, read, table_changes(pd.read_parquet, write_episodes))
    yield _victim("card of an evaluation", folder / "evaluation.json", read, json_changes(required))

    curves = place / "train_rl" / "discrete" / "image" / "curves.csv"
    rows = {"network": "image", "iteration": [0, 1], "greedy/success_rate": [0.5, 0.7], "q/loss": [np.nan, 0.01]}
    _write_csv(curves, pd.DataFrame(rows))
    read_all = table_changes(pd.read_csv, _write_csv, fatal=("drop network",))
    yield _victim("training curves", curves, lambda: str(read_curves(place / "train_rl")), read_all)

    sweep = place / "fig5" / "100" / "evaluation" / "discrete" / "episodes.parquet"
    write_episodes(sweep, table)

    def read_sweep() -> Any:
        sweep_figures(place / "fig5", None)
        return str(demonstration_batches(place / "fig5"))

    yield _victim("table of a sweep", sweep, read_sweep, table_changes(pd.read_parquet, write_episodes))
    stability = place / "fig6" / "baseline_step_True" / "seed_0" / "curves.csv"
    _write_csv(stability, pd.DataFrame({"greedy/success_rate": [0.5, 0.75], "collection/transitions": [np.nan, 9.0]}))

    def read_stability() -> Any:
        sweep_figures(None, place / "fig6")
        return str(stability_trials(place / "fig6"))

    yield _victim("curves of a sweep", stability, read_stability, table_changes(pd.read_csv, _write_csv))


def _work_files(place: Path) -> Iterator[Victim]:
    row = episode_row(sample_result())
    trial = asdict(TrialEpisode(True, False, 8, (0.25, -0.5)))
    for name, schema, result in (("evaluate", EpisodeRow, row), ("tune", TrialEpisode, trial)):
        path = place / name / "episodes.jsonl"
        path.parent.mkdir(exist_ok=True)
        journal = Journal(path, schema)
        for key in ("a/0", "a/1", "b/0"):
            journal.append(key, result)

        text = json.dumps(result)

        def read(path: Path = path, schema: Any = schema, text: str = text) -> Any:
            found = dict(Journal(path, schema))
            assert all(json.dumps(value) == text for value in found.values())
            return sorted(found)  # a line that was cut short is left out, and computed again

        yield _victim(f"journal of {name}", path, read, journal_changes(schema), may_be_empty=True)
    history = [{"round": float(k), "validation/kept": 1.0, "validation/score": 0.5} for k in range(3)]
    for name, content, reader in (
        ("history.json", history, lambda path: read_history(path, RoundHistory)),
        ("metrics.json", {"epochs": 3, "train": {"loss": 0.5}}, read_summary),
    ):
        write_json(place / name, content)
        path = place / name
        yield _victim(
            name, path, lambda path=path, reader=reader: reader(path), json_changes((), isinstance(content, list))
        )
    for suffix in ("yaml", "json"):
        path = place / f"scene.{suffix}"
        save_task_instance(path, sample_task_instance(SCENES, 0, Split.TUNING, 1))

        def read_scene(path: Path = path) -> Any:
            instance = load_task_instance(path)
            return str(instance.scene.target), instance.state.vector.tolist()

        changes = json_changes(()) if suffix == "json" else ((), ())
        yield _victim(f"scene file ({suffix})", path, read_scene, changes, lists_faults=True)


def _write_csv(path: Path, table: pd.DataFrame) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False)


def _digest(*arrays: Any) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.asarray(array).tobytes())
    return digest.hexdigest()
