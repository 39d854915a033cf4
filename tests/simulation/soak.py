"""Random and adversarial actions by the thousand, and what may never happen meanwhile.

``python -m tests.simulation.soak --actions 100000`` takes some minutes on two cores; the tests run a few thousand.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from unittest import mock

import numpy as np
import shapely

from visualrhp.scene import (
    ObjectShape,
    Scene,
    SceneDistribution,
    TargetRegion,
    TaskInstance,
    geometry,
    sample_task_instance,
)
from visualrhp.simulation import ContinuousActionSpace, GripperMotion, Physics
from visualrhp.simulation.chipmunk import ChipmunkWorld
from visualrhp.simulation.rules import is_dropped
from visualrhp.simulation.simulator import Simulator
from visualrhp.streams import Split
from visualrhp.types import State

KINDS = ("random", "towards objects", "jam", "edge", "slivers", "hooks", "crowd")
DEPTHS = (0.0005, 0.001, 0.002)
"""Overlaps that are counted [m]."""
_ACTIONS_PER_SCENE = 40
_CREEP_EVERY = 8
_SLIVER = np.array([[-0.045, -0.0016], [0.045, -0.0016], [0.045, 0.0016], [-0.045, 0.0016]])
_HOOK = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, -0.015], [-0.015, -0.015], [-0.015, 0.03], [-0.03, 0.03]])


@dataclass
class Findings:
    """What happened in a number of actions.

    Attributes:
        actions: how many there were, of each kind.
        overlaps: states at rest with bodies deeper into each other than each of ``DEPTHS``, of each kind.
        restless: motions after which the world did not come to rest in the steps it is given.
        creep: farthest that an object moved when nothing was commanded [m].
        top_speed: largest component of an object's velocity at the end of a motion of the hand [m/s], [rad/s].
        worst: a few (kind, scene, action) of the deepest overlaps.
    """

    actions: Counter[str] = field(default_factory=Counter)
    overlaps: Counter[tuple[str, float]] = field(default_factory=Counter)
    restless: int = 0
    creep: float = 0.0
    worst: list[tuple[str, int, int]] = field(default_factory=list)

    def add(self, other: Findings) -> None:
        self.actions += other.actions
        self.overlaps += other.overlaps
        self.restless += other.restless
        self.creep = max(self.creep, other.creep)
        self.worst += other.worst


def overlap(scene: Scene, state: State, depth: float) -> bool:
    """Whether two bodies still overlap when half of ``depth`` [m] is taken off the border of each."""
    placed = zip(scene.objects, state.object_poses, strict=True)
    bodies = [shapely.Polygon(geometry.to_world(shape.outline, pose)) for shape, pose in placed]
    gripper = scene.gripper.outlines(state.gripper_pose, state.gripper_opening)
    bodies.append(shapely.union_all([shapely.Polygon(outline) for outline in gripper]))
    first, second = np.triu_indices(len(bodies), 1)
    solid = np.array(bodies)
    close = shapely.intersects(solid[first], solid[second])
    thin = shapely.buffer(solid, -0.5 * depth)
    return bool(shapely.intersects(thin[first[close]], thin[second[close]]).any())


def instance_of(kind: str, index: int) -> TaskInstance:
    """The scene of one soak, by kind and number."""
    if kind not in ("slivers", "hooks", "crowd"):
        return sample_task_instance(SceneDistribution(num_objects=(1, 7)), 0, Split.TUNING, index)
    count = 20 if kind == "crowd" else 6
    size = "small" if kind == "crowd" else "mixed"
    rng = np.random.default_rng([7, index])
    side = 0.5 if kind != "crowd" else 0.6
    instance = sample_task_instance(
        SceneDistribution(num_objects=(count, count), object_size=size, surface_side=side), 0, Split.TUNING, index
    )
    if kind == "crowd":
        return instance
    outline = _SLIVER if kind == "slivers" else _HOOK
    scene = Scene(TargetRegion([0.0, 0.0]), tuple(ObjectShape.centred(outline) for _ in range(count)))
    while True:  # the sampled places, other shapes
        poses = instance.state.object_poses.copy()
        poses[:, 2] = rng.uniform(-np.pi, np.pi, count)
        poses[:, :2] += rng.normal(0.0, 0.02, (count, 2))
        state = State.create(instance.state.gripper_pose, 0.085, False, poses)
        if not overlap(scene, state, 1e-6) and not is_dropped(scene, state):
            return TaskInstance(scene, state)
        instance = sample_task_instance(
            SceneDistribution(num_objects=(count, count)), 1, Split.TUNING, int(rng.integers(1 << 30))
        )


def action_of(kind: str, state: State, number: int, rng: np.random.Generator) -> np.ndarray:
    """An action that looks for trouble."""
    uniform = rng.uniform(-1.0, 1.0, 4)
    if kind == "random" or rng.random() < 0.15:
        return uniform
    x, y, theta = state.gripper_pose
    if kind == "edge":  # along the border
        aim = 0.23 * np.sign(state.gripper_pose[:2]) - (x, y)
    else:
        aim = state.object_poses[rng.integers(state.num_objects), :2] - (x, y)
    forward, left = aim @ geometry.rotation_matrix(theta)
    action = np.array([forward / 0.1, left / 0.1, math.atan2(left, forward) / math.radians(50.0), uniform[3]])
    if kind == "jam":  # open over an object, close, and turn and shove what is inside
        action[3] = 1.0 if number % 4 else -1.0
        if number % 4 == 3:
            action[:3] = uniform[:3]
    return action + np.append(rng.normal(0.0, 0.3, 3), 0.0)


def soak(kind: str, index: int) -> Findings:
    """All actions in one scene."""
    findings, space = Findings(), ContinuousActionSpace()
    instance = instance_of(kind, index)
    simulator = Simulator(instance.scene, Physics())
    rng = np.random.default_rng([index, KINDS.index(kind)])
    state = instance.state
    speeds: list[float] = []
    measure = ChipmunkWorld.top_speed

    def watched(world: ChipmunkWorld, of: object) -> float:
        speeds.append(measure(world, of))
        return speeds[-1]

    with mock.patch.object(ChipmunkWorld, "top_speed", watched):
        for number in range(_ACTIONS_PER_SCENE):
            following = simulator.advance(state, space.motion(action_of(kind, state, number, rng)))
            assert np.isfinite(following.vector).all()
            findings.actions[kind] += 1
            findings.restless += speeds[-1] >= simulator.physics.rest_speed
            for depth in DEPTHS:
                if not overlap(instance.scene, following, depth):
                    break
                findings.overlaps[kind, depth] += 1
                if depth == DEPTHS[-1]:
                    findings.worst.append((kind, index, number))
            if number % _CREEP_EVERY == 0:
                idle = simulator.advance(following, GripperMotion())
                moved = np.hypot(*(idle.object_poses - following.object_poses)[:, :2].T)
                findings.creep = max(findings.creep, float(moved.max()))
            state = instance.state if is_dropped(instance.scene, following) else following
    return findings


def soak_all(num_actions: int, workers: int = 1) -> Findings:
    """About ``num_actions`` actions, as many of each kind."""
    scenes = max(1, round(num_actions / (len(KINDS) * _ACTIONS_PER_SCENE)))
    jobs = [(kind, index) for index in range(scenes) for kind in KINDS]
    total = Findings()
    if workers == 1:
        for job in jobs:
            total.add(soak(*job))
        return total
    with ProcessPoolExecutor(workers) as pool:
        for findings in pool.map(soak, *zip(*jobs, strict=True), chunksize=7):
            total.add(findings)
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", type=int, default=100_000)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    findings = soak_all(arguments.actions, arguments.workers)
    print(f"{'kind':<16} {'actions':>8} " + " ".join(f"{f'over {1e3 * depth:g} mm':>12}" for depth in DEPTHS))
    for kind in KINDS:
        counts = " ".join(f"{findings.overlaps[kind, depth]:>12}" for depth in DEPTHS)
        print(f"{kind:<16} {findings.actions[kind]:>8} {counts}")
    print(f"not at rest at the end: {findings.restless}; farthest creep {1e3 * findings.creep:.3f} mm")
    print(f"deepest: {findings.worst[:10]}")


if __name__ == "__main__":
    main()
