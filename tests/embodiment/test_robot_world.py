"""Episodes of a robot cell: looks, motions, latencies, and what it does when the scene changes."""

import contextlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.embodiment.planar_cell import PlanarCell, PlanarKinematics, PlanarPerception, planar_task, pushing_task
from visualrhp.embodiment.robot_model import GRIPPER_HEIGHT
from visualrhp.embodiment.robot_world import RobotWorld
from visualrhp.embodiment.true_state import TruePerception
from visualrhp.errors import ActionError, CellFault, UnreachableError
from visualrhp.execution import run_episode
from visualrhp.planning.planner import Decision, Planner
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation import TransitionModel, make_action_space
from visualrhp.simulation.action_spaces import GripperMotion
from visualrhp.types import State

CONTINUOUS = make_action_space("continuous")
FORWARD = np.array([0.5, 0.0, 0.0, 1.0])


class Scripted(Planner):
    """Answers with the actions in turn, the last one for ever."""

    name = "Scripted"

    def __init__(self, *actions, before=None):
        self.actions, self.before = actions, before

    def start(self, model, rng):
        waiting = list(self.actions)

        def policy(state):
            if self.before is not None:
                self.before(len(self.actions) - len(waiting))
            return Decision(waiting.pop(0) if len(waiting) > 1 else waiting[0])

        return policy


def make_world(cell, perception=None, space=CONTINUOUS, **options):
    return RobotWorld(cell, perception or PlanarPerception(cell), PlanarKinematics(), space, **options)


def run(cell, planner, **options):
    world = make_world(cell, **options)
    result = run_episode(planner, world, TransitionModel(cell.scene, CONTINUOUS), np.random.default_rng(0))
    return world, result


def test_an_episode_through_camera_and_joints_is_that_of_the_simulator():
    task = pushing_task()
    model = TransitionModel(task.scene, CONTINUOUS)
    cell = PlanarCell(task)
    world, result = run(cell, Scripted(FORWARD))
    state = task.state
    for seen, action in zip(result.episode.states[1:], result.episode.actions, strict=True):
        state = model.advance(state, action)
        np.testing.assert_allclose(seen.vector, state.vector, atol=1e-5)
    assert result.success and result.fault is None
    assert len(world.latencies) == result.num_actions + 1
    assert all(0.0 <= each.view_age_s <= 0.6 and each.motion_s > 0.3 for each in world.latencies[:-1])
    assert world.latencies[0].num_looks == 2 and all(each.num_looks == 1 for each in world.latencies[1:])


def test_the_true_state_can_take_the_place_of_the_camera():
    cell = PlanarCell(pushing_task())
    _, result = run(cell, Scripted(FORWARD), perception=TruePerception(lambda: (cell.scene, cell.state)))
    assert result.success and not cell.exposures


def test_followers_get_the_scene_of_every_look():
    cell, scenes = PlanarCell(pushing_task()), []
    world = make_world(cell)
    world.followers.append(scenes.append)
    world.observe()
    world.observe()
    assert scenes == [cell.scene], "a view that is still true is not taken again"
    world.act(FORWARD)
    world.observe()
    assert len(scenes) == 2


def test_discrete_actions_move_only_what_they_name():
    cell = PlanarCell(pushing_task())
    world = make_world(cell, space=make_action_space("discrete"))
    world.observe()
    world.act(6)
    _, closed = world.observe()
    assert closed.gripper_closed and closed.gripper_opening < 1e-3
    assert world.last_trajectory is None and np.array_equal(closed.gripper_pose, cell.state.gripper_pose)
    world.act(1)
    _, back = world.observe()
    assert back.gripper_closed and back.gripper_pose[0] == pytest.approx(-0.25)


def test_what_cannot_be_reached_is_an_error_before_anything_moves():
    cell = PlanarCell(pushing_task())
    world = make_world(cell)
    world.observe()
    for _ in range(2):
        world.act(np.array([-1.0, 0.0, 0.0, -1.0]))
        world.observe()
    before = cell.state
    with pytest.raises(UnreachableError, match="reach"):
        world.act(np.array([-1.0, 0.0, 0.0, -1.0]))
    assert cell.state == before and not cell.is_moving and world.fault is None
    world.act(FORWARD)  # the robot can go on
    with pytest.raises(ActionError):
        world.act(np.full(4, np.nan))
    assert world.fault is None


def test_an_action_needs_a_look_after_the_last_one():
    cell = PlanarCell(pushing_task())
    world = make_world(cell)
    with pytest.raises(CellFault, match="look"):
        world.act(FORWARD)
    world = make_world(cell)
    world.observe()
    world.act(FORWARD)
    with pytest.raises(CellFault, match="look"):
        world.act(FORWARD)
    with pytest.raises(CellFault, match="stopped before"):
        world.observe()
    assert cell.num_stops and not cell.is_moving


def test_a_slow_planner_acts_on_a_new_view_of_the_same_scene():
    cell = PlanarCell(pushing_task())
    world, result = run(cell, Scripted(FORWARD, before=lambda _: cell.wait(5.0)))
    assert result.success
    assert max(each.view_age_s for each in world.latencies) <= 0.6
    assert all(each.num_looks >= 2 for each in world.latencies[:-1])


def moved(state: State, shift: float) -> State:
    poses = state.object_poses.copy()
    poses[0, 1] += shift
    return State.create(state.gripper_pose, state.gripper_opening, state.gripper_closed, poses)


def test_a_motion_is_withheld_when_the_scene_changed_while_the_planner_thought():
    cell = PlanarCell(pushing_task())

    def disturb(number):
        if number == 0:
            cell.wait(2.0)
            cell.state = moved(cell.state, 0.1)

    world, result = run(cell, Scripted(FORWARD, FORWARD, before=disturb))
    assert [each.is_withheld for each in world.latencies][:2] == [True, False]
    first, second = result.episode.states[:2]
    assert np.array_equal(first.gripper_pose, second.gripper_pose)
    assert second.object_poses[0, 1] == pytest.approx(0.1)


@pytest.mark.parametrize("is_moved", [False, True])
def test_what_goes_on_slipping_hinders_no_motion_while_everything_stays_in_its_place(is_moved):
    task = pushing_task()
    cell = PlanarCell(task)
    slips = []

    def slip(number):
        if len(slips) >= 4:
            return
        slips.append(number)
        before = cell.state
        poses = before.object_poses + (0.03 * is_moved, 0.0, 0.0)
        cell.state = State.create(before.gripper_pose, before.gripper_opening - 0.006, before.gripper_closed, poses)

    world, result = run(cell, Scripted(FORWARD, before=slip))
    withheld = sum(each.is_withheld for each in world.latencies)
    assert withheld == (4 if is_moved else 3)
    assert (result.outcome == "stopped") == is_moved
    assert (np.ptp([state.gripper_pose[0] for state in result.episode.states]) > 0.04) != is_moved


def test_a_motion_is_withheld_when_an_object_slipped_out_of_the_fingers():
    """The fingers closed further after the view, and now they stand still: the planner decides on a new view."""
    cell = PlanarCell(pushing_task())

    def slip(number):
        if number == 0:
            state = cell.state
            cell.state = State.create(
                state.gripper_pose, state.gripper_opening - 0.02, state.gripper_closed, state.object_poses
            )

    world, result = run(cell, Scripted(FORWARD, FORWARD, before=slip))
    assert [each.is_withheld for each in world.latencies][:2] == [True, False]
    openings = [state.gripper_opening for state in result.episode.states[:2]]
    assert openings[0] - openings[1] == pytest.approx(0.02)
    assert result.success


def test_a_gripper_that_stands_on_something_stops_the_robot():
    class OnTop(PlanarKinematics):
        def forward(self, positions):
            return replace(super().forward(positions), height=GRIPPER_HEIGHT + 0.005)

    cell = PlanarCell(pushing_task())
    world = RobotWorld(cell, PlanarPerception(cell), OnTop(), CONTINUOUS)
    world.observe()
    with pytest.raises(CellFault, match=r"\+5.0 mm from its height"):
        world.act(FORWARD)
    assert world.fault and not cell.is_moving


def test_a_scene_that_goes_on_changing_stops_the_robot():
    cell = PlanarCell(pushing_task())

    def disturb(number):
        cell.wait(2.0)
        cell.state = moved(cell.state, 0.05 * (-1) ** len(cell.exposures))

    _, result = run(cell, Scripted(FORWARD, before=disturb))
    assert result.outcome == "stopped" and "changed" in str(result.fault)


def test_the_arm_must_not_move_without_a_command():
    cell = PlanarCell(pushing_task())
    world = make_world(cell)
    world.observe()
    cell.follow(PlanarKinematics().path(cell.arm().positions, world_motion()))
    cell.wait(3.0)
    with pytest.raises(CellFault, match="without a command"):
        world.act(FORWARD)
    assert world.fault and not cell.is_moving


def world_motion():
    return CONTINUOUS.motion(np.array([-0.3, 0.0, 0.0, -1.0]))


@pytest.mark.parametrize("index", range(4))
def test_random_episodes_end_in_a_named_state(index):
    class Random(Planner):
        name = "Random"

        def start(self, model, rng):
            return lambda state: Decision(rng.uniform(-1.0, 1.0, 4))

    task = planar_task(index=index)
    cell = PlanarCell(TaskInstance(task.scene, task.state))
    world, result = run(cell, Random())
    world.close()
    world.close()
    assert result.outcome in ("success", "dropped", "out of actions", "unreachable") and not cell.is_moving


class Hiding:
    """The arm hides the first object unless it is aside: there, ``shift`` shows where the object really is."""

    needs_camera = True

    def __init__(self, cell, shift):
        self.cell, self.shift = cell, shift

    def perceive(self, frame, arm, gripper, closed):
        seen = PlanarPerception(self.cell).perceive(frame, arm, gripper, closed)
        is_aside = seen.state.gripper_pose[1] > 0.3
        state = moved(seen.state, self.shift) if is_aside else seen.state
        track = SimpleNamespace(id=0, is_hidden=not is_aside, is_held=False, is_dropped=False)
        return SimpleNamespace(scene=seen.scene, state=state, tracks=(track,))


def legs_aside(cell):
    legs = [PlanarKinematics().path(cell.arm().positions, GripperMotion(left=0.1))]
    for _ in range(3):
        legs.append(PlanarKinematics().path(legs[-1].positions[-1], GripperMotion(left=0.1)))
    return legs


@pytest.mark.parametrize("opening", [0.0, 0.05])
def test_fingers_that_are_closed_on_something_open_before_the_arm_moves_aside(opening, monkeypatch):
    """Whatever was seen between them: the arm would take it along."""
    task = pushing_task(target_x=-0.06)
    cell = PlanarCell(task)
    before = task.state
    cell.state = State.create(before.gripper_pose, opening, True, before.object_poses)
    cell.is_closed = True
    commands = []
    monkeypatch.setattr(cell, "move_gripper", lambda opening: commands.append((cell.num_motions, opening)))
    monkeypatch.setattr(cell, "num_motions", 0, raising=False)
    follow = cell.follow

    def counted(trajectory):
        cell.num_motions += 1
        follow(trajectory)

    monkeypatch.setattr(cell, "follow", counted)
    world = make_world(cell, Hiding(cell, 0.0), survey=lambda joints: legs_aside(cell), closed=True)
    with contextlib.suppress(CellFault):  # its fingers do not move
        world.observe()
    assert commands == ([] if opening == 0.0 else [(0, 0.085)])


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_a_goal_that_the_arm_hides_is_looked_at_from_aside(shift):
    """The arm stays there if the goal is reached, and returns if it is not."""
    task = pushing_task(target_x=-0.06)  # the object lies in the target region
    cell = PlanarCell(task)
    legs = legs_aside(cell)
    world = make_world(cell, Hiding(cell, shift), survey=lambda joints: legs)
    _, state = world.observe()
    assert (state.gripper_pose[1] > 0.3) == (shift == 0.0)
    assert world.fault is None and not cell.is_moving
