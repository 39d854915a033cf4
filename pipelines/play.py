"""Watch a planner at work, with what it imagines on the way: ``python -m pipelines.play``.

Runs one planner on one task, sampled (the same as in an evaluation with the same seed, scene and index) or from a file.
The artefact is two files in one folder, named by planner, task and noise:

- ``*.webm``: the video; before each action it shows the roll-outs that the planner compared, or what is left
  of the plan that it follows;
- ``*.json``: the card: configuration, commit, outcome, and every decision with its roll-outs, returns and time.

Where there is a screen, the episode is also shown in a window while it happens. Not a DVC stage: nothing depends on it.
"""

from __future__ import annotations

import logging
import math
import re
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app, command_line_overrides, override_keys
from pipelines.config import GreedyConfig, LearnedHeuristicConfig, PlayConfig
from pipelines.window import Window, has_screen

if TYPE_CHECKING:
    from visualrhp.evaluation.episodes import EpisodeResult
    from visualrhp.planning import Decision, Planner
    from visualrhp.rendering.frames import EpisodeRenderer, Outcome
    from visualrhp.rendering.imagined import ImaginedPath
    from visualrhp.rendering.video import Frame
    from visualrhp.scene import Scene, TaskInstance
    from visualrhp.types import Action, State

_log = logging.getLogger(__name__)

_PLANNER_STREAM = 1
"""The planner draws from the stream that it would draw from in an evaluation, so that it does the same."""


@dataclass(frozen=True)
class Considered:
    """A decision, the state in which it was made, and how long that took [s]."""

    state: State
    decision: Decision
    time_s: float


@dataclass(frozen=True)
class Played:
    """An episode with its decisions.

    Attributes:
        instance: the task, as the planner believes it to be.
        world: the scene in which the actions were executed; another one if there is noise (Sec. 8.2).
        result: what became of it, states included.
        decisions: in order; the last one may have no action, or one that was not executed since the physics failed.
    """

    instance: TaskInstance
    world: Scene
    result: EpisodeResult
    decisions: tuple[Considered, ...]


@app("play", PlayConfig)
def main(config: PlayConfig) -> None:
    """Run the planner, and write the video and the card."""
    from pipelines.tracking import open_run
    from pipelines.work import card
    from visualrhp.files import write_json
    from visualrhp.rendering.video import write_video

    instance = task_instance(config)
    planner = checked_planner(config, instance.scene.num_objects)
    path = Path(config.paths.artefact) / f"{file_stem(config, instance.scene.num_objects)}.webm"
    window = open_window(config)
    try:
        played = play(config, instance, planner, window)
    finally:
        if window is not None:
            window.close()
    result = played.result
    _log.info(
        "%s: %s after %d actions; %.2f s of planning.",
        title_of(config),
        result.outcome,
        len(result.states) - 1,
        sum(considered.time_s for considered in played.decisions),
    )
    started = time.perf_counter()
    num_frames = write_video(path, video_frames(config, played), config.video.fps)
    write_json(path.with_suffix(".json"), card(config, "play", video=path.name, **episode_card(played)))
    _log.info("%s: %d frames in %.1f s.", path, num_frames, time.perf_counter() - started)
    if config.tracking.name != "none":
        with open_run(config, "play", path.stem) as run:
            run.log_artifact(path)
            run.log_artifact(path.with_suffix(".json"))


# ------------------------------------------------------------------------------------------------------------ the task
def task_instance(config: PlayConfig) -> TaskInstance:
    """The task to play: from the scene file if there is one, else sampled.

    Raises:
        ConfigError: a parameter of the scene is out of range, or given beside a file.
        SceneError: the scene file cannot be read, or its scene cannot be simulated.
    """
    from visualrhp.errors import ConfigError
    from visualrhp.scene import SceneDistribution, Split, load_task_instance, sample_task_instance

    if config.scene_file is not None:
        for key in sorted(override_keys(command_line_overrides())):
            if key.partition(".")[0] == "scene":
                raise ConfigError(f"{key} is about sampled scenes, but scene_file={config.scene_file} is one already.")
        return load_task_instance(config.scene_file)
    return sample_task_instance(SceneDistribution(**asdict(config.scene)), config.seed, Split.EVALUATION, config.index)


def checked_planner(config: PlayConfig, num_objects: int) -> Planner:
    """The planner for scenes of ``num_objects`` objects.

    Raises:
        CheckpointError: it needs a network that is not there (the message says how to make it), or a damaged one.
        ConfigError: a parameter is out of range.
    """
    from pipelines.planners import build_planner, needed_network
    from visualrhp.errors import CheckpointError

    space, planner = config.action_space.name, config.planner
    path = needed_network(planner, space, config.heuristics, num_objects)
    if path is not None and not path.is_file():
        heuristic = getattr(planner, "heuristic", None)
        representation = heuristic.representation if isinstance(heuristic, LearnedHeuristicConfig) else "image"
        arguments = f"action_space={space} representation={representation}"
        raise CheckpointError(
            f"{planner.name} needs the network {path}, which does not exist. Make it with python -m "
            f"pipelines.generate_demos action_space={space}, python -m pipelines.train_il {arguments} and python -m "
            f"pipelines.train_rl {arguments}, in this order (or all networks with dvc repro); or name a folder that "
            "has it, as in heuristics=outputs/train_il; or choose planner=crafted_heuristic_rhp or "
            "planner=kinodynamic_rrt, which need none."
        )
    return build_planner(planner, space, config.heuristics, num_objects)


def title_of(config: PlayConfig) -> str:
    """The planner's name in the paper's manner, with its noise."""
    from visualrhp.evaluation.figures import method_label

    planner = config.planner
    title = method_label(planner.name, getattr(planner, "num_rollouts", None), getattr(planner, "horizon", None))
    return title if config.noise_level == "none" else f"{title}, {config.noise_level} noise"


def file_stem(config: PlayConfig, num_objects: int) -> str:
    """Name of the video without its suffix: ``visualrhp-3x3_continuous_m5_seed0_index3``."""
    task = f"m{num_objects}" + (f"-{config.scene.object_size}" if config.scene.object_size != "mixed" else "")
    if config.scene_file is not None:
        task = Path(config.scene_file).stem
    parts = [title_of(config), config.action_space.name, task, f"seed{config.seed}", f"index{config.index}"]
    return "_".join(re.sub(r"[^\w.-]+", "-", part.lower()).strip("-.") for part in parts)


# --------------------------------------------------------------------------------------------------------- the episode
def play(config: PlayConfig, instance: TaskInstance, planner: Planner, window: Window | None = None) -> Played:
    """Let the planner act until success, a drop, or the action limit; show it in ``window`` while it happens."""
    from visualrhp.evaluation.episodes import perturbed_scene, run_episode
    from visualrhp.rendering.frames import EpisodeRenderer
    from visualrhp.scene import NOISE_LEVELS, Split, generator_for
    from visualrhp.simulation import Physics, TransitionModel, make_action_space

    action_space, physics = make_action_space(config.action_space.name), Physics(**asdict(config.physics))
    model = world = TransitionModel(instance.scene, action_space, physics)
    place = (config.seed, Split.EVALUATION, config.index)
    if config.noise_level != "none":
        scene = perturbed_scene(instance.scene, NOISE_LEVELS[config.noise_level], *place)
        world = TransitionModel(scene, action_space, physics)
    live = None
    if window is not None:
        renderer = EpisodeRenderer(world.scene, instance.state, **picture_options(config, instance.scene))
        live = _Live(window, renderer, config.video.fps, instance.state)
    watched = _watch(planner, live)
    rng = generator_for(*place, _PLANNER_STREAM)
    result = run_episode(watched, world, model, instance.state, rng, keep_states=True)
    if live is not None:
        live.end(result.states[-1], result.outcome, config.video.hold_s)
    return Played(instance, world.scene, result, tuple(watched.decisions))


def _watch(planner: Planner, live: _Live | None) -> Any:
    """A planner that decides as ``planner`` does and keeps its decisions in ``decisions``."""
    from visualrhp.planning import Planner

    class Watched(Planner):
        def __init__(self) -> None:
            self.decisions: list[Considered] = []

        @property
        def name(self) -> str:
            return planner.name

        def start(self, model: Any, rng: Any) -> Any:
            policy = planner.start(model, rng)

            def decide(state: State) -> Decision:
                if live is not None:
                    live.arrive(state)
                started = time.perf_counter()
                decision = policy(state)
                self.decisions.append(Considered(state, decision, time.perf_counter() - started))
                if live is not None:
                    live.imagine(imagined_paths(decision), self.decisions[-1].time_s)
                return decision

            return decide

    return Watched()


def imagined_paths(decision: Decision) -> list[ImaginedPath]:
    """The roll-outs of a decision as something to look at; the first one of the highest return is the chosen one."""
    from visualrhp.rendering.imagined import ImaginedPath

    chosen = _chosen(decision)
    return [
        ImaginedPath(rollout.states, rollout.total_return, number == chosen)
        for number, rollout in enumerate(decision.rollouts)
    ]


def _chosen(decision: Decision) -> int | None:
    """Index of the roll-out whose first action is taken (Alg. 1); None if there is none, or if all diverged."""
    returns = [rollout.total_return for rollout in decision.rollouts]
    return returns.index(max(returns)) if returns and math.isfinite(max(returns)) else None


# ------------------------------------------------------------------------------------------------------------ pictures
def video_frames(config: PlayConfig, played: Played) -> Iterator[Frame]:
    """All pictures of the episode."""
    from visualrhp.rendering.frames import episode_frames

    looks = picture_options(config, played.instance.scene)
    with_imagined = looks.pop("show_imagined")
    return episode_frames(
        played.world,
        played.result.states,
        outcome=played.result.outcome,
        imagined=[imagined_paths(considered.decision) for considered in played.decisions] if with_imagined else None,
        decision_s=[considered.time_s for considered in played.decisions],
        hold=round(config.video.fps * config.video.hold_s),
        **looks,
    )


def picture_options(config: PlayConfig, believed_scene: Scene) -> dict[str, Any]:
    """How the pictures look: arguments of ``EpisodeRenderer``."""
    from visualrhp.simulation.task import MAX_EPISODE_ACTIONS

    video = config.video
    return {
        "title": title_of(config),
        "max_steps": MAX_EPISODE_ACTIONS,
        "size_px": video.size_px,
        "frames_per_action": max(1, round(video.fps * video.action_s)),
        "imagined_frames": max(1, round(video.fps * video.imagined_s)),
        "show_imagined": video.imagined_s > 0.0 and not isinstance(config.planner, GreedyConfig),
        "show_observation": video.observation == "panel",
        "show_inset": video.observation == "inset",
        "believed_scene": believed_scene,
    }


def open_window(config: PlayConfig) -> Window | None:
    """The window to show the episode in, where that is asked for, or possible.

    Raises:
        ConfigError: ``live=true`` and there is no screen.
    """
    from visualrhp.errors import ConfigError

    if config.live is False or (config.live == "auto" and not has_screen()):
        return None
    try:
        return Window(title_of(config))
    except ConfigError:
        if config.live is True:
            raise
        return None


class _Live:
    """Shows an episode in a window while it happens."""

    def __init__(self, window: Window, renderer: EpisodeRenderer, fps: float, state: State) -> None:
        self._window, self._renderer, self._frame_s = window, renderer, 1.0 / fps
        self._state = state
        self._show(iter([renderer.still()]))

    def arrive(self, state: State, outcome: Outcome | None = None) -> None:
        if state is not self._state:
            self._state = state
            self._show(self._renderer.move(state, outcome))

    def imagine(self, paths: list[ImaginedPath], decision_s: float) -> None:
        self._show(self._renderer.imagine(paths, decision_s))

    def end(self, state: State, outcome: Outcome, hold_s: float) -> None:
        self.arrive(state, outcome)
        self._window.show(self._renderer.still(outcome), hold_s)
        self._window.show(self._renderer.still(outcome), 0.0)

    def _show(self, frames: Iterator[Frame]) -> None:
        for frame in frames:
            if not self._window.show(frame, self._frame_s):
                return


# ---------------------------------------------------------------------------------------------------------------- card
def episode_card(played: Played) -> dict[str, Any]:
    """What happened, as JSON: returns of roll-outs that diverged, and their values, are null."""
    result = played.result
    return {
        "outcome": result.outcome,
        "num_objects": result.num_objects,
        "num_actions": len(result.states) - 1,
        "discounted_return": result.discounted_return,
        "num_invalid_rollouts": result.num_invalid_rollouts,
        "decision_time_s": sum(considered.time_s for considered in played.decisions),
        "decisions": [_decision_card(considered) for considered in played.decisions],
        "final_state": result.states[-1].vector.tolist(),
    }


def _decision_card(considered: Considered) -> dict[str, Any]:
    decision = considered.decision
    chosen = _chosen(decision)
    return {
        "state": considered.state.vector.tolist(),
        "action": _plain(decision.action),
        "time_s": considered.time_s,
        "timing": None if decision.timing is None else asdict(decision.timing),
        "num_invalid": decision.num_invalid,
        "chosen_rollout": chosen,
        "rollouts": [
            {
                "actions": [_plain(action) for action in rollout.actions],
                "rewards": list(rollout.rewards),
                "value_estimate": rollout.value_estimate if math.isfinite(rollout.value_estimate) else None,
                "total_return": rollout.total_return if math.isfinite(rollout.total_return) else None,
            }
            for rollout in decision.rollouts
        ],
    }


def _plain(action: Action | None) -> int | list[float] | None:
    """An action as JSON."""
    return action if action is None or isinstance(action, int) else action.tolist()


if __name__ == "__main__":
    main()
