"""The page on the environment says what the code does: spaces, bounds, arguments, options, and its examples run."""

from __future__ import annotations

import inspect
import math
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from visualrhp.environments import ClutterManipulation
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.environments.clutter_manipulation import RESET_OPTIONS
from visualrhp.observation.label_image import VIEW_SIDE, Label
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace
from visualrhp.simulation.rules import ACTION_REWARD, DROP_REWARD, MAX_EPISODE_ACTIONS
from visualrhp.streams import Split

PAGE = Path(__file__).resolve().parents[2] / "docs" / "environment.md"
TEXT = PAGE.read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def tables(section: str) -> list[list[dict[str, str]]]:
    """The tables of a section: a dictionary a row, by the names of the columns."""
    body = re.search(rf"^## {section}\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL).group(1)
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", body, re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in block.splitlines()]
        assert len({len(row) for row in rows}) == 1, block
        found.append([dict(zip(rows[0], row, strict=True)) for row in rows[2:]])
    return found


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda code: code.strip().splitlines()[-1])
def test_examples_run(example):
    exec(compile(example, str(PAGE), "exec"), {})


def test_there_are_examples_and_the_picture():
    assert len(EXAMPLES) >= 6 and (PAGE.parent / "environment.png").is_file()


def test_spaces_in_the_summary():
    summary = re.search(r"^\| Action space.*\n.*\n", TEXT, re.MULTILINE).group(0)
    continuous, discrete = ClutterManipulation("continuous"), ClutterManipulation("discrete")
    box = continuous.observation_space["observation"]
    for space in (
        f"Box({continuous.action_space.low[0]:g}, {continuous.action_space.high[0]:g}, (4,), float32)",
        str(discrete.action_space),
        f"Box({box.low.min()}, {box.high.max()}, {box.shape}, {box.dtype})",
        str(continuous.observation_space["gripper_closed"]),
    ):
        assert f"`{space}`" in summary or f": {space}" in summary, space


def test_action_tables():
    continuous, discrete = tables("Action space")
    space = ClutterManipulation("continuous").action_space
    assert [int(row["Index"]) for row in continuous] == list(range(space.shape[0]))
    for row, low, high in zip(continuous, space.low, space.high, strict=True):
        assert (float(row["Min"]), float(row["Max"])) == (low, high)
    sizes = [f"{100 * ContinuousActionSpace.TRANSLATION:g} cm"] * 2
    assert [row["Unit of 1"] for row in continuous] == [
        *sizes,
        f"{math.degrees(ContinuousActionSpace.ROTATION):g}°",
        "",
    ]

    assert [int(row["Action"]) for row in discrete] == list(range(ClutterManipulation("discrete").action_space.n))
    says = {
        "forward": (1, 0, 0, None),
        "backward": (-1, 0, 0, None),
        "left": (0, 1, 0, None),
        "right": (0, -1, 0, None),
        "turn counter-clockwise": (0, 0, 1, None),
        "turn clockwise": (0, 0, -1, None),
        "close the gripper": (0, 0, 0, True),
        "open the gripper": (0, 0, 0, False),
    }
    for row in discrete:
        motion = DiscreteActionSpace().motion(int(row["Action"]))
        signs = (np.sign(motion.forward), np.sign(motion.left), np.sign(motion.rotation), motion.closed)
        assert says[row["Meaning"]] == signs
        size = f"{math.degrees(abs(motion.rotation)):.0f}°" if motion.rotation else ""
        shift = abs(motion.forward) + abs(motion.left)
        assert row["Size"] == (f"{100 * shift:g} cm" if shift else size)


def test_observation_tables():
    labels, features = tables("Observation space")
    words = {
        Label.BACKGROUND: "free surface",
        Label.EDGE: "beyond the edges of the surface",
        Label.TARGET: "target region",
        Label.OBSTACLE: "obstacle",
        Label.DESIRED_OBJECT: "desired object",
        Label.GRIPPER: "gripper",
    }
    assert {Label(int(row["Label"])): row["Meaning"] for row in labels} == words
    assert f"{VIEW_SIDE:g} m a side" in TEXT

    m = 3
    env = ClutterManipulation(observation="cartesian", num_objects=m)
    box = env.observation_space["observation"]
    assert {(float(row["Min"]), float(row["Max"])) for row in features} == {(box.low.min(), box.high.max())}
    names = [row["Index"].replace("4 i", "4*i").replace("4 m", "4*m") for row in features]
    documented = {name: row["Observation"] for name, row in zip(names, features, strict=True)}
    indices = sorted(eval(name, {"i": i, "m": m}) for name in documented for i in (range(m) if "i" in name else [0]))
    assert indices == list(range(box.shape[0]))

    observation, _ = env.reset(seed=2)
    x, y, theta = env.state.gripper_pose
    target = env.scene.target.position
    c, s = math.cos(theta), math.sin(theta)

    def of(what: str, px: float, py: float, angle: float, gripper: bool = False) -> float:
        dx, dy = px - x, py - y
        if "ahead" in what:
            return (c * dx + s * dy) / 0.25
        if "to the left" in what:
            return (c * dy - s * dx) / 0.25
        if "x in the world" in what or "y in the world" in what:
            return (x if "x in" in what else y) / 0.25
        turn = theta if gripper else angle - theta
        return math.cos(turn) if "cosine" in what else math.sin(turn)

    for name, what in documented.items():
        for i in range(m) if "i" in name else [0]:
            pose = env.state.object_poses[i] if "i" in name else (*target, 0.0)
            expected = of(what, *pose, gripper=what.startswith("gripper"))
            assert observation["observation"][eval(name, {"i": i, "m": m})] == pytest.approx(expected, abs=1e-5), what


def documented_arguments(table: list[dict[str, str]]) -> dict[str, object]:
    """Names and defaults; those without a default are required."""
    defaults = {row["Argument"].strip("`"): row["Default"].strip("`") for row in table}
    return {k: eval(v, {"Split": Split}) if v else inspect.Parameter.empty for k, v in defaults.items()}


@pytest.mark.parametrize(
    ("section", "cls"), [("Arguments", ClutterManipulation), ("Use with torchrl", BatchedClutterEnv)]
)
def test_arguments(section, cls):
    parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]
    assert documented_arguments(tables(section)[0]) == {p.name: p.default for p in parameters}


def test_options_and_info():
    (options,), (info,) = tables("Reset options"), tables("Info")
    assert {row["Option"].strip("`") for row in options} == set(RESET_OPTIONS)
    env = gymnasium.make("visualrhp/ClutterManipulation-v0")
    assert [row["Key"].strip("`") for row in info] == list(env.reset(seed=0)[1])


def test_numbers_in_the_text():
    distribution = SceneDistribution()
    near, far = (100 * distance for distance in distribution.start_distance)
    for words in (
        f"{ACTION_REWARD:g} for every action, and {DROP_REWARD:g} instead",
        f"{MAX_EPISODE_ACTIONS} actions without either",
        f"square surface of {distribution.surface_side:g} m",
        f"{distribution.num_objects[0]} to {distribution.num_objects[1]} objects",
        f"of {distribution.num_vertices[0]} to {distribution.num_vertices[1]} vertices",
        f"target region of {100 * distribution.target_radius:g} cm radius",
        f"{near:g} to {far:g} cm inside an edge",
        f"to within {math.degrees(distribution.start_angle):.0f}°",
    ):
        assert words in " ".join(TEXT.split()), words
