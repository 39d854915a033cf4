import numpy as np
import pytest

from visualrhp.execution.world import simulated_task
from visualrhp.scene import SceneDistribution, sample_task_instance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.streams import Split

CONTINUOUS = make_action_space("continuous")


def task_at(noise, index=0, num_objects=3):
    instance = sample_task_instance(SceneDistribution(num_objects=num_objects), 7, Split.EVALUATION, index)
    world, model = simulated_task(instance, 7, Split.EVALUATION, index, action_space=CONTINUOUS, noise=noise)
    return instance, world, model


def test_without_noise_the_model_is_the_world():
    instance, world, model = task_at(0.0)
    assert world.model is model
    assert world.observe() == (instance.scene, instance.state)


def test_noise_changes_the_world_and_neither_the_model_nor_what_is_observed():
    instance, world, model = task_at(0.05)
    assert model.scene == instance.scene
    assert world.model.scene != instance.scene
    assert world.observe()[0] == instance.scene
    assert world.model.scene == task_at(0.05)[1].model.scene
    assert world.model.scene.objects != task_at(0.05, index=1)[1].model.scene.objects


def test_acting_moves_the_world_as_its_model_says():
    instance, world, _ = task_at(0.05)
    action = np.array([1.0, 0.0, 0.0, 0.0])
    expected = world.model.simulate(instance.state, action).next_state
    world.act(action)
    assert world.observe()[1] == expected
    world.close()
    world.close()


def test_levels_of_noise_scale_the_same_draws():
    nominal = task_at(0.0, num_objects=1)[0].scene.objects[0]
    low, high = (task_at(noise, num_objects=1)[1].model.scene.objects[0] for noise in (0.01, 0.05))
    assert high.friction / nominal.friction - 1.0 == pytest.approx(5.0 * (low.friction / nominal.friction - 1.0))
