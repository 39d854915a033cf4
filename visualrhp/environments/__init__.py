"""The task as an environment for learners: one Gymnasium environment, and N tasks in one torchrl environment.

:class:`~visualrhp.environments.batched.BatchedClutterEnv` is imported from its module, because torchrl takes seconds
to import and few users of the Gymnasium environment need it.
"""

from visualrhp.environments.clutter_manipulation import ClutterManipulation
from visualrhp.environments.wrappers import ColourImage

__all__ = ["ClutterManipulation", "ColourImage"]
