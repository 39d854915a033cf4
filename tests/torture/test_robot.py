"""Some faults of every device; ``python -m tests.torture robot`` injects a thousand."""

import pytest

from tests.torture import robot
from tests.torture.robot_faults import KINDS
from visualrhp.embodiment.watchdog import WatchdogLimits


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_ends_in_a_named_state_without_a_blind_motion(kind):
    fault, true, _ = robot.run_case(5, kind, start_s=2.0)
    assert true.blind == [] and true.num_motions > 0 and (fault.num_shown or kind in ("flicker", "gripper stuck"))


def test_the_harness_sees_a_robot_that_acts_on_old_views(monkeypatch):
    """With a watchdog that lets everything pass, the same faults lead to blind motions."""
    careless = WatchdogLimits(max_view_age_s=1e9, max_drift=1e9)
    world = robot.RobotWorld
    monkeypatch.setattr(robot, "RobotWorld", lambda *args, **options: world(*args, watchdog=careless, **options))
    blind = [reason for seed in range(3) for reason in robot.run_case(seed, "slow")[1].blind]
    assert any("old" in reason for reason in blind)
