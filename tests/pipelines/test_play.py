"""Playing: the episode of an evaluation, its video and its card, live where there is a screen."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from pipelines import play as pipeline
from pipelines.app import CONFIG_FOLDER, compose
from pipelines.config import PlayConfig
from pipelines.planners import build_planner, needed_network
from pipelines.window import Window, has_screen, ppm
from visualrhp.environments.task import ObservationFunction
from visualrhp.errors import CheckpointError, ConfigError, SceneError
from visualrhp.evaluation.episodes import EpisodeResult, run_task
from visualrhp.heuristics.checkpoint import save_heuristic
from visualrhp.heuristics.networks import make_network
from visualrhp.planning import Decision, Rollout
from visualrhp.rendering.video import read_video
from visualrhp.scene import NOISE_LEVELS, SceneDistribution, Split, sample_task_instance, save_task_instance
from visualrhp.simulation import Physics, make_action_space

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


def played(config: PlayConfig, window: Window | None = None) -> pipeline.Played:
    instance = pipeline.task_instance(config)
    return pipeline.play(config, instance, pipeline.checked_planner(config, instance.scene.num_objects), window)


def evaluated(config: PlayConfig) -> EpisodeResult:
    """The same episode as an evaluation runs it."""
    space = config.action_space.name
    return run_task(
        build_planner(config.planner, space, config.heuristics, 2),
        SceneDistribution(**asdict(config.scene)),
        config.seed,
        Split.EVALUATION,
        config.index,
        action_space=make_action_space(space),
        physics=Physics(**asdict(config.physics)),
        noise=NOISE_LEVELS[config.noise_level],
        keep_states=True,
    )


@pytest.fixture(scope="module")
def heuristics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Untrained networks for every planner, for two objects, in the discrete action space."""
    folder = tmp_path_factory.mktemp("heuristics")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        for name, observation in (
            ("image/heuristic", ObservationFunction("image")),
            ("cartesian/heuristic_m2", ObservationFunction("cartesian", 2)),
        ):
            path = folder / "discrete" / f"{name}.safetensors"
            path.parent.mkdir(parents=True)
            save_heuristic(path, make_network("discrete", observation))
    return folder


# ------------------------------------------------------------------------------------------------------------- episode
@pytest.mark.parametrize("overrides", [(), ("noise_level=high", "action_space=discrete", "seed=3", "index=4")])
def test_it_is_the_episode_of_an_evaluation(overrides: tuple[str, ...]) -> None:
    config = configure(*overrides)
    result, expected = played(config).result, evaluated(config)
    assert result.states == expected.states
    assert (result.outcome, result.num_actions) == (expected.outcome, expected.num_actions)


def test_the_executed_world_differs_from_the_planners_only_with_noise() -> None:
    quiet, noisy = played(configure()), played(configure("noise_level=low"))
    assert quiet.world == quiet.instance.scene
    assert noisy.world != noisy.instance.scene == quiet.instance.scene


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_plays(planner: str, heuristics: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("visualrhp.evaluation.episodes.MAX_EPISODE_ACTIONS", 2)
    config = configure(f"planner={planner}", f"heuristics={heuristics}", "action_space=discrete")
    episode = played(config)
    imagines = planner != "greedy"
    assert {len(considered.decision.rollouts) for considered in episode.decisions} == {
        getattr(config.planner, "num_rollouts", int(imagines))  # of a planner without roll-outs, its plan
    }
    frames = list(pipeline.video_frames(config, episode))
    steps = len(episode.result.states) - 1
    assert len(frames) == 1 + steps * (2 + imagines) + 5
    assert frames[0].shape == (64 + 24 + 24 * imagines, 64, 3), "the bars of the caption and of the legend"


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_a_network_that_is_not_there_is_an_error_that_says_how_to_make_it(planner: str, space: Any) -> None:
    config = configure(f"planner={planner}", f"action_space={space}", "heuristics=nowhere")
    path = needed_network(config.planner, space, "nowhere", 2)
    if path is None:
        assert pipeline.checked_planner(config, 2).name
        return
    with pytest.raises(CheckpointError) as error:
        pipeline.checked_planner(config, 2)
    message = str(error.value)
    representation = "cartesian" if planner == "cartesian_rhp" else "image"
    assert str(path) in message
    assert f"python -m pipelines.train_rl action_space={space} representation={representation}" in message
    assert "planner=crafted_heuristic_rhp" in message


def test_a_scene_from_a_file_is_played(tmp_path: Path) -> None:
    instance = sample_task_instance(SceneDistribution(num_objects=(3, 3)), 5, Split.TUNING, 1)
    path = tmp_path / "three things.yaml"
    save_task_instance(path, instance)
    config = configure(f"scene_file='{path}'")
    assert pipeline.task_instance(config) == instance
    assert pipeline.file_stem(config, 3) == "craftedheuristicrhp-2x2_continuous_three-things_seed0_index0"
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
    stem = "craftedheuristicrhp-2x2-low-noise_continuous_m2_seed0_index4"
    assert sorted(path.name for path in folder.iterdir()) == [f"{stem}.json", f"{stem}.webm"]
    card = json.loads((folder / f"{stem}.json").read_text())
    config = configure("index=4", "noise_level=low")
    expected = evaluated(config)
    steps = len(expected.states) - 1
    assert (card["outcome"], card["num_actions"]) == (expected.outcome, steps)
    assert (card["seed"], card["config"]["index"], card["config"]["noise_level"]) == (0, 4, "low")
    assert card["final_state"] == expected.states[-1].vector.tolist()
    assert [decision["state"] for decision in card["decisions"]] == [
        state.vector.tolist() for state in expected.states[:-1]
    ]
    for decision in card["decisions"]:
        returns = [rollout["total_return"] for rollout in decision["rollouts"]]
        assert len(returns) == 2
        assert returns[decision["chosen_rollout"]] == max(returns)
        assert decision["rollouts"][decision["chosen_rollout"]]["actions"][0] == decision["action"]
        assert decision["time_s"] > 0.0
    video = read_video(folder / f"{stem}.webm")
    assert len(video) == 1 + 3 * steps + 5


def test_a_mistake_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_main(monkeypatch, "scene_file=missing.yaml") == 2
    assert "scene.num_objects is about sampled scenes" in capsys.readouterr().err
    assert not (tmp_path / "outputs" / "play").exists()


def test_roll_outs_that_diverge_are_null_and_never_chosen() -> None:
    config = configure()
    instance = pipeline.task_instance(config)
    state, action = instance.state, np.zeros(4)
    bad = Rollout((action,), (state,), (), math.nan, -math.inf)
    good = Rollout((action,), (state, state), (-1.0,), -4.0, -4.98)

    def decisions(*rollouts: Rollout) -> Any:
        result = EpisodeResult("diverged", 2, 0, 0.0, 0.1, 0.1, 1, (state,))
        decision = Decision(action, rollouts, 1)
        return pipeline.Played(
            instance, instance.scene, result, (pipeline.Considered(state, decision, 0.5),)
        ), pipeline.imagined_paths(decision)

    episode, paths = decisions(bad, good, good)
    assert [path.is_chosen for path in paths] == [False, True, False]
    card = pipeline.episode_card(episode)["decisions"][0]
    assert card["chosen_rollout"] == 1
    assert [rollout["total_return"] for rollout in card["rollouts"]] == [None, -4.98, -4.98]
    json.dumps(card, allow_nan=False)
    episode, paths = decisions(bad, bad)
    assert not any(path.is_chosen for path in paths)
    assert pipeline.episode_card(episode)["decisions"][0]["chosen_rollout"] is None


# ---------------------------------------------------------------------------------------------------------------- live
class FakeToolkit:
    """Stands for tkinter: remembers what is shown.

    ``close_at`` is the picture at which somebody closes the window, ``lost_at`` that at which the screen goes away.
    """

    class TclError(Exception):
        pass

    def __init__(self, close_at: int | None = None, lost_at: int | None = None) -> None:
        self.pictures: list[bytes] = []
        self.shown: list[Any] = []
        self.close_at, self.lost_at = close_at, lost_at
        self.destroyed = 0
        self.words = ""
        self._on_close: Callable[[], None] = lambda: None

    def Tk(self) -> FakeToolkit:
        return self

    def Label(self, root: Any, borderwidth: int) -> FakeToolkit:
        return self

    def PhotoImage(self, data: bytes, format: str) -> bytes:  # noqa: A002
        assert format == "PPM"
        self.pictures.append(data)
        return data

    def title(self, words: str) -> None:
        self.words = words

    def protocol(self, name: str, call: Callable[[], None]) -> None:
        assert name == "WM_DELETE_WINDOW"
        self._on_close = call

    def pack(self) -> None:
        pass

    def configure(self, image: Any) -> None:
        self.shown.append(image)

    def update(self) -> None:
        if len(self.shown) == self.lost_at:
            raise self.TclError("connection lost")
        if len(self.shown) == self.close_at:
            self._on_close()

    def destroy(self) -> None:
        self.destroyed += 1


class FakeTime:
    def __init__(self) -> None:
        self.now = 100.0

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_a_frame_is_shown_as_it_is() -> None:
    frame = np.random.default_rng(0).integers(0, 256, (20, 31, 3), dtype=np.uint8)
    read = cv2.imdecode(np.frombuffer(ppm(frame), dtype=np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(read[..., ::-1], frame)


def test_frames_are_shown_at_the_pace_of_the_video() -> None:
    toolkit, passing = FakeToolkit(), FakeTime()
    window = Window("words", toolkit, passing.clock, passing.sleep)
    frame = np.zeros((2, 2, 3), dtype=np.uint8)
    for _ in range(4):
        assert window.show(frame, 0.25)
    assert toolkit.words == "words"
    assert passing.now == pytest.approx(100.75)  # the first one at once
    passing.now += 2.0  # the planner took its time
    window.show(frame, 0.25)
    assert passing.now == pytest.approx(102.75)
    window.close()
    window.close()
    assert toolkit.destroyed == 1


@pytest.mark.parametrize("fate", [{"close_at": 3}, {"lost_at": 3}])
def test_a_closed_window_shows_nothing_more_and_the_episode_goes_on(fate: dict[str, int]) -> None:
    toolkit, passing = FakeToolkit(**fate), FakeTime()
    config = configure()
    result = played(config, Window("", toolkit, passing.clock, passing.sleep)).result
    assert len(toolkit.shown) == 3
    assert result.states == evaluated(config).states


def test_what_is_shown_live_is_the_video() -> None:
    toolkit, passing = FakeToolkit(), FakeTime()
    config = configure("index=4")
    episode = played(config, Window("", toolkit, passing.clock, passing.sleep))
    frames = list(pipeline.video_frames(config, episode))
    hold = 5
    assert toolkit.pictures[:-2] == [ppm(frame) for frame in frames[:-hold]]
    assert toolkit.pictures[-1] == ppm(frames[-1])
    assert passing.now == pytest.approx(100.0 + 0.2 * (len(frames) - hold) + 1.0)


@pytest.mark.parametrize(
    ("environment", "platform", "expected"),
    [
        ({}, "linux", False),
        ({"DISPLAY": ""}, "linux", False),
        ({"DISPLAY": ":0"}, "linux", True),
        ({"WAYLAND_DISPLAY": "wayland-0"}, "linux", True),
        ({}, "darwin", True),
    ],
)
def test_where_a_screen_is(
    environment: dict[str, str], platform: str, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipelines.window.importlib.util.find_spec", lambda name: object())
    assert has_screen(environment, platform) is expected
    monkeypatch.setattr("pipelines.window.importlib.util.find_spec", lambda name: None)
    assert has_screen(environment, platform) is False


def test_without_a_screen_only_live_true_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoScreen(FakeToolkit):
        def Tk(self) -> FakeToolkit:
            raise self.TclError("couldn't connect to display")

    monkeypatch.setitem(sys.modules, "tkinter", NoScreen())
    with pytest.raises(ConfigError, match=r"live=true needs a screen \(couldn't connect to display\)"):
        pipeline.open_window(configure("live=true"))
    assert pipeline.open_window(configure("live=false")) is None
    for screen in (True, False):
        monkeypatch.setattr(pipeline, "has_screen", lambda screen=screen: screen)
        assert pipeline.open_window(configure("live=auto")) is None

    monkeypatch.setitem(sys.modules, "tkinter", None)
    with pytest.raises(ConfigError, match="live=true needs tkinter"):
        pipeline.open_window(configure("live=true"))
