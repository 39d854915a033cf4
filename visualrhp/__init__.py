"""VisualRHP: learning image-based receding horizon planning for manipulation in clutter."""

from gymnasium.envs.registration import register as _register

__version__ = "0.1.0"

# A string: the environment is imported when one is made. It enforces the action limit itself (Sec. 7.3).
_register("visualrhp/ClutterManipulation-v0", "visualrhp.environments.clutter_manipulation:ClutterManipulation")
