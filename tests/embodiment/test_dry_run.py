"""A dry run: motions are checked from where the arm would be, and none is commanded."""

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, PlanarPerception, pushing_task
from tests.embodiment.test_robot_world import FORWARD, Scripted
from visualrhp.embodiment.dry_run import DryRunWorld, ReadOnlyCell
from visualrhp.errors import CellFault
from visualrhp.execution import run_episode
from visualrhp.simulation import TransitionModel, make_action_space

CONTINUOUS = make_action_space("continuous")


class Untouchable(PlanarCell):
    """Fails if it is commanded."""

    def follow(self, trajectory):
        raise AssertionError("commanded")

    def move_gripper(self, opening):
        raise AssertionError("commanded")


def run(*actions):
    cell = Untouchable(pushing_task())
    model = TransitionModel(cell.scene, CONTINUOUS)

    def imagine(scene, state, action):
        return model.advance(state, action)

    world = DryRunWorld(cell, PlanarPerception(cell), PlanarKinematics(), CONTINUOUS, imagine)
    result = run_episode(Scripted(*actions), world, model, np.random.default_rng(0))
    return cell, world, result


def test_the_episode_of_the_model_is_checked_and_nothing_moves():
    cell, world, result = run(FORWARD)
    assert result.success and cell.state == pushing_task().state
    assert len(world.motions) == result.num_actions
    for before, after in zip(world.motions, world.motions[1:], strict=False):
        np.testing.assert_array_equal(before.end, after.start)
    last = PlanarKinematics().forward(world.motions[-1].end)
    assert (last.x, last.y) == pytest.approx(result.episode.states[-1].gripper_position, abs=1e-6)
    text = world.motions[0].describe()
    assert "forward +5.0 cm" in text and "close" in text and "joints at the end" in text
    world.close()


def test_a_motion_that_is_refused_ends_the_episode():
    _, world, result = run(np.array([-1.0, 0.0, 0.0, -1.0]))
    assert result.outcome == "unreachable" and len(world.motions) == 2


def test_motions_of_the_fingers_alone_need_no_path():
    _, world, _ = run(np.array([0.0, 0.0, 0.0, 1.0]), FORWARD)
    assert world.motions[0].trajectory is None and world.motions[0].describe().startswith("close")


def test_a_cell_that_is_read_only_refuses_commands():
    cell = PlanarCell(pushing_task())
    read_only = ReadOnlyCell(cell)
    read_only.wait(0.1)
    assert read_only.now() == cell.now() and read_only.arm().time_s == cell.now()
    assert read_only.gripper().opening == cell.gripper().opening and read_only.frame().time_s == cell.now()
    for command in (lambda: read_only.follow(None), lambda: read_only.move_gripper(0.0)):
        with pytest.raises(CellFault, match="dry run"):
            command()
    read_only.stop()
    read_only.close()
    assert cell.num_stops == 0
    read_only.release()
    assert cell.num_stops == 1
