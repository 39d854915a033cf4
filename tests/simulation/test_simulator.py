"""The simulator is exact (Markov to the bit) and physical (friction, grasps, symmetry)."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest
import shapely

from visualrhp.errors import ConfigError, SceneError
from visualrhp.scene import (
    ObjectShape,
    Scene,
    SceneDistribution,
    Split,
    TargetRegion,
    TaskInstance,
    geometry,
    sample_task_instance,
)
from visualrhp.simulation import ContinuousActionSpace, DiscreteActionSpace, GripperMotion, Physics, TransitionModel
from visualrhp.simulation.simulator import Simulator, lib
from visualrhp.types import State, wrap_angle

BOX = ObjectShape([[-0.02, -0.015], [0.02, -0.015], [0.02, 0.015], [-0.02, 0.015]])
TARGET = TargetRegion([0.2, 0.2])


def small_instances(count: int) -> list[TaskInstance]:
    return [
        sample_task_instance(SceneDistribution(object_size="small"), 0, Split.TUNING, index) for index in range(count)
    ]


def random_walk(index: int, length: int) -> list[tuple[State, np.ndarray, State]]:
    """Transitions of a random walk towards the objects, so that there are contacts."""
    instance = sample_task_instance(SceneDistribution(num_objects=(4, 7)), 0, Split.TUNING, index)
    model = TransitionModel(instance.scene, ContinuousActionSpace())
    rng = np.random.default_rng(index)
    transitions, state = [], instance.state
    for _ in range(length):
        action = np.append(rng.uniform([-0.2, -0.5, -0.5], [1.0, 0.5, 0.5]), rng.choice([-1.0, 1.0]))
        following = model.simulate(state, action).next_state
        transitions.append((state, action, following))
        state = following if not model.is_dropped(following) else instance.state
    return transitions


def _replay(index: int, order: list[int]) -> list[bytes]:
    transitions = random_walk(index, 20)
    instance = sample_task_instance(SceneDistribution(num_objects=(4, 7)), 0, Split.TUNING, index)
    model = TransitionModel(instance.scene, ContinuousActionSpace())
    results = {i: model.simulate(*transitions[i][:2]).next_state.vector.tobytes() for i in order}
    return [results[i] for i in range(len(order))]


def test_markov_to_the_bit() -> None:
    """The same next states in another order, in a simulator with another history, and in another process."""
    for index in (0, 1, 3):  # walks with contacts
        transitions = random_walk(index, 20)
        expected = [following.vector.tobytes() for *_, following in transitions]
        moved = [not np.array_equal(s.object_poses, f.object_poses) for s, _, f in transitions]
        assert any(moved)
        order = [int(i) for i in np.random.default_rng(1).permutation(20)]
        assert _replay(index, order) == expected
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            assert pool.apply(_replay, (index, order[::-1])) == expected


def test_free_motion_arrives_where_commanded() -> None:
    scene = Scene(TARGET, (BOX,))
    start = State.create([0.0, 0.0, 0.4], 0.085, False, [[-0.2, -0.2, 0.0]])
    end = Simulator(scene, Physics()).advance(start, GripperMotion(forward=0.1, left=-0.05, rotation=0.8))
    expected = geometry.to_world(np.array([0.1, -0.05]), start.robot_pose)
    assert end.robot_pose == pytest.approx([*expected, 1.2], abs=1e-3)
    assert end.object_poses == pytest.approx(start.object_poses, abs=0.0)


def test_opening_follows_the_command() -> None:
    simulator = Simulator(Scene(TARGET, (BOX,)), Physics())
    start = State.create([0.0, 0.0, 0.0], 0.085, False, [[-0.2, -0.2, 0.0]])
    closed = simulator.advance(start, GripperMotion(closed=True))
    assert closed.gripper_closed
    assert closed.gripper_opening == pytest.approx(0.0, abs=1e-4)
    kept = simulator.advance(closed, GripperMotion(forward=0.05))
    assert kept.gripper_closed
    reopened = simulator.advance(kept, GripperMotion(closed=False))
    assert not reopened.gripper_closed
    assert reopened.gripper_opening == pytest.approx(0.085, abs=1e-4)


def slide(shape: ObjectShape, velocity: tuple[float, float], spin: float) -> tuple[float, float]:
    """Distance [m] and angle [rad] that an object with an initial velocity moves until friction stops it."""
    physics = Physics(time_step=0.001, settle_steps=1, motion_steps=1)
    simulator = Simulator(Scene(TARGET, (shape,)), physics)
    space = lib.cpSpaceNew()
    state = State.create([-0.2, -0.2, 0.0], 0.085, False, [[0.0, 0.0, 0.0]])
    simulator._set_up(space, state, closed=False)
    body = simulator._objects[0]
    lib.cpBodySetVelocity(body.pointer, velocity)
    lib.cpBodySetAngularVelocity(body.pointer, spin)
    for _ in range(2000):
        lib.cpSpaceStep(space, physics.time_step)
    x, y, angle = body.pose()
    lib.cpSpaceFree(space)
    return float(np.hypot(x, y)), angle


@pytest.mark.parametrize("friction", [0.1, 0.3, 0.6])
def test_sliding_distance(friction: float) -> None:
    """An object sliding at v stops after v^2 / (2 mu g), whatever its mass."""
    for density in (0.5, 4.0):
        shape = ObjectShape(BOX.outline, density, friction)
        distance, _ = slide(shape, (0.4, 0.3), 0.0)
        assert distance == pytest.approx(0.5**2 / (2.0 * friction * 9.81), rel=0.02)


def test_spin_down() -> None:
    """A spinning object stops after w^2 I / (2 tau), with tau the friction moment of its area."""
    _, angle = slide(BOX, (0.0, 0.0), 20.0)
    torque = BOX.friction * BOX.mass * 9.81 * BOX.friction_lever
    assert angle == pytest.approx(20.0**2 * BOX.moment_of_inertia / (2.0 * torque), rel=0.05)


def test_small_objects_are_grasped_held_and_released() -> None:
    """Held through a 50 degree turn and 10 cm moves in every direction; left behind when the gripper opens."""
    motions = [
        GripperMotion(rotation=np.radians(50.0)),
        GripperMotion(forward=0.1),
        GripperMotion(left=0.1),
        GripperMotion(forward=-0.1),
        GripperMotion(left=-0.1),
    ]
    held = released = 0
    instances = small_instances(40)
    for instance in instances:
        simulator = Simulator(Scene(TARGET, instance.scene.objects[:1]), Physics())
        state = State.create([0.0, 0.0, 0.0], 0.085, False, [[0.0, 0.0, instance.state.object_poses[0, 2]]])
        state = simulator.advance(state, GripperMotion(closed=True))
        grasped = geometry.to_body(state.object_poses[0, :2], state.robot_pose)
        for motion in motions:
            state = simulator.advance(state, motion)
        moved = geometry.to_body(state.object_poses[0, :2], state.robot_pose)
        held += float(np.hypot(*(moved - grasped))) < 0.015
        before = state.object_poses[0, :2]
        for motion in (GripperMotion(closed=False), GripperMotion(forward=-0.1)):
            state = simulator.advance(state, motion)
        released += float(np.hypot(*(state.object_poses[0, :2] - before))) < 0.02
    assert held >= 0.95 * len(instances)
    assert released >= 0.95 * len(instances)


def test_wide_objects_are_not_grasped() -> None:
    wide = ObjectShape([[-0.02, -0.05], [0.02, -0.05], [0.02, 0.05], [-0.02, 0.05]])
    simulator = Simulator(Scene(TARGET, (wide,)), Physics())
    state = State.create([0.0, 0.0, 0.0], 0.085, False, [[0.0425, 0.0, 0.0]])
    for motion in (GripperMotion(closed=True), GripperMotion(forward=-0.1)):
        state = simulator.advance(state, motion)
    assert state.object_poses[0, 0] > 0.03


def test_mirrored_scene_moves_as_the_mirror_image() -> None:
    """Pushes in the scene mirrored at the x axis: the same up to the solver's order of contacts."""
    mirrored_box = ObjectShape(BOX.outline[::-1] * (1.0, -1.0))
    pose = np.array([0.05, 0.012, 0.3])
    results = []
    for sign, shape in ((1.0, BOX), (-1.0, mirrored_box)):
        state = State.create([0.0, 0.0, 0.0], 0.085, False, [pose * (1.0, sign, sign)])
        simulator = Simulator(Scene(TARGET, (shape,)), Physics())
        state = simulator.advance(state, GripperMotion(forward=0.1, left=sign * 0.02, rotation=sign * 0.3))
        results.append(state.object_poses[0] * (1.0, sign, sign))
    assert results[0][0] > 0.06
    assert results[0] == pytest.approx(results[1], abs=2e-3)


def test_rotated_world_moves_alike() -> None:
    turn, rotation = 1.1, geometry.rotation_matrix(1.1)
    results = []
    for angle, matrix in ((0.0, np.eye(2)), (turn, rotation)):
        position = matrix @ (0.05, 0.012)
        state = State.create([0.0, 0.0, angle], 0.085, False, [[*position, angle + 0.3]])
        state = Simulator(Scene(TARGET, (BOX,)), Physics()).advance(state, GripperMotion(forward=0.1, left=0.02))
        x, y, theta = state.object_poses[0]
        results.append([*(matrix.T @ (x, y)), wrap_angle(theta - angle)])
    assert results[0] == pytest.approx(results[1], abs=1e-3)


def test_hardly_anything_overlaps_at_rest() -> None:
    """At most one state in a hundred with bodies more than 2 mm into each other (a jammed gripper), none by 6 mm."""
    overlaps = []
    for index in range(8):
        instance = sample_task_instance(SceneDistribution(num_objects=(4, 7)), 0, Split.TUNING, index)
        for *_, state in random_walk(index, 25):
            bodies = [
                shapely.Polygon(geometry.to_world(shape.outline, pose))
                for shape, pose in zip(instance.scene.objects, state.object_poses, strict=True)
            ]
            gripper = instance.scene.gripper.outlines(state.robot_pose, state.gripper_opening)
            bodies.append(shapely.union_all([shapely.Polygon(outline) for outline in gripper]))
            overlaps.append([_overlap(bodies, limit) for limit in (0.002, 0.006)])
    shares = np.mean(overlaps, axis=0)
    assert shares[0] <= 0.01
    assert shares[1] == 0.0


def _overlap(bodies: list, depth: float) -> bool:
    """Whether two bodies overlap even after each is shrunk by half of ``depth`` [m]."""
    shrunk = [body.buffer(-depth / 2.0) for body in bodies]
    return any(a.intersects(b) for i, a in enumerate(shrunk) for b in shrunk[:i])


def test_untouched_objects_stay_to_the_bit() -> None:
    instance = sample_task_instance(SceneDistribution(num_objects=(7, 7)), 0, Split.TUNING, 0)
    model = TransitionModel(instance.scene, DiscreteActionSpace())
    assert np.array_equal(model.simulate(instance.state, 6).next_state.object_poses, instance.state.object_poses)


def test_errors() -> None:
    simulator = Simulator(Scene(TARGET, (BOX,)), Physics())
    with pytest.raises(SceneError, match="2 objects and the scene 1"):
        simulator.advance(State.create([0, 0, 0], 0.085, False, np.zeros((2, 3))), GripperMotion())
    for parameters in ({"time_step": 0.0}, {"iterations": 0}, {"overlap_correction": 1.0}, {"contact_slop": -1.0}):
        with pytest.raises(ConfigError, match=next(iter(parameters))):
            Physics(**parameters)
