"""Parameters of the simulation: ranges, and what they do to a motion."""

from __future__ import annotations

import pickle
from dataclasses import FrozenInstanceError, asdict, fields, replace
from typing import Any

import numpy as np
import pytest

from visualrhp.errors import ConfigError
from visualrhp.parameters import validated
from visualrhp.scene import Gripper, ObjectShape, Scene, TargetRegion
from visualrhp.scene.scene import square_edges
from visualrhp.scene.start import start_faults
from visualrhp.simulation import GripperMotion, Physics
from visualrhp.simulation.physics import least_motion_steps
from visualrhp.simulation.simulator import Simulator
from visualrhp.types import State

BOX = ObjectShape([[-0.02, -0.015], [0.02, -0.015], [0.02, 0.015], [-0.02, 0.015]])
SCENE = Scene(TargetRegion([0.2, 0.2]), (BOX,))


@pytest.mark.parametrize(
    "parameters",
    [
        {"time_step": 0.0},
        {"time_step": float("inf")},
        {"motion_steps": 0},
        {"motion_steps": 50.0},
        {"settle_steps": 0},
        {"rest_speed": -1e-3},
        {"iterations": 0},
        {"grip_steps": -1},
        {"grip_iterations": 0},
        {"gravity": 0.0},
        {"contact_slop": -1.0},
        {"overlap_correction": 0.0},
        {"overlap_correction": 1.0},
        {"joint_correction": float("nan")},
        {"gripper_density": 0.0},
        {"gripper_friction": -0.1},
        {"squeezing_force": 0.0},
    ],
)
def test_a_parameter_out_of_range_is_named(parameters: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"^{next(iter(parameters))}="):
        Physics(**parameters)


def test_a_grasp_builds_up_within_the_motion() -> None:
    assert Physics(grip_steps=50).grip_steps == Physics(grip_steps=0, motion_steps=50).motion_steps
    with pytest.raises(ConfigError, match=r"grip_steps=51: it should be between 0 and motion_steps=50"):
        Physics(grip_steps=51)
    with pytest.raises(ConfigError, match="grip_steps=3"):
        Physics(motion_steps=2)


BAR = ObjectShape.centred([[-0.003, -0.06], [0.003, -0.06], [0.003, 0.06], [-0.003, 0.06]])
"""6 mm thin."""


def test_a_gripper_does_not_pass_through_a_bar() -> None:
    """With the fewest steps that are accepted, fingertips push a thin bar before them; with fewer, they would not."""
    scene = Scene(TargetRegion([0.2, 0.2]), (BAR,))
    start = State.create([-0.03, 0, 0], 0.0, True, [[0, 0, 0]])
    least = least_motion_steps(Gripper().finger_thickness)
    assert least == 19
    for steps in (50, 30, 20, least):
        end = Simulator(scene, Physics(motion_steps=steps)).advance(start, GripperMotion(forward=0.1, closed=True))
        tips = end.gripper_pose[0] + 0.02
        assert 0.0 < end.object_poses[0, 0] - tips < 0.06
    for steps in (least - 1, 5, 2, 1):
        with pytest.raises(ConfigError, match=rf"^motion_steps={steps} .* at least {least}, since the gripper would"):
            Physics(motion_steps=steps, grip_steps=1)


@pytest.mark.parametrize("steps", [19, 50])
@pytest.mark.parametrize("thickness", [0.00301, 0.006])
def test_bars_stay_before_the_gripper_whatever_its_motion(steps: int, thickness: float) -> None:
    bar = ObjectShape.centred(np.array([[-0.5, -0.06], [0.5, -0.06], [0.5, 0.06], [-0.5, 0.06]]) * (thickness, 1.0))
    scene = Scene(TargetRegion([0.9, 0.9]), (bar,), square_edges(2.0))
    simulator = Simulator(scene, Physics(motion_steps=steps))
    rng = np.random.default_rng(0)
    for forward, left, turn in ((0.1, 0, 0), (0, 0.1, 0), (0.1, 0.1, 0), (0, 0.1, 0.87), (0, -0.1, 0.87), (-0.1, 0, 0)):
        for _ in range(4):
            ahead = np.array([forward, left]) / np.hypot(forward, left)
            away, aside = rng.uniform(0.06, 0.075) + 0.04 * (forward < 0.0), rng.uniform(-0.03, 0.03)
            place = away * ahead + aside * np.array([-ahead[1], ahead[0]])
            closed = bool(rng.integers(2))
            pose = (*place, np.arctan2(ahead[1], ahead[0]))
            start = State.create([0, 0, 0], 0.0 if closed else 0.085, closed, [pose])
            if list(start_faults(scene, start)):
                continue
            end = simulator.advance(start, GripperMotion(forward, left, turn, closed))
            assert not list(start_faults(scene, end)), "deep in the gripper"
            assert (end.object_poses[0, :2] - start.object_poses[0, :2]) @ ahead > -1e-3, "behind the gripper"


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (
            {"time_step": 1e-4},
            r"^time_step=0.0001 is out of range: with motion_steps=50, .* 28.3 m/s .* at least 0.0014",
        ),
        ({"time_step": 0.1, "rest_speed": 0.1}, "^rest_speed=0.1 is out of range: .* 10 mm in a step"),
        ({"time_step": 10.0}, "^time_step=10.0 is out of range: it should be a number, above 0 and at most 0.1"),
        ({"iterations": 10**9}, "^iterations=1000000000 is out of range"),
        ({"settle_steps": 10**6}, "^settle_steps=1000000"),
        ({"gravity": 1e300}, "^gravity="),
    ],
)
def test_what_a_time_step_cannot_resolve_is_refused(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Physics(**parameters)


@pytest.mark.parametrize("name", ["finger_thickness", "palm_length", "palm_front_width", "finger_length"])
def test_a_part_of_the_gripper_that_is_too_thin_for_a_step_is_refused(name: str) -> None:
    gripper = replace(Gripper(), **{name: 0.001})
    scene = Scene(TargetRegion([0.2, 0.2]), (BOX,), gripper=gripper)
    with pytest.raises(
        ConfigError, match=rf"^gripper.{name}=0.001: .* at least 0.0027 m, or physics.motion_steps .* 71"
    ):
        Simulator(scene, Physics())
    Simulator(scene, Physics(motion_steps=71))


def test_parameters_are_values() -> None:
    physics = Physics(gripper_friction=0.5)
    assert pickle.loads(pickle.dumps(physics)) == physics == validated(Physics, asdict(physics))
    assert hash(physics) == hash(replace(Physics(), gripper_friction=0.5)) and physics != Physics()
    with pytest.raises(FrozenInstanceError):
        physics.gravity = 1.62  # pyright: ignore[reportAttributeAccessIssue]


CHANGED: dict[str, Any] = {
    "time_step": 0.009,
    "motion_steps": 45,
    "settle_steps": 5,
    "rest_speed": 0.1,
    "iterations": 20,
    "grip_steps": 6,
    "grip_iterations": 50,
    "gravity": 5.0,
    "contact_slop": 1e-4,
    "overlap_correction": 0.3,
    "joint_correction": 0.3,
    "gripper_density": 2.0,
    "gripper_friction": 0.6,
    "squeezing_force": 0.05,
}


def test_every_parameter_changes_a_motion() -> None:
    """A gripper pushes one box and closes around another: none of the parameters is forgotten."""
    assert set(CHANGED) == {field.name for field in fields(Physics)}
    scene = Scene(TargetRegion([0.2, 0.2]), (BOX, BOX))
    start = State.create([0, 0, 0], 0.06, True, [[0.0, 0.004, 0.3], [0.08, 0.01, -0.2]])
    motion = GripperMotion(forward=0.1, left=0.02, rotation=0.2)
    ends = [
        Simulator(scene, Physics(**changes)).advance(start, motion)
        for changes in ({}, *({name: value} for name, value in CHANGED.items()))
    ]
    assert len(set(ends)) == len(ends)


@pytest.mark.parametrize(
    "physics", [Physics(), Physics(motion_steps=100), Physics(time_step=0.02), Physics(gravity=20.0)]
)
def test_a_pushed_object_slides_on_by_hand(physics: Physics) -> None:
    """Flat before the palm, a box moves 10 cm with it at v, and then v^2 / (2 mu g) on its own."""
    touching = float(SCENE.gripper.palm[:, 0].max()) + 0.02
    start = State.create([0.0, 0.0, 0.0], 0.085, False, [[touching, 0.0, 0.0]])
    end = Simulator(SCENE, physics).advance(start, GripperMotion(forward=0.1))
    speed = 0.1 / (physics.motion_steps * physics.time_step)
    slide = speed**2 / (2.0 * BOX.friction * physics.gravity)
    assert end.object_poses[0] == pytest.approx([touching + 0.1 + slide, 0.0, 0.0], abs=1.5e-3)


def test_a_shorter_time_step_pushes_alike() -> None:
    """A box that the palm turns, in 50 to 400 steps of half a second: the same within 1.5 mm and 1 degree."""
    start = State.create([0.0, 0.0, 0.0], 0.085, False, [[0.02, 0.004, 0.3]])
    motion = GripperMotion(forward=0.1, left=0.02, rotation=0.2)
    ends = [
        Simulator(SCENE, Physics(time_step=0.5 / steps, motion_steps=steps)).advance(start, motion)
        for steps in (50, 100, 400)
    ]
    assert ends[0].object_poses[0, 0] > 0.09
    for end in ends[1:]:
        assert end.gripper_pose == pytest.approx(ends[0].gripper_pose, abs=1e-6)
        assert end.object_poses[0, :2] == pytest.approx(ends[0].object_poses[0, :2], abs=1.5e-3)
        assert end.object_poses[0, 2] == pytest.approx(ends[0].object_poses[0, 2], abs=np.radians(1.0))


def test_a_free_gripper_does_not_depend_on_what_it_does_not_touch() -> None:
    """Without a contact, friction and gravity are irrelevant."""
    away = State.create([-0.1, -0.1, 0.0], 0.085, False, [[0.2, 0.2, 0.0]])
    ends = [
        Simulator(SCENE, physics).advance(away, GripperMotion(forward=0.05, left=-0.02))
        for physics in (Physics(), Physics(gravity=1.62, gripper_friction=0.9, contact_slop=1e-4))
    ]
    assert ends[0] == ends[1]
    assert ends[0].gripper_pose == pytest.approx([-0.05, -0.12, 0.0], abs=1e-9)
