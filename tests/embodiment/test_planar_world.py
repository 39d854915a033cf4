"""The cell's tasks in the planner's simulator."""

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarKinematics, pushing_task
from visualrhp.embodiment.planar_world import PlanarWorld
from visualrhp.errors import UnreachableError
from visualrhp.simulation import TransitionModel, make_action_space

SPACE = make_action_space("continuous")
FORWARD = np.array([1.0, 0.0, 0.0, 1.0])


def made(**options) -> PlanarWorld:
    task = pushing_task()
    return PlanarWorld(task.scene, task.state, SPACE, **options)


def test_it_is_the_planner_s_simulator():
    task, world, state = pushing_task(), made(), pushing_task().state
    seen = []
    world.followers.append(seen.append)
    for _ in range(3):
        world.act(FORWARD)
        state = TransitionModel(task.scene, SPACE).advance(state, FORWARD)
        assert world.observe()[1] == state
    assert seen == [world.observe()[0]] * 3 and len(world.latencies) == 4
    assert world.joints is None


def test_friction_and_masses_are_those_of_the_world_only():
    same, other = made(frictions=[0.3], masses=[0.04**2]), made(frictions=[0.05])
    exact = made()
    assert other.observe()[0] == exact.observe()[0]
    for world in (same, other, exact):
        for _ in range(3):
            world.act(FORWARD)
    np.testing.assert_allclose(same.observe()[1].vector, exact.observe()[1].vector, atol=1e-6)
    assert np.abs(other.observe()[1].vector - exact.observe()[1].vector).max() > 1e-5


def test_the_arm_has_to_be_able_to_make_the_motions():
    kinematics = PlanarKinematics()
    world = made(kinematics=kinematics, joints=kinematics.joints(pushing_task().state.gripper_pose))
    back = np.array([-1.0, 0.0, 0.0, -1.0])
    world.act(back)
    world.act(back)
    assert kinematics.forward(world.joints).x == pytest.approx(-0.4)
    state = world.observe()[1]
    with pytest.raises(UnreachableError):
        world.act(back)
    assert world.observe()[1] == state
