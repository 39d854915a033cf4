"""VisualRHP: learning image-based receding horizon planning for manipulation in clutter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import WrapperSpec as _WrapperSpec
from gymnasium.envs.registration import register as _register

if TYPE_CHECKING:
    from visualrhp.pretrained import load_pretrained

__all__ = ["load_pretrained"]

__version__ = "0.1.0"

# Strings: the environment is imported when one is made. It keeps the action limit itself (Sec. 7.3). Gymnasium's
# checker is left out, since it fails in the first step of an environment whose first reset was refused.
_register(
    "visualrhp/ClutterManipulation-v0",
    "visualrhp.environments.clutter_manipulation:ClutterManipulation",
    max_episode_steps=49,
    disable_env_checker=True,
    additional_wrappers=(_WrapperSpec("OwnTimeLimit", "visualrhp.environments.wrappers:own_time_limit", {}),),
)


def __getattr__(name: str) -> Any:
    """Import on first use: ``import visualrhp`` stays fast."""
    if name not in __all__:
        raise AttributeError(f"module 'visualrhp' has no attribute {name!r}")
    from visualrhp.pretrained import load_pretrained

    return load_pretrained
