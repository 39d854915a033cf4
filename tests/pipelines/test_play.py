"""Playing: the episode of an evaluation, its video and its card, live where there is a screen."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from pipelines import play as pipeline
from pipelines.config import PlayConfig
from pipelines.planners import build_planner, find_network, needed_network, released_where_untrained
from pipelines.workflow.app import CONFIG_FOLDER, compose
from tests.rendering.fake_window import FakeTime, FakeToolkit
from visualrhp.errors import CheckpointError, ConfigError, SceneError
from visualrhp.evaluation.films import film_episode
from visualrhp.execution.episode import EpisodeResult, run_task
from visualrhp.heuristics.conversion import save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import make_observation
from visualrhp.planning import Planner
from visualrhp.rendering.video import read_video
from visualrhp.rendering.window import Window, ppm
from visualrhp.scene import NOISE_LEVELS, SceneDistribution, sample_task_instance, save_task_instance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.simulation.recording import MotionRecorder
from visualrhp.streams import Split

SETTINGS = (
    "scale=smoke",
    "live=false",
    "planner=crafted_heuristic_rhp",
    "planner.num_rollouts=2",
    "planner.horizon=2",
    "scene.num_objects=2",
    "video.size_px=64",
    "video.fps=5",
    "video.action_s=0.4",
    "video.imagined_s=0.2",
    "video.hold_s=1.0",
)
PLANNERS = sorted(path.stem for path in (CONFIG_FOLDER / "planner").glob("*.yaml"))


def configure(*overrides: str) -> PlayConfig:
    planner = [override for override in overrides if override.startswith("planner=")]
    settings = [setting for setting in SETTINGS if not (planner and setting.startswith("planner"))]
    return compose("play", PlayConfig, [*settings, *overrides])


def planner_of(config: PlayConfig, num_objects: int) -> Planner:
    space = config.action_space.name
    return build_planner(
        config.planner, space, num_objects, find_network(config.planner, space, config.heuristics, num_objects)
    )


def played(config: PlayConfig, window: Window | None = None) -> tuple[EpisodeResult, TransitionModel]:
    instance = pipeline.task_instance(config)
    return pipeline.play(config, instance, planner_of(config, instance.scene.num_objects), window)


def num_moving(result: EpisodeResult, world: TransitionModel) -> int:
    """Frames of the motions of an episode with ``SETTINGS``."""
    return sum(len(motion) - 1 for motion in MotionRecorder(world, 2).record_episode(result.episode))


def evaluated(config: PlayConfig) -> EpisodeResult:
    """The same episode as an evaluation runs it."""
    space = config.action_space.name
    return run_task(
        planner_of(config, 2),
        pipeline.task_instance(config),
        config.seed,
        Split.EVALUATION,
        config.index,
        action_space=make_action_space(space),
        physics=config.physics,
        noise=NOISE_LEVELS[config.noise_level],
    )


@pytest.fixture(scope="module")
def heuristics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Untrained networks for every planner, for two objects, in the discrete action space."""
    folder = tmp_path_factory.mktemp("heuristics")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        for name, observation in (
            ("image/heuristic", make_observation("image")),
            ("cartesian/heuristic_m2", make_observation("cartesian", 2)),
        ):
            path = folder / "discrete" / f"{name}.safetensors"
            path.parent.mkdir(parents=True)
            save_heuristic(path, make_network("discrete", observation))
    return folder


# ------------------------------------------------------------------------------------------------------------- episode
@pytest.mark.parametrize("overrides", [(), ("noise_level=high", "action_space=discrete", "seed=3", "index=4")])
def test_it_is_the_episode_of_an_evaluation(overrides: tuple[str, ...]) -> None:
    config = configure(*overrides)
    result, expected = played(config)[0], evaluated(config)
    assert result.episode.states == expected.episode.states
    assert (result.outcome, result.num_actions) == (expected.outcome, expected.num_actions)


def test_the_executed_world_differs_from_the_planners_only_with_noise() -> None:
    (quiet, world), (noisy, perturbed) = played(configure()), played(configure("noise_level=low"))
    assert world.scene == quiet.scene == noisy.scene
    assert perturbed.scene != noisy.scene


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_plays(planner: str, heuristics: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("visualrhp.simulation.rules.MAX_EPISODE_ACTIONS", 2)
    config = configure(f"planner={planner}", f"heuristics={heuristics}", "action_space=discrete")
    result, world = played(config)
    imagines = planner != "greedy"
    counts = {len(timed.decision.rollouts) for timed in result.decisions}
    least = getattr(config.planner, "num_rollouts", int(imagines))  # of a planner without roll-outs, its plan
    assert min(counts) >= least if "_plus" in planner else counts == {least}
    frames = list(film_episode(result, world, hold=5, **pipeline.looks(config)))
    steps = len(result.episode)
    assert len(frames) == 1 + num_moving(result, world) + steps * imagines + 5
    assert frames[0].shape == (64 + 24 + 34 * imagines, 64, 3), "the bars of the caption and of the returns"


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_a_missing_network_is_an_error_that_says_how_to_make_it(planner: str, space: Any) -> None:
    config = configure(f"planner={planner}", f"action_space={space}", "heuristics=nowhere")
    path = needed_network(config.planner, space, "nowhere", 2)
    if path is None:
        assert planner_of(config, 2).name
        return
    with pytest.raises(CheckpointError) as error:
        planner_of(config, 2)
    message = str(error.value)
    observation = "cartesian" if planner.startswith("cartesian_rhp") else "image"
    assert str(path) in message
    assert f"python -m pipelines.train_rl action_space={space} observation={observation}" in message
    assert "planner=crafted_heuristic_rhp" in message


@pytest.mark.parametrize(
    ("planner", "num_objects", "expected"),
    [
        ("visual_rhp_plus", 5, "pretrained"),
        ("cartesian_rhp", 4, "pretrained_paper"),
        ("cartesian_rhp", 8, None),  # not released
        ("kinodynamic_rrt", 5, None),
    ],
)
def test_where_nothing_was_trained_the_released_networks_play(
    planner: str, num_objects: int, expected: str | None, tmp_path: Path
) -> None:
    config = configure(f"planner={planner}", f"paths.outputs={tmp_path}")
    assert released_where_untrained(config.planner, "continuous", config.heuristics, num_objects) == expected
    assert released_where_untrained(config.planner, "continuous", "elsewhere", num_objects) == "elsewhere"


def test_names_of_files_tell_planners_apart() -> None:
    stems = {pipeline.file_stem(configure(f"planner={planner}"), 2) for planner in PLANNERS}
    assert len(stems) == len(PLANNERS)
    assert any(stem.startswith("visualrhp-plus-3x3_continuous_m2_seed0_index0_") for stem in stems)


def test_names_of_files_tell_configurations_and_scene_files_apart(tmp_path: Path) -> None:
    instance = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 5, Split.TUNING, 1)
    other = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 5, Split.TUNING, 2)
    paths = [tmp_path / "a" / "scene.yaml", tmp_path / "b" / "scene.yaml"]
    for path, task in zip(paths, (instance, other), strict=True):
        path.parent.mkdir()
        save_task_instance(path, task)
    settings = [[f"scene_file={path}"] for path in paths]
    settings += [[], ["planner.horizon=3"], ["heuristics=outputs/train_il"], ["heuristics=outputs/train_rl"]]
    settings += [[f"planner.name={'x' * 300}"], [f"planner.name={'x' * 301}"]]
    stems = [pipeline.file_stem(configure(*overrides), 3) for overrides in settings]
    assert len(set(stems)) == len(stems)
    assert all(len(stem) < 200 for stem in stems)


def test_a_scene_from_a_file_is_played(tmp_path: Path) -> None:
    instance = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 5, Split.TUNING, 1)
    path = tmp_path / "three things.yaml"
    save_task_instance(path, instance)
    config = configure(f"scene_file='{path}'")
    assert pipeline.task_instance(config) == instance
    stem = pipeline.file_stem(config, 3)
    assert stem.startswith("craftedheuristicrhp-2x2_continuous_three-things_seed0_index0_")
    with pytest.raises(SceneError, match=r"missing\.yaml"):
        pipeline.task_instance(configure("scene_file=missing.yaml"))


# ----------------------------------------------------------------------------------------------------------- artefacts
def run_main(monkeypatch: pytest.MonkeyPatch, *overrides: str) -> int | str | None:
    monkeypatch.setattr("sys.argv", ["play", *SETTINGS, *overrides])
    with pytest.raises(SystemExit) as ended:
        pipeline.main()
    return ended.value.code


def test_video_and_card_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_main(monkeypatch, "index=4", "noise_level=low") == 0
    folder = tmp_path / "outputs" / "play"
    config = configure("index=4", "noise_level=low")
    stem = pipeline.file_stem(config, 2)
    assert sorted(path.name for path in folder.iterdir()) == [f"{stem}.json", f"{stem}.webm"]
    card = json.loads((folder / f"{stem}.json").read_text())
    expected = evaluated(config)
    steps = len(expected.episode.states) - 1
    assert (card["outcome"], card["num_actions"]) == (expected.outcome, steps)
    assert (card["seed"], card["config"]["index"], card["config"]["noise_level"]) == (0, 4, "low")
    assert card["final_state"] == expected.episode.states[-1].vector.tolist()
    assert [decision["state"] for decision in card["decisions"]] == [
        state.vector.tolist() for state in expected.episode.states[:-1]
    ]
    for decision in card["decisions"]:
        returns = [rollout["total_return"] for rollout in decision["rollouts"]]
        assert len(returns) == 2
        assert returns[decision["chosen_rollout"]] == max(returns)
        assert decision["rollouts"][decision["chosen_rollout"]]["actions"][0] == decision["action"]
        assert decision["time_s"] > 0.0
    video = read_video(folder / f"{stem}.webm")
    assert len(video) == 1 + num_moving(*played(config)) + steps + 5


def test_a_mistake_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_main(monkeypatch, "scene_file=missing.yaml") == 2
    assert "scene.num_objects is for sampled scenes only" in capsys.readouterr().err
    assert not (tmp_path / "outputs" / "play").exists()


# ---------------------------------------------------------------------------------------------------------------- live
@pytest.mark.parametrize("fate", [{"close_at": 3}, {"lost_at": 3}])
def test_a_closed_window_shows_nothing_more_and_the_episode_continues(fate: dict[str, int]) -> None:
    toolkit, passing = FakeToolkit(**fate), FakeTime()
    config = configure()
    result = played(config, Window("", toolkit, passing.clock, passing.sleep))[0]
    assert len(toolkit.shown) == 3
    assert result.episode.states == evaluated(config).episode.states


def test_what_is_shown_live_is_the_video() -> None:
    toolkit, passing = FakeToolkit(), FakeTime()
    config = configure("index=4")
    result, world = played(config, Window("", toolkit, passing.clock, passing.sleep))
    hold = 5
    frames = list(film_episode(result, world, hold=hold, **pipeline.looks(config)))
    assert toolkit.pictures[:-2] == [ppm(frame) for frame in frames[:-hold]]
    assert toolkit.pictures[-1] == ppm(frames[-1])
    assert passing.now == pytest.approx(100.0 + 0.2 * (len(frames) - hold) + 1.0)


def test_without_a_screen_only_live_true_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoScreen(FakeToolkit):
        def Tk(self) -> FakeToolkit:
            raise self.TclError("couldn't connect to display")

    monkeypatch.setitem(sys.modules, "tkinter", NoScreen())
    with pytest.raises(ConfigError, match=r"live=true needs a screen \(couldn't connect to display\)"):
        pipeline.open_window(configure("live=true"))
    assert pipeline.open_window(configure("live=false")) is None
    for screen in (True, False):
        monkeypatch.setattr("visualrhp.rendering.window.has_screen", lambda screen=screen: screen)
        assert pipeline.open_window(configure("live=auto")) is None

    monkeypatch.setitem(sys.modules, "tkinter", None)
    with pytest.raises(ConfigError, match="live=true needs tkinter"):
        pipeline.open_window(configure("live=true"))
