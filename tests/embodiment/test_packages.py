"""The packages of the robot extra."""

from __future__ import annotations

import os

import pytest

from visualrhp.embodiment.packages import robot_package
from visualrhp.errors import ConfigError


def test_a_missing_package_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(ConfigError, match=r"no_such_package.*visualrhp\[robot\]"):
        robot_package("no_such_package")


def test_mujoco_needs_no_screen() -> None:
    robot_package("mujoco")
    assert os.environ["MUJOCO_GL"]
