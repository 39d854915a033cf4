"""VisualRHP: learning image-based receding horizon planning for manipulation in clutter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register as _register

if TYPE_CHECKING:
    from visualrhp.pretrained import load_pretrained

__all__ = ["load_pretrained"]

__version__ = "0.1.0"

# A string: the environment is imported when one is made. It enforces the action limit itself (Sec. 7.3).
_register("visualrhp/ClutterManipulation-v0", "visualrhp.environments.clutter_manipulation:ClutterManipulation")


def __getattr__(name: str) -> Any:
    """Import on first use: ``import visualrhp`` stays fast."""
    if name not in __all__:
        raise AttributeError(f"module 'visualrhp' has no attribute {name!r}")
    from visualrhp.pretrained import load_pretrained

    return load_pretrained
