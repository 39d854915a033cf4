"""What the camera does not see: an object that the arm hides is where the planner's model expects it after the motion.

The arm often hides just the object that it pushes. Where it was seen last is then where the gripper is now. The model
knows better: from the last view and the motion it predicts where the object went (the model has no other view either,
so an error lasts until the object is seen again).
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import numpy as np

from visualrhp.scene import geometry
from visualrhp.scene.scene import Scene
from visualrhp.simulation import rules
from visualrhp.types import FloatArray, State

V = TypeVar("V")

_INSIDE = 2e-3
"""A hidden object counts as on the surface, this far within its edges at least [m]: a drop has to be seen."""


def with_hidden_predicted(view: V, last: Any, predicted: State) -> V:
    """``view`` with the poses of hidden objects as ``predicted``.

    Args:
        view: a dataclass with ``scene``, ``state`` and ``tracks`` in the order of the objects, whose entries have
            ``id``, ``is_hidden``, ``is_held`` and ``is_dropped``. One without tracks is returned as it is.
        last: the view before the motion.
        predicted: of the objects of ``last`` after the motion.
    """
    tracks, known = getattr(view, "tracks", None), getattr(last, "tracks", None)
    if tracks is None or known is None:
        return view
    entries: Any = view
    before = {track.id: number for number, track in enumerate(known)}
    poses = entries.state.object_poses.copy()
    for number, track in enumerate(tracks):
        if track.is_hidden and not track.is_held and not track.is_dropped and track.id in before:
            poses[number] = _kept_inside(predicted.object_poses[before[track.id]], entries.scene)
    if np.array_equal(poses, entries.state.object_poses):
        return view
    state = entries.state
    changed = State.create(state.gripper_pose, state.gripper_opening, state.gripper_closed, poses)
    return dataclasses.replace(entries, state=changed)


def seems_reached(view: Any) -> bool:
    """Whether the goal is reached in a view with tracks: the arm may cover the desired object, or a part of it.

    Args:
        view: as of :func:`with_hidden_predicted`; one without tracks sees everything.
    """
    return bool(getattr(view, "tracks", None)) and rules.is_goal(view.scene, view.state)


def is_desired_hidden(view: Any) -> bool:
    """Whether the arm hides the desired object; ``view`` as of :func:`seems_reached`."""
    tracks = getattr(view, "tracks", None)
    return bool(tracks) and tracks[0].is_hidden


def _kept_inside(pose: FloatArray, scene: Scene) -> FloatArray:
    """``pose`` [3], moved towards the target region until its position is within the edges."""
    edges = scene.edges.tolist()
    if geometry.contains(edges, *pose[:2].tolist()):
        return pose
    moved, inside, outside = pose.copy(), 0.0, 1.0
    for _ in range(20):
        part = 0.5 * (inside + outside)
        x, y = scene.target.position + part * (pose[:2] - scene.target.position)
        inside, outside = (part, outside) if geometry.contains(edges, float(x), float(y)) else (inside, part)
    way = pose[:2] - scene.target.position
    part = max(0.0, inside - _INSIDE / float(np.hypot(*way)))
    moved[:2] = scene.target.position + part * way
    return moved
