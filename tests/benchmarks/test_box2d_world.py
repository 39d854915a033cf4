"""The world in Box2D is the same world: commands, friction, grasps and drops."""

from __future__ import annotations

import math
import re
from typing import get_args

import numpy as np
import pytest

from visualrhp.scene import ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.simulation import ContinuousActionSpace, TransitionModel
from visualrhp.simulation.action_spaces import DiscreteActionSpace
from visualrhp.types import State

pytest.importorskip("Box2D")

from tests.benchmarks import box2d
from tests.benchmarks.box2d_world import Box2DWorld, SurfaceLaw
from tests.benchmarks.timing import QUICK

BOX = [[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]]
LAWS = get_args(SurfaceLaw)


def task(*poses: tuple[float, float, float], outline: list[list[float]] = BOX) -> TaskInstance:
    shapes = tuple(ObjectShape.centred(outline) for _ in poses)
    state = State.create([-0.1, 0.0, 0.0], 0.085, False, poses)
    return TaskInstance(Scene(TargetRegion([0.2, 0.2]), shapes), state)


def after(instance: TaskInstance, law: SurfaceLaw, *actions: list[float]) -> tuple[State, State]:
    """The state after the actions, in Box2D and in the simulator."""
    space = ContinuousActionSpace()
    world, model, state = Box2DWorld(instance, space, law), TransitionModel(instance.scene, space), instance.state
    for action in actions:
        world.act(np.array(action))
        state = model.advance(state, np.array(action))
    return world.observe()[1], state


@pytest.mark.parametrize("law", LAWS)
def test_the_gripper_arrives_where_commanded(law: SurfaceLaw) -> None:
    ours, simulated = after(task((0.2, 0.2, 0.0)), law, [0.5, -0.7, 0.8, 1.0], [-0.2, 0.1, -0.3, 1.0])
    assert ours.vector == pytest.approx(simulated.vector, abs=1e-3)
    assert ours.gripper_closed and ours.gripper_opening == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_a_centred_push_moves_the_object_as_far(law: SurfaceLaw) -> None:
    """With closed fingers, whose tips meet the middle of the face."""
    ours, simulated = after(task((-0.03, 0.0, 0.0)), law, [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0])
    assert simulated.object_poses[0, 0] > 0.03
    assert ours.object_poses[0] == pytest.approx(simulated.object_poses[0], abs=2e-3)


@pytest.mark.parametrize("law", LAWS)
def test_a_grasped_object_follows(law: SurfaceLaw) -> None:
    ours, simulated = after(
        task((-0.085, 0.0, 0.0)), law, [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.8, 1.0], [-0.4, 0.5, 0.0, 1.0]
    )
    assert ours.gripper_opening == pytest.approx(0.04, abs=2e-3)
    held = [np.linalg.norm(state.object_poses[0, :2] - state.gripper_pose[:2]) for state in (ours, simulated)]
    assert held[0] == pytest.approx(held[1], abs=8e-3)
    assert ours.object_poses[0, 2] == pytest.approx(simulated.object_poses[0, 2], abs=0.1)


def test_the_laws_resist_turning_differently() -> None:
    """Pushed beside its centre; with the crude law, sliding does not make turning easier."""
    wide = [[-0.02, -0.06], [0.02, -0.06], [0.02, 0.06], [-0.02, 0.06]]
    pushed = [task((-0.03, 0.03, 0.0), outline=wide), *[[0.0, 0.0, 0.0, 1.0], [0.8, 0.0, 0.0, 1.0]]]
    turns = {law: abs(after(pushed[0], law, *pushed[1:])[0].object_poses[0, 2]) for law in LAWS}  # pyright: ignore
    simulated = abs(after(pushed[0], "close", *pushed[1:])[1].object_poses[0, 2])  # pyright: ignore
    assert turns["close"] == pytest.approx(simulated, abs=math.radians(8.0))
    assert turns["crude"] < turns["close"] - math.radians(5.0)


def test_discrete_actions_and_many_vertices() -> None:
    """Box2D has at most 8 vertices per polygon; a disc of 30 is divided."""
    angles = 2.0 * np.pi * np.arange(30) / 30
    disc = 0.03 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    instance = task((0.0, 0.0, 0.0), outline=disc.tolist())
    world = Box2DWorld(instance, DiscreteActionSpace(), "close")
    for _ in range(3):
        world.act(0)
    pose = world.observe()[1].object_poses[0]
    assert pose[0] > 0.01 and np.isfinite(pose).all()


def test_the_section_prints_a_row_per_planner_and_action_space(capsys: pytest.CaptureFixture[str]) -> None:
    box2d.run(QUICK, {"Greedy": ("planner=greedy",)})
    rows = re.findall(r"^(continuous|discrete) +Greedy +crude .*%.*; close .*%", capsys.readouterr().out, re.M)
    assert rows == ["continuous", "discrete"]
