"""The error tree of visualrhp.

Every error that a caller can act on derives from :class:`VisualRHPError`. A message is one paragraph that states
the problem, its place (a key, a file, an index), and the expected value.
"""

from __future__ import annotations


class VisualRHPError(Exception):
    """Base class of all errors that visualrhp raises deliberately."""


class ConfigError(VisualRHPError):
    """A parameter is unknown, of the wrong type or out of range."""


class SceneError(VisualRHPError):
    """A scene or a state cannot be simulated: degenerate polygon, overlapping start, object outside the edges."""


class ActionError(VisualRHPError):
    """An action does not belong to the action space: wrong shape, not finite, index out of range."""


class SimulationError(VisualRHPError):
    """The physics diverged (a pose is not finite)."""


class LearningError(VisualRHPError):
    """Training diverged (a loss is not finite)."""


class DataError(VisualRHPError):
    """A data file is missing or damaged, or does not match its use."""


class CheckpointError(VisualRHPError):
    """A checkpoint is missing or damaged, or has another action space, observation or architecture."""


class StorageError(VisualRHPError):
    """A file or folder cannot be used: it is not ours, in use or not writable, or the disk is full."""


class UnreachableError(ActionError):
    """The arm cannot make a motion: a joint limit, a singularity or a collision; nothing has moved."""


class PerceptionError(VisualRHPError):
    """The camera's image cannot be interpreted: it is black, frozen or late, or does not show what is expected."""


class CellFault(VisualRHPError):
    """A device of the robot cell does not answer, or does not do what it was commanded to."""
