"""The packages of the robot extra."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from visualrhp.embodiment.packages import robot_package
from visualrhp.errors import ConfigError

WITHOUT_OPENGL = """
import ctypes.util, os
os.environ.pop("MUJOCO_GL", None)
os.environ["PYOPENGL_PLATFORM"] = "egl"
import ctypes
find, load = ctypes.util.find_library, ctypes.CDLL.__init__
def missing(self, name, *args, **kwargs):
    if name and ("EGL" in str(name) or "libGL" in str(name)):
        raise OSError(f"{name}: cannot open shared object file")
    return load(self, name, *args, **kwargs)
ctypes.CDLL.__init__ = missing
ctypes.util.find_library = lambda name: None if name in ("EGL", "GL", "OpenGL") else find(name)
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.scenarios import scenario
from visualrhp.errors import ConfigError
cell = SimulatedCell(scenario("low_clutter"), render=False)
cell.wait(0.1)
try:
    SimulatedCell(scenario("low_clutter"))
except ConfigError as error:
    print(error)
"""


def test_a_missing_package_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(ConfigError, match=r"no_such_package.*visualrhp\[robot\]"):
        robot_package("no_such_package")


def test_mujoco_needs_no_screen() -> None:
    robot_package("mujoco")
    assert os.environ["MUJOCO_GL"]


def test_without_an_opengl_library_physics_runs_and_rendering_says_what_to_install() -> None:
    environment = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    command = [sys.executable, "-W", "ignore", "-c", WITHOUT_OPENGL]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "libegl1" in done.stdout
