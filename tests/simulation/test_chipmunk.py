"""The space that restarts exactly: textbook collisions, sleep, and the same bits after any history."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from visualrhp.simulation.chipmunk import ChipmunkWorld, Space, lib
from visualrhp.types import FloatArray

SQUARE = np.array([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])
ORIGIN = (0.0, 0.0)
RIGID = 1e30
"""A moment of inertia that no impulse turns."""


def regular(num_vertices: int) -> FloatArray:
    angles = np.linspace(0.0, 2.0 * np.pi, num_vertices, endpoint=False)
    return 0.02 * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def world_of(*bodies: dict[str, Any], moment: float = RIGID) -> ChipmunkWorld:
    """Squares with these arguments of :meth:`ChipmunkWorld.add_body`, without joints."""
    world = ChipmunkWorld(len(bodies), len(bodies), 0)
    for arguments in bodies:
        world.add_body(**{"mass": 0.1, "moment": moment, "parts": [SQUARE]} | arguments)
    world.freeze()
    return world


def run(world: ChipmunkWorld, poses: Sequence[float], velocities: Sequence[tuple], steps: int = 200) -> FloatArray:
    """[bodies, 3] poses after ``steps`` of a millisecond, from x, y and rotation [m/s, rad/s] of the first bodies."""
    space = world.begin(poses)
    set_velocities(world, velocities)
    step(space, steps)
    end = world.poses(space)
    lib.cpSpaceFree(space)
    return end


def set_velocities(world: ChipmunkWorld, velocities: Sequence[tuple]) -> None:
    for body, (x, y, rotation) in zip(world.bodies, velocities, strict=False):
        lib.cpBodySetVelocity(body, (x, y))
        lib.cpBodySetAngularVelocity(body, rotation)


def step(space: Space, steps: int) -> None:
    for _ in range(steps):
        lib.cpSpaceStep(space, 1e-3)


def test_a_free_body_moves_uniformly_and_its_angle_is_not_wrapped() -> None:
    world = world_of({"moment": 1e-4}, {"mass": 0.0})
    end = run(world, [0.0, 0.1, 3.0, 1.0, 1.0, -9.0], [(0.5, -0.25, 30.0), (0.0, 2.0, -40.0)])
    assert end == pytest.approx(np.array([[0.1, 0.05, 9.0], [1.0, 1.4, -17.0]]))


def test_poses_come_back_bit_exactly_in_the_order_of_the_bodies() -> None:
    """Bodies that sleep come last in the space, and not in the result."""
    world = world_of({"asleep": True}, {}, {"asleep": True}, {"mass": 0.0}, {})
    given = np.random.default_rng(0).uniform(-5.0, 5.0, (5, 3))
    space = world.begin(given.ravel())
    assert world.poses(space).tobytes() == given.tobytes()
    assert world.top_speed(space) == 0.0
    lib.cpSpaceFree(space)


def test_the_top_speed_is_the_largest_component() -> None:
    world = world_of({}, {}, {})
    for velocities, speed in (
        ([(0.1, 0.2, 0.0), (0.0, -0.7, 0.3)], 0.7),
        ([(0.0, 0.0, -3.0)], 3.0),
        ([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.25, 0.0, 0.0)], 0.25),
    ):
        space = world.begin(np.arange(9.0))
        set_velocities(world, velocities)
        assert world.top_speed(space) == speed
        lib.cpSpaceFree(space)


@pytest.mark.parametrize(("mass", "speed"), [(0.1, 0.25), (0.3, 0.125), (0.025, 0.4)])
def test_an_inelastic_collision_by_hand(mass: float, speed: float) -> None:
    """0.1 kg at 0.5 m/s meets a body at rest: they go on together at 0.5 m/s x 0.1 kg / (0.1 kg + mass)."""
    world = world_of({}, {"mass": mass})
    space = world.begin([0.0, 0.0, 0.0, 0.05, 0.0, 0.0])
    set_velocities(world, [(0.5, 0.0, 0.0)])
    step(space, 100)
    velocities = [lib.cpBodyGetVelocity(body) for body in world.bodies]
    lib.cpSpaceFree(space)
    assert [velocity.x for velocity in velocities] == pytest.approx([speed, speed], rel=1e-3)


def test_nothing_stops_a_body_without_mass() -> None:
    end = run(world_of({"mass": 0.0}, {}), [0.0, 0.0, 0.0, 0.05, 0.0, 0.0], [(0.5, 0.0, 0.0)])
    assert end[0] == pytest.approx([0.1, 0.0, 0.0])
    assert end[1, 0] == pytest.approx(0.14, abs=1e-3)


def test_bodies_of_a_group_pass_through_each_other() -> None:
    poses = [0.0, 0.0, 0.0, 0.05, 0.0, 0.0]
    through = run(world_of({"group": 1}, {"group": 1}), poses, [(0.5, 0.0, 0.0)])
    assert through == pytest.approx(np.array([[0.1, 0.0, 0.0], [0.05, 0.0, 0.0]]))
    assert run(world_of({"group": 1}, {"group": 2}), poses, [(0.5, 0.0, 0.0)])[1, 0] > 0.06


def test_the_friction_of_a_contact_is_the_geometric_mean() -> None:
    """A block that slides at 1 m/s on a floor, under gravity, stops after v^2 / (2 mu g)."""
    floor = {"mass": 0.0, "parts": [np.array([[-1.0, -0.1], [1.0, -0.1], [1.0, 0.0], [-1.0, 0.0]])]}
    for frictions in ((0.4, 0.4), (0.2, 0.8), (0.9, 0.1)):
        world = world_of(*({**given, "friction": f} for given, f in zip(({}, floor), frictions, strict=True)))
        space = world.begin([0.0, 0.0199, 0.0, 0.0, 0.0, 0.0])
        lib.cpSpaceSetGravity(space, (0.0, -9.81))
        set_velocities(world, [(1.0, 0.0, 0.0)])
        step(space, 1000)
        assert world.top_speed(space) < 1e-2
        assert world.poses(space)[0, 0] == pytest.approx(1.0 / (2.0 * math.sqrt(math.prod(frictions)) * 9.81), rel=0.02)
        lib.cpSpaceFree(space)


def sleeper() -> ChipmunkWorld:
    """A free body, and one asleep that a force of 0.2 N holds to the ground."""
    world = ChipmunkWorld(2, 2, 1)
    world.add_body(0.1, RIGID, [SQUARE])
    body = world.add_body(0.1, RIGID, [SQUARE], asleep=True)
    world.add_joint("PivotJoint", (world.ground, body), (ORIGIN, ORIGIN), max_force=0.2, max_bias=0.0)
    world.freeze()
    return world


def test_a_sleeping_body_wakes_when_it_is_touched_and_slides_by_hand() -> None:
    """A push of 0.5 m/s leaves both at 0.25 m/s; the joint's 0.2 N stop their 0.2 kg after v^2 / (2 F / m) = 3.1 cm."""
    world = sleeper()
    poses = [0.0, 0.0, 0.0, 0.05, 0.0, 0.0]
    assert run(world, poses, [(0.0, 0.5, 0.0)])[1].tolist() == poses[3:]  # past it
    assert run(world, poses, [(0.5, 0.0, 0.0)], 1000)[1, 0] == pytest.approx(0.05 + 0.25**2 / 2.0, rel=0.03)


def test_joints_hold_what_they_connect() -> None:
    """A wheel on a pin of a moving body follows it; a motor turns it, positive rates clockwise."""
    world = ChipmunkWorld(2, 0, 2)
    carrier, wheel = world.add_body(0.0, 0.0), world.add_body(0.1, 1e-4)
    world.add_joint("PivotJoint", (carrier, wheel), ((0.1, 0.0), ORIGIN))
    world.add_joint("SimpleMotor", (carrier, wheel), (2.0,))
    world.freeze()
    end = run(world, [0.0, 0.0, 0.0, 0.1, 0.0, 0.0], [(0.5, 0.25, 0.0), (0.5, 0.25, 0.0)])
    assert end == pytest.approx(np.array([[0.1, 0.05, 0.0], [0.2, 0.05, -0.4]]), abs=2e-3)


@pytest.mark.parametrize("num_vertices", [4, 6, 48])  # few vertices are within the restored memory, many outside it
def test_a_motion_has_the_same_bits_after_any_other(num_vertices: int) -> None:
    parts = [regular(num_vertices)]
    world = world_of(*({"parts": parts, "friction": 0.5, "asleep": k > 0} for k in range(3)), moment=2e-5)
    poses = [0.0, 0.0, 0.1, 0.045, 0.005, 0.2, 0.05, 0.06, 0.3]
    first = run(world, poses, [(0.5, 0.1, 2.0)])
    assert not np.array_equal(first[1], poses[3:6])
    for velocity in ((-0.3, 0.0, 0.0), (0.9, 0.4, -5.0)):
        run(world, np.roll(poses, 3).tolist(), [velocity])
        assert run(world, poses, [(0.5, 0.1, 2.0)]).tobytes() == first.tobytes()


def test_a_mirrored_collision_is_the_mirror_image() -> None:
    world = world_of({"friction": 0.3}, {"friction": 0.3}, moment=2e-5)
    one = run(world, [0.0, 0.0, 0.3, 0.06, 0.01, -0.2], [(0.5, 0.02, 3.0)])
    other = run(world, [0.0, 0.0, -0.3, 0.06, -0.01, 0.2], [(0.5, -0.02, -3.0)])
    assert one[1, 0] > 0.07
    assert other == pytest.approx(one * (1.0, -1.0, -1.0), abs=1e-6)


def test_a_world_has_room_for_what_was_requested() -> None:
    world = ChipmunkWorld(1, 1, 1)
    body = world.add_body(0.1, 1.0, [SQUARE])
    world.add_joint("PivotJoint", (world.ground, body), (ORIGIN, ORIGIN))
    for add in (lambda: world.add_body(0.1, 1.0), lambda: world.add_joint("SimpleMotor", (world.ground, body), (0.0,))):
        with pytest.raises(ValueError, match="no memory for more bodies, shapes or joints than were requested"):
            add()


def test_a_world_that_is_no_longer_used_is_released() -> None:
    world = world_of({"parts": [regular(48)]})
    run(world, [0.0, 0.0, 0.0], [])
    reference = weakref.ref(world)
    del world
    gc.collect()
    assert reference() is None
