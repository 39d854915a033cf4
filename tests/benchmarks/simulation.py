"""The exact simulator against a bare Chipmunk loop on the same bodies; setting and getting states; drawing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from unittest import mock

import cv2
import numpy as np

from tests.benchmarks import walks as w
from tests.benchmarks.timing import Effort, Stopwatch, compare, numbered, show, show_title, side_by_side, timed
from visualrhp.observation.label_image import IMAGE_SIZE, label_image
from visualrhp.simulation import Physics
from visualrhp.simulation.chipmunk import lib
from visualrhp.simulation.simulator import Simulator
from visualrhp.types import State

NUM_OBJECTS = (1, 4, 7)


def _set_and_get(simulator: Simulator, state: State) -> None:
    """What the exactness adds to the substeps: the world set to a state and read."""
    space = simulator.begin(state, state.gripper_closed)
    simulator.read(space, state.gripper_closed)
    lib.cpSpaceFree(space)


def _replayed_fills(walk: w.Walk, state: State) -> Stopwatch:
    """OpenCV's part of the label image alone, its polygons computed beforehand."""
    with (
        mock.patch.object(cv2, "fillPoly", wraps=cv2.fillPoly) as polygons,
        mock.patch.object(cv2, "fillConvexPoly", wraps=cv2.fillConvexPoly) as convex,
    ):
        label_image(walk.scene, state)
    calls = [(cv2.fillPoly, *call) for call in polygons.call_args_list]
    calls += [(cv2.fillConvexPoly, *call) for call in convex.call_args_list]

    def fill() -> None:
        image = np.full((IMAGE_SIZE, IMAGE_SIZE), 0, np.uint8)
        for function, arguments, keywords in calls:
            function(image, *arguments[1:], **keywords)

    return timed(fill, 20)


def run(effort: Effort) -> None:
    show_title("Simulator (noisy walks towards the objects)")
    for num_objects in NUM_OBJECTS:
        walks = w.random_walks(num_objects, effort.motions)
        simulators = w.simulators(walks)
        words, total = numbered(num_objects, "object"), w.count(walks)
        substeps = Physics().motion_steps + sum(sum(walk.settling) for walk in walks) / total
        pushes = sum(walk.pushes for walk in walks)
        situations = [
            (simulator, state) for walk, simulator in zip(walks, simulators, strict=True) for state in walk.states[1:]
        ]
        advance, set_and_get, bare, unrestored = side_by_side(
            (
                partial(w.advance_seconds, walks, simulators),
                partial(_each, _set_and_get, situations),
                partial(w.bare_seconds, walks, simulators),
                partial(w.unrestored_seconds, walks, simulators),
            ),
            effort.repetitions,
        )
        print(f"{words}: {substeps:.1f} substeps a motion; {pushes} of {total} push objects")
        show(f"advance, {words}", advance, bare, "the bare Chipmunk loop")
        show(f"advance, {words}", advance, unrestored, "the same, never restored")
        show(f"set state and get state, {words}", set_and_get, bare, "the bare Chipmunk loop")
    show_title("Label image")
    for num_objects in NUM_OBJECTS:
        walk = w.random_walks(num_objects, 3)[0]
        state = walk.states[-1]
        compare(
            f"label image, {numbered(num_objects, 'object')}",
            timed(lambda walk=walk, state=state: label_image(walk.scene, state), 20),
            _replayed_fills(walk, state),
            "filling its polygons with OpenCV",
            effort.repetitions,
        )


def _each(function: Callable[..., object], arguments: list[tuple]) -> float:
    """Mean time of a call [s]."""
    return timed(lambda: [function(*a) for a in arguments])() / len(arguments)
