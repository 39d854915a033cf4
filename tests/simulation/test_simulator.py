"""The simulator is exactly Markov and physical (friction, grasps, symmetry)."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely

from tests.simulation.soak import overlap, soak_all
from visualrhp.errors import ActionError, SceneError
from visualrhp.scene import (
    Graspability,
    Gripper,
    ObjectShape,
    Scene,
    SceneDistribution,
    TargetRegion,
    geometry,
    graspability,
    sample_task_instance,
)
from visualrhp.simulation import DiscreteActionSpace, GripperMotion, Physics, TransitionModel
from visualrhp.simulation.chipmunk import ChipmunkWorld, lib
from visualrhp.simulation.simulator import Simulator, add_object
from visualrhp.streams import Split
from visualrhp.types import State, wrap_angle

BOX = ObjectShape([[-0.02, -0.015], [0.02, -0.015], [0.02, 0.015], [-0.02, 0.015]])
BROAD = ObjectShape([[-0.02, -0.03], [0.02, -0.03], [0.02, 0.03], [-0.02, 0.03]])
HOOK = ObjectShape.centred(
    [[-0.03, -0.03], [0.03, -0.03], [0.03, -0.015], [-0.015, -0.015], [-0.015, 0.03], [-0.03, 0.03]]
)
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
DISC = ObjectShape.centred(0.03 * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1))
TARGET = TargetRegion([0.2, 0.2])


def test_free_motion_arrives_where_commanded() -> None:
    scene = Scene(TARGET, (BOX,))
    start = State.create([0.0, 0.0, 0.4], 0.085, False, [[-0.2, -0.2, 0.0]])
    end = Simulator(scene, Physics()).advance(start, GripperMotion(forward=0.1, left=-0.05, rotation=0.8))
    expected = geometry.to_world(np.array([0.1, -0.05]), start.gripper_pose)
    assert end.gripper_pose == pytest.approx([*expected, 1.2], abs=1e-3)
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
    world = ChipmunkWorld(num_bodies=1, num_shapes=3, num_joints=5)
    body = add_object(world, shape, 9.81)
    world.freeze()
    space = world.begin([0.0, 0.0, 0.0])
    lib.cpBodyActivate(body)
    lib.cpBodySetVelocity(body, velocity)
    lib.cpBodySetAngularVelocity(body, spin)
    for _ in range(2000):
        lib.cpSpaceStep(space, 0.001)
    assert world.top_speed(space) < 1e-6
    x, y, angle = world.poses(space)[0]
    lib.cpSpaceFree(space)
    return float(np.hypot(x, y)), angle


@pytest.mark.parametrize("friction", [0.1, 0.3, 0.6])
def test_sliding_distance(friction: float) -> None:
    """An object sliding at v stops after v^2 / (2 mu g), whatever its mass."""
    for density in (0.5, 4.0):
        for angle in np.radians([0.0, 15.0, 30.0, 45.0]):
            shape = ObjectShape(BOX.outline, density, friction)
            distance, _ = slide(shape, (0.5 * np.cos(angle), 0.5 * np.sin(angle)), 0.0)
            assert distance == pytest.approx(0.5**2 / (2.0 * friction * 9.81), rel=0.02)


@pytest.mark.parametrize("turning_resistance", [0.7, 1.0, 1.5])
@pytest.mark.parametrize("outline", [BOX.outline, DISC.outline, HOOK.outline], ids=["box", "disc", "hook"])
def test_spin_down(outline: np.ndarray, turning_resistance: float) -> None:
    """A spinning object stops after w^2 I / (2 tau), with tau the friction moment of its area times the factor."""
    shape = ObjectShape(outline, turning_resistance=turning_resistance)
    _, angle = slide(shape, (0.0, 0.0), 20.0)
    rng = np.random.default_rng(0)
    points = rng.uniform(outline.min(axis=0), outline.max(axis=0), (40_000, 2))
    inside = points[shapely.contains_xy(shapely.Polygon(outline), points)]
    torque = turning_resistance * shape.friction * shape.mass * 9.81 * np.hypot(*inside.T).mean()
    assert angle == pytest.approx(20.0**2 * shape.moment_of_inertia / (2.0 * torque), rel=0.05)


def push(shape: ObjectShape, contact: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """[3] velocity of the centre [m/s] and angular velocity [rad/s] of an object that a rough tip pushes.

    The tip touches the left face at ``contact`` (from the centre) and moves with ``velocity`` [m/s].
    """
    world = ChipmunkWorld(num_bodies=2, num_shapes=2, num_joints=5)
    tip = world.add_body(0.0, 0.0, [np.array([[0.0, 0.0], [-0.01, 0.0008], [-0.01, -0.0008]])], friction=3.3)
    body = add_object(world, shape, 9.81)
    world.freeze()
    space = world.begin([contact[0] + 2e-5, contact[1], 0.0, 0.0, 0.0, 0.0])
    lib.cpSpaceSetIterations(space, 30)
    lib.cpSpaceSetCollisionSlop(space, 1e-4)
    lib.cpBodySetVelocity(tip, tuple(velocity))
    twists = []
    for _ in range(14):
        lib.cpSpaceStep(space, 0.002)
        v = lib.cpBodyGetVelocity(body)
        twists.append((v.x, v.y, lib.cpBodyGetAngularVelocity(body)))
    lib.cpSpaceFree(space)
    return np.mean(twists[8:], axis=0)


def pushed_quasi_statically(lever: float, contact: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """[3] the same by theory: a sticking contact and an ellipsoidal limit surface (Lynch et al., IROS 1992).

    The surface's half axes are the friction force, and the friction force times ``lever`` [m].
    """
    (x, y), (ux, uy) = contact, velocity
    scale = lever**2 + x**2 + y**2
    vx = ((lever**2 + x**2) * ux + x * y * uy) / scale
    vy = (x * y * ux + (lever**2 + y**2) * uy) / scale
    return np.array([vx, vy, (x * vy - y * vx) / lever**2])


def test_a_pushed_object_moves_as_quasi_static_theory_says() -> None:
    """The motion is within 22 degrees of the ellipsoidal limit surface's, 7 degrees on average, and turns as it does.

    Angles between (vx, vy, lever w). Under uniform pressure the limit surface is no ellipsoid either. The centre of
    rotation is on the same side of the centre of mass, and nearer by 60% at the most.
    """
    angles = []
    cases = [(DISC, -0.03, 0.0)] + [(BROAD, -0.02, height) for height in (-0.02, -0.01, 0.0, 0.005, 0.015, 0.025)]
    for shape, x, y in cases:
        unit = np.array([1.0, 1.0, shape.friction_lever])
        contact = np.array([x, y])
        for angle in np.radians([-40.0, -20.0, 0.0, 20.0, 40.0]):
            velocity = 0.02 * np.array([np.cos(angle), np.sin(angle)])
            found = push(shape, contact, velocity)
            expected = pushed_quasi_statically(shape.friction_lever, contact, velocity)
            cosine = (found * unit) @ (expected * unit) / np.linalg.norm(found * unit) / np.linalg.norm(expected * unit)
            angles.append(np.degrees(np.arccos(min(cosine, 1.0))))
            if abs(expected[2]) * shape.friction_lever > 3e-3:
                assert np.sign(found[2]) == np.sign(expected[2])
                distances = [np.hypot(*twist[:2]) / abs(twist[2]) for twist in (found, expected)]
                assert 0.4 < distances[0] / distances[1] < 1.1
    assert max(angles) < 22.0
    assert np.mean(angles) < 7.0


def test_heavier_and_rougher_objects_resist_more() -> None:
    """What pushes an object slowly feels its friction force mu m g, and the weaker of two pushers stops."""
    forces = {}
    for density, friction in ((1.0, 0.3), (2.0, 0.3), (1.0, 0.6)):
        shape = ObjectShape(BROAD.outline, density, friction)
        world = ChipmunkWorld(num_bodies=3, num_shapes=2, num_joints=6)
        drive = world.add_body(0.0, 0.0)
        pusher = world.add_body(0.01, 1e30, [np.array([[-0.02, -0.01], [0.0, -0.01], [0.0, 0.01], [-0.02, 0.01]])])
        add_object(world, shape, 9.81)
        joint = world.add_joint("PivotJoint", (drive, pusher), ((0.0, 0.0), (0.0, 0.0)))
        world.freeze()
        space = world.begin([-0.0201, 0.0, 0.0, -0.0201, 0.0, 0.0, 0.0, 0.0, 0.0])
        lib.cpSpaceSetCollisionSlop(space, 1e-4)
        lib.cpBodySetVelocity(drive, (0.02, 0.0))
        for _ in range(200):
            lib.cpSpaceStep(space, 0.005)
        forces[density, friction] = lib.cpConstraintGetImpulse(joint) / 0.005
        lib.cpSpaceFree(space)
        assert forces[density, friction] == pytest.approx(friction * shape.mass * 9.81, rel=0.05)
    assert forces[2.0, 0.3] > 1.8 * forces[1.0, 0.3]
    assert forces[1.0, 0.6] > 1.8 * forces[1.0, 0.3]


def test_momentum_and_energy_never_grow() -> None:
    """Sixty collisions of two objects, half of them without friction: no step adds energy, or momentum to the free."""
    rng = np.random.default_rng(3)
    for number in range(60):
        friction = 1e-9 if number % 2 else 0.3
        shapes = [
            ObjectShape(shape.outline, rng.uniform(0.5, 2.0), friction)
            for shape in (rng.choice(np.array([BOX, BROAD, HOOK, DISC], dtype=object)) for _ in range(2))
        ]
        world = ChipmunkWorld(num_bodies=2, num_shapes=6, num_joints=10)
        bodies = [add_object(world, shape, 9.81) for shape in shapes]
        world.freeze()
        angles = rng.uniform(-np.pi, np.pi, 2)
        space = world.begin([-0.05, rng.uniform(-0.01, 0.01), angles[0], 0.05, 0.0, angles[1]])
        lib.cpSpaceSetCollisionSlop(space, 1e-4)
        lib.cpBodyActivate(bodies[0])
        lib.cpBodySetVelocity(bodies[0], (1.0, 0.0))
        before: tuple[float, float] | None = None
        met = False
        for _ in range(150):
            lib.cpSpaceStep(space, 0.002)
            velocities = [lib.cpBodyGetVelocity(body) for body in bodies]
            moving = zip(shapes, velocities, strict=True)
            momentum = float(np.linalg.norm(sum(shape.mass * np.array([v.x, v.y]) for shape, v in moving)))
            energy = sum(lib.cpBodyKineticEnergy(body) for body in bodies)
            if before is not None:
                assert energy <= before[1] * (1.0 + 1e-3) + 1e-12
                if friction < 1e-6:
                    assert momentum == pytest.approx(before[0], rel=1e-3)
            before = momentum, energy
            met = met or velocities[1].x > 0.01
        lib.cpSpaceFree(space)
        assert met


HELD = [
    GripperMotion(rotation=np.radians(50.0)),
    GripperMotion(forward=0.1),
    GripperMotion(left=0.1),
    GripperMotion(forward=-0.1),
    GripperMotion(left=-0.1),
]


def holds_and_releases(shape: ObjectShape, angle: float) -> tuple[bool, bool]:
    """Whether an object stays in the closed gripper through ``HELD``, and stays behind when it opens.

    The object lies between the fingers, turned by ``angle`` [rad] and right before the palm if it is long.
    """
    simulator = Simulator(Scene(TARGET, (shape,)), Physics())
    backmost = float((shape.outline @ geometry.rotation_matrix(angle).T)[:, 0].min())
    ahead = max(0.0, Gripper().palm[:, 0].max() + 0.001 - backmost)
    state = State.create([0.0, 0.0, 0.0], 0.085, False, [[ahead, 0.0, angle]])
    state = simulator.advance(state, GripperMotion(closed=True))
    grasped = geometry.to_body(state.object_poses[0, :2], state.gripper_pose)
    for motion in HELD:
        state = simulator.advance(state, motion)
    moved = geometry.to_body(state.object_poses[0, :2], state.gripper_pose)
    before = state.object_poses[0, :2]
    for motion in (GripperMotion(closed=False), GripperMotion(forward=-0.1)):
        state = simulator.advance(state, motion)
    return bool(np.hypot(*(moved - grasped)) < 0.015), bool(np.hypot(*(state.object_poses[0, :2] - before)) < 0.02)


def test_graspable_objects_are_grasped_held_and_released() -> None:
    """200 of the pool that fit from any side: through a 50 degree turn and 10 cm in every direction."""
    shapes = graspable_objects("always", 200)
    results = np.array([holds_and_releases(shape, 0.3 * number) for number, shape in enumerate(shapes)])
    assert results.mean(axis=0) == pytest.approx([1.0, 1.0], abs=0.02)


def test_long_objects_are_held_across() -> None:
    """100 of those that fit from some directions: most are held, unless they taper where the fingers reach them."""
    shapes = graspable_objects("directional", 100)
    results = np.array([holds_and_releases(shape, narrow_direction(shape)) for shape in shapes])
    assert (results.mean(axis=0) > (0.65, 0.95)).all()


def graspable_objects(kind: Graspability, count: int) -> list[ObjectShape]:
    """The first objects of the random pool that are graspable in this way."""
    found: list[ObjectShape] = []
    for index in itertools.count():
        instance = sample_task_instance(SceneDistribution((7, 7)), 0, Split.TUNING, index)
        found += [shape for shape in instance.scene.objects if graspability(shape, Gripper().stroke) == kind]
        if len(found) >= count:
            break
    return found[:count]


def narrow_direction(shape: ObjectShape) -> float:
    """Angle [rad] at which the object is narrowest from finger to finger."""
    angles = np.linspace(0.0, np.pi, 90, endpoint=False)
    sideways = [(shape.outline @ geometry.rotation_matrix(angle).T)[:, 1] for angle in angles]
    return float(angles[np.argmin([np.ptp(y) for y in sideways])])


def test_wide_objects_are_not_grasped() -> None:
    """Whatever is wider than the stroke stays where it is when the closed gripper moves away."""
    for half_width in (0.043, 0.05, 0.06):
        outline = np.array([[-0.02, -half_width], [0.02, -half_width], [0.02, half_width], [-0.02, half_width]])
        simulator = Simulator(Scene(TARGET, (ObjectShape(outline),)), Physics())
        state = State.create([0.0, 0.0, 0.0], 0.085, False, [[0.0425, 0.0, 0.0]])
        for motion in (GripperMotion(closed=True), GripperMotion(forward=-0.1)):
            state = simulator.advance(state, motion)
        assert state.object_poses[0, 0] > 0.035


def test_nothing_passes_through_anything() -> None:
    """The thinnest objects stay ahead of the gripper's back, front and side, and of each other, at full speed."""
    sliver = ObjectShape([[-0.045, -0.0015], [0.045, -0.0015], [0.045, 0.0015], [-0.045, 0.0015]])
    simulator = Simulator(Scene(TARGET, (sliver,) * 3), Physics())
    for motion, direction, gap in (
        (GripperMotion(forward=0.1, closed=True), 0.0, 0.03),
        (GripperMotion(forward=-0.1, closed=True), np.pi, 0.1),
        (GripperMotion(left=0.1, closed=True), np.pi / 2, 0.07),
        (GripperMotion(left=0.1, rotation=np.radians(50.0), closed=False), np.pi / 2, 0.09),
    ):
        ahead = np.array([np.cos(direction), np.sin(direction)])
        poses = [[*(ahead * (gap + 0.006 * k)), direction + np.pi / 2] for k in range(3)]
        state = simulator.advance(State.create([0.0, 0.0, 0.0], 0.085, False, poses), motion)
        places = state.object_poses[:, :2] @ ahead
        assert (np.diff(places) > 0.001).all()
        assert places[0] - state.gripper_pose[:2] @ ahead > 0.02
        assert not overlap(simulator.scene, state, 0.002)


def test_an_object_that_is_not_convex_collides_as_drawn() -> None:
    """A finger goes into the notch of a hook without touching it, and moves the hook where the outline is."""
    simulator = Simulator(Scene(TARGET, (HOOK,)), Physics())
    corner = HOOK.outline[3]  # the inner one
    start = State.create([0.0, 0.0, 0.0], 0.0, True, [[*(corner + (0.05, 0.02)), -np.pi]])  # it turns that way, too
    hull = shapely.Polygon(geometry.to_world(HOOK.outline, start.object_poses[0])).convex_hull
    inside = simulator.advance(start, GripperMotion(forward=0.01))
    fingers = [shapely.Polygon(outline) for outline in simulator.scene.gripper.outlines(inside.gripper_pose, 0.0)[1:]]
    assert any(hull.intersection(finger).area > 1e-5 for finger in fingers)
    assert np.array_equal(inside.object_poses, start.object_poses)
    pushed = simulator.advance(inside, GripperMotion(forward=0.05))
    assert pushed.object_poses[0, 0] > start.object_poses[0, 0] + 0.01
    assert not overlap(simulator.scene, pushed, 0.001)


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


def test_a_soak_of_random_and_adversarial_actions() -> None:
    """Nothing diverges, nothing is more than 2 mm into anything at rest; what is at rest stays there."""
    findings = soak_all(2800)
    assert findings.actions.total() == 2800
    assert not findings.worst
    assert findings.restless <= 3
    assert findings.creep < 0.02  # a motion that did not come to rest, about one in 2,000


def test_untouched_objects_stay_bit_exactly() -> None:
    instance = sample_task_instance(SceneDistribution(num_objects=(7, 7)), 0, Split.TUNING, 0)
    model = TransitionModel(instance.scene, DiscreteActionSpace())
    assert np.array_equal(model.simulate(instance.state, 6).next_state.object_poses, instance.state.object_poses)


def test_errors() -> None:
    simulator = Simulator(Scene(TARGET, (BOX,)), Physics())
    with pytest.raises(SceneError, match="2 objects and the scene 1"):
        simulator.advance(State.create([0, 0, 0], 0.085, False, np.zeros((2, 3))), GripperMotion())
    with pytest.raises(SceneError, match="finite"):
        State.create([0.0, np.nan, 0.0], 0.085, False, [[0.0, 0.0, 0.0]])
    for displacement in (0.2, np.nan, np.inf):
        with pytest.raises(ActionError, match="at most"):
            GripperMotion(forward=displacement)
