"""What a problem is: surface, target region, objects, and random instances of it."""

from visualrhp.scene.gripper import Gripper
from visualrhp.scene.noise import NOISE_LEVELS, NoiseLevel, perturb
from visualrhp.scene.sampling import SceneDistribution, Split, generator_for, sample_task_instance
from visualrhp.scene.scene import ObjectShape, Scene, TargetRegion, TaskInstance

__all__ = [
    "NOISE_LEVELS",
    "Gripper",
    "NoiseLevel",
    "ObjectShape",
    "Scene",
    "SceneDistribution",
    "Split",
    "TargetRegion",
    "TaskInstance",
    "generator_for",
    "perturb",
    "sample_task_instance",
]
