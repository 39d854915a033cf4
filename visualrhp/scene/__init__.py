"""Task instances: surface, target region and objects; sampled at random, or read from files."""

from visualrhp.scene.graspability import Graspability, graspability
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.noise import NOISE_LEVELS, NoiseLevel, perturb
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.scene.scene_file import load_task_instance, save_task_instance, scene_file_schema
from visualrhp.scene.start import MAX_START_OVERLAP, check_start

__all__ = [
    "MAX_START_OVERLAP",
    "NOISE_LEVELS",
    "Graspability",
    "Gripper",
    "NoiseLevel",
    "ObjectShape",
    "Scene",
    "SceneDistribution",
    "TargetRegion",
    "TaskInstance",
    "check_start",
    "graspability",
    "load_task_instance",
    "perturb",
    "sample_task_instance",
    "save_task_instance",
    "scene_file_schema",
]
