"""Imitation by hand: Eq. 4, 5 and 6 in numbers, mirroring, resuming to the same bits, a trivial problem learned."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.errors import CheckpointError, ConfigError, DataError, LearningError
from visualrhp.heuristics.networks import ActorCritic, QNetwork, make_network
from visualrhp.learning.configs import ActorCriticImitationConfig, QImitationConfig
from visualrhp.learning.imitation import ImitationLearner
from visualrhp.learning.imitation_data import ImitationData
from visualrhp.learning.imitation_losses import actor_critic_imitation_loss, q_imitation_loss, q_targets, value_margin
from visualrhp.observation import Observation, make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.streams import Split
from visualrhp.types import Action, Episode, Metrics, Outcome, State

CARTESIAN = make_observation("cartesian", 2)
IMAGE = make_observation("image")


# ------------------------------------------------------------------------------------------------ the equations by hand
def test_returns_are_eq_4() -> None:
    """Three actions of reward -1: -1 - g - g^2, -1 - g, -1."""
    data = ImitationData.from_demonstrations([demonstration(0, 3)], CARTESIAN, discount=0.9)
    np.testing.assert_allclose(data.returns.numpy(), [-2.71, -1.9, -1.0], rtol=1e-6)
    assert data.steps_to_go.tolist() == [3, 2, 1]


def test_margin_is_that_of_the_paper() -> None:
    """lambda = sum over k = 1..eta of gamma^(L - l - 1 + k) r_cost."""
    margin = value_margin(torch.tensor([1, 2, 10]), margin_actions=3, margin_cost=2.0, discount=0.9)
    expected = [2.0 * sum(0.9 ** (left - 1 + k) for k in (1, 2, 3)) for left in (1, 2, 10)]
    np.testing.assert_allclose(margin.numpy(), expected, rtol=1e-6)
    # At the last action of a demonstration (L - l = 1): gamma + gamma^2 + gamma^3.
    assert margin[0].item() == pytest.approx(2.0 * (0.9 + 0.81 + 0.729))


@given(left=st.integers(1, 60), eta=st.integers(1, 5))
def test_margin_shrinks_away_from_the_goal(left: int, eta: int) -> None:
    near, far = value_margin(torch.tensor([left, left + 1]), eta, 1.0).tolist()
    assert near > far > 0.0


def test_targets_are_eq_5() -> None:
    q = torch.tensor([[-5.0, -7.9, -8.0, -8.1, -20.0, 3.0, -9.0, -6.0]])
    targets = q_targets(q, torch.tensor([0]), torch.tensor([-6.0]), torch.tensor([2.0]))
    # Selected: the return. Others: return - margin = -8 where they are above it, else what they are.
    torch.testing.assert_close(targets, torch.tensor([[-6.0, -8.0, -8.0, -8.1, -20.0, -8.0, -9.0, -8.0]]))


def test_q_loss_and_its_gradient_are_those_of_the_squared_errors() -> None:
    q = torch.tensor([[-5.0, -7.0, -10.0, -9.0, -9.0, -9.0, -9.0, -9.0]], requires_grad=True)
    loss, terms = q_imitation_loss(q, torch.tensor([0]), torch.tensor([-6.0]), torch.tensor([2.0]))
    # Errors: 1 of the selected action, 1 of the second one (-7 above -8), none of those below.
    assert loss.item() == pytest.approx(2.0)
    assert terms["selected"].item() == pytest.approx(1.0)
    assert terms["unselected"].item() == pytest.approx(1.0)
    loss.backward()
    torch.testing.assert_close(q.grad, torch.tensor([[2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))


def test_actor_critic_loss_is_eq_6() -> None:
    mean, std = torch.tensor([[0.1, -0.2, 0.3, 0.0]]), torch.tensor([[0.5, 0.2, 1.0, 0.1]])
    action, value, target = torch.tensor([[0.0, 0.0, 0.5, 0.1]]), torch.tensor([-10.0]), torch.tensor([-12.0])
    loss, terms = actor_critic_imitation_loss((mean, std, value), action, target, 0.5, 0.7, 0.01)
    log_likelihood = entropy = 0.0
    for m, s, a in zip(mean[0].tolist(), std[0].tolist(), action[0].tolist(), strict=True):
        log_likelihood += -0.5 * ((a - m) / s) ** 2 - math.log(s) - 0.5 * math.log(2.0 * math.pi)
        entropy += 0.5 * math.log(2.0 * math.pi * math.e * s**2)
    # -Upsilon log pi + c1 (v_tar - v)^2 + c2 H: high entropy is penalized.
    assert loss.item() == pytest.approx(-0.5 * log_likelihood + 0.7 * 4.0 + 0.01 * entropy, rel=1e-5)
    assert terms["log_likelihood"].item() == pytest.approx(log_likelihood, rel=1e-5)
    assert terms["entropy"].item() == pytest.approx(entropy, rel=1e-5)
    assert terms["value_error"].item() == pytest.approx(4.0)


def test_entropy_is_penalized_and_return_unit_scales_the_value_error() -> None:
    action, target = torch.zeros(1, 4), torch.tensor([-12.0])
    std = torch.full((1, 4), 0.5, requires_grad=True)
    outputs = (torch.zeros(1, 4), std, torch.tensor([-10.0]))
    actor_critic_imitation_loss(outputs, action, target, 1e-9, 0.7, 0.01)[0].backward()
    assert std.grad is not None and (std.grad > 0).all()  # descending makes the deviations smaller
    plain, scaled = (
        actor_critic_imitation_loss(outputs, action, target, 1e-9, 1.0, 0.0, return_unit=unit)[0].item()
        for unit in (1.0, 4.0)
    )
    assert plain == pytest.approx(16.0 * scaled, rel=1e-4)


# ----------------------------------------------------------------------------------------------------------------- data
def demonstration(index: int, length: int, action_space: str = "discrete") -> tuple[TaskInstance, Episode]:
    """A demonstration of random actions in which nothing moves: what is observed and done is enough to look at."""
    task = sample_task_instance(SceneDistribution(num_objects=(2, 2)), 0, Split.TUNING, index)
    rng = np.random.default_rng(index)
    space = make_action_space(action_space)  # pyright: ignore[reportArgumentType]
    states = [task.state]
    for _ in range(length):
        vector = task.state.vector.copy()
        vector[:3] += rng.uniform(-0.05, 0.05, 3)
        vector[4] = rng.integers(2)
        states.append(State(vector))
    actions: list[Action] = [space.sample(rng) for _ in range(length)]
    return task, Episode(tuple(states), tuple(actions), (-1.0,) * length, Outcome.SUCCESS)


def data_of(action_space: str, observe: Observation, count: int = 6) -> ImitationData:
    return ImitationData.from_demonstrations([demonstration(i, 3 + i, action_space) for i in range(count)], observe)


def test_pairs_are_states_with_their_actions() -> None:
    pairs = [demonstration(i, 3 + i) for i in range(2)]
    data = ImitationData.from_demonstrations(pairs, IMAGE)
    assert len(data) == 7
    assert data.demonstration.tolist() == [0, 0, 0, 1, 1, 1, 1]
    task, episode = pairs[1]
    batch = data[torch.tensor([4, 0])]
    np.testing.assert_array_equal(batch.observation[0], IMAGE(task.scene, episode.states[1]))
    assert batch.action[0].item() == episode.actions[1]
    assert batch.gripper_closed[0].item() == episode.states[1].gripper_closed
    assert batch.observation.dtype is torch.uint8
    assert batch.steps_to_go.tolist() == [3, 3]


def test_label_images_are_kept_packed() -> None:
    """Less than a fifth of the bytes, so that a million pairs train in little memory."""
    data = data_of("discrete", IMAGE, count=20)
    assert data.observations.nbytes < 0.2 * len(data) * 64 * 64


def test_no_demonstrations_are_an_error() -> None:
    with pytest.raises(DataError, match="no demonstrations"):
        ImitationData.from_demonstrations([], IMAGE)


def test_whole_demonstrations_are_held_out() -> None:
    data = data_of("discrete", CARTESIAN, count=10)
    training, held_out = data.split(0.3, torch.Generator().manual_seed(0))
    assert len(torch.unique(data.demonstration[held_out])) == 3
    assert not set(data.demonstration[training].tolist()) & set(data.demonstration[held_out].tolist())
    assert sorted([*training.tolist(), *held_out.tolist()]) == list(range(len(data)))


@pytest.mark.parametrize("observe", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_mirroring_twice_is_nothing_and_spares_the_rest(action_space: str, observe: Observation) -> None:
    pairs = data_of(action_space, observe)
    data = pairs[torch.arange(len(pairs))]
    rows = torch.arange(len(pairs)) % 2 == 0
    once = data.mirrored(rows, pairs.observation)
    assert torch.equal(once.observation[~rows], data.observation[~rows])
    assert not torch.equal(once.observation[rows], data.observation[rows])
    twice = once.mirrored(rows, pairs.observation)
    assert torch.equal(twice.observation, data.observation)
    assert torch.equal(twice.action, data.action)


def test_mirrored_actions_are_those_of_the_action_space() -> None:
    for action_space in ("discrete", "continuous"):
        pairs = data_of(action_space, CARTESIAN)
        data = pairs[torch.arange(len(pairs))]
        mirrored = data.mirrored(torch.ones(len(pairs), dtype=torch.bool), pairs.observation)
        space = make_action_space(action_space)  # pyright: ignore[reportArgumentType]
        expected = [space.mirror(a if a.ndim else int(a)) for a in data.action.numpy()]
        np.testing.assert_allclose(mirrored.action.numpy(), np.array(expected), rtol=1e-6)


# ------------------------------------------------------------------------------------------------------------- training
def steering(count: int, action_space: str, seed: int = 0) -> ImitationData:
    """A trivial problem: go where the first feature points; the return is the second one."""
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(count, *CARTESIAN.shape, generator=generator)
    left = features[:, 0] > 0
    if action_space == "discrete":
        action = torch.where(left, 2, 3)
    else:
        action = torch.zeros(count, 4)
        action[:, 1] = torch.where(left, 0.8, -0.8)
    return ImitationData(
        observation=CARTESIAN,
        observations=features.numpy(),
        gripper_closed=torch.zeros(count, dtype=torch.bool),
        action=action,
        returns=-10.0 + 3.0 * features[:, 1].clamp(-2, 2),
        steps_to_go=torch.full((count,), 5),
        demonstration=torch.arange(count) // 4,
    )


def learner_for(action_space: str, epochs: int = 6, network_seed: int = 1, **options: object) -> ImitationLearner:
    torch.manual_seed(network_seed)
    kind = QImitationConfig if action_space == "discrete" else ActorCriticImitationConfig
    parameters = {"mirror": False, "lr": 3e-3, "batch_size": 128, "validation_fraction": 0.1, **options}
    config = kind(epochs=epochs, **parameters)  # pyright: ignore[reportArgumentType]
    return ImitationLearner(make_network(action_space, CARTESIAN), steering(1200, action_space), config, seed=0)


def last(learner: ImitationLearner) -> Metrics:
    return list(learner.run())[-1]


def test_a_trivial_discrete_problem_is_learned() -> None:
    metrics = last(learner_for("discrete", epochs=25))
    assert metrics["validation/agreement"] > 0.9
    assert metrics["validation/value_rmse"] < 1.2


def test_a_trivial_continuous_problem_is_learned() -> None:
    learner = learner_for("continuous", epochs=25, lr_schedule="cosine")
    metrics = last(learner)
    assert metrics["validation/value_rmse"] < 1.2
    probe = steering(200, "continuous", seed=7)
    with torch.no_grad():
        mean, std, _ = learner.network(torch.from_numpy(probe.observations), probe.gripper_closed)
    assert (mean[:, 1].sign() == probe.action[:, 1].sign()).float().mean() > 0.93
    assert std[:, 0].mean() < 0.2


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_a_resumed_training_ends_at_the_same_bits(tmp_path: Path, action_space: str) -> None:
    options = {"mirror": True, "lr_schedule": "cosine", "l2_regularization": 1e-4, "epochs": 4}
    uninterrupted = learner_for(action_space, **options)  # pyright: ignore[reportArgumentType]
    last(uninterrupted)
    interrupted = learner_for(action_space, **options)  # pyright: ignore[reportArgumentType]
    rows = interrupted.run()
    for _ in range(2):
        next(rows)
    interrupted.save(tmp_path / "state.safetensors")
    resumed = learner_for(action_space, network_seed=2, **options)  # pyright: ignore[reportArgumentType]
    resumed.load(tmp_path / "state.safetensors")
    assert [row["epoch"] for row in resumed.run()] == [3.0, 4.0]
    for name, tensor in uninterrupted.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name]), name
    assert [row["train/loss"] for row in resumed.history] == [row["train/loss"] for row in uninterrupted.history]


def test_l2_regularization_shrinks_the_weights() -> None:
    norms = []
    for l2_regularization in (0.0, 0.1):
        learner = learner_for("discrete", epochs=3, l2_regularization=l2_regularization)
        last(learner)
        norms.append(sum(parameter.square().sum().item() for parameter in learner.network.parameters()))
    assert norms[1] < norms[0]


def test_learning_rate_schedules() -> None:
    constant = [row["lr"] for row in learner_for("discrete", epochs=3).run()]
    assert constant == [3e-3] * 3
    cosine = [row["lr"] for row in learner_for("discrete", epochs=3, lr_schedule="cosine").run()]
    assert 3e-3 > cosine[0] > cosine[1] > cosine[2] > 0.0


def test_a_row_a_epoch_with_everything_a_curve_needs() -> None:
    for action_space, terms in (
        ("discrete", {"train/selected", "train/unselected", "validation/agreement"}),
        ("continuous", {"train/log_likelihood", "train/entropy", "train/value_error"}),
    ):
        metrics = last(learner_for(action_space, epochs=1))
        common = {"epoch", "train/loss", "validation/loss", "validation/value_rmse", "samples_per_s", "lr"}
        assert common | terms <= set(metrics)


def test_images_are_learned_from() -> None:
    data = data_of("discrete", IMAGE)
    config = QImitationConfig(epochs=6, batch_size=16, lr=1e-3, validation_fraction=0.0)
    torch.manual_seed(0)
    losses = [row["train/loss"] for row in ImitationLearner(QNetwork(IMAGE), data, config, seed=0).run()]
    assert losses[-1] < 0.5 * losses[0]


# -------------------------------------------------------------------------------------------------------------- refusal
def test_configuration_of_the_other_action_space_is_refused() -> None:
    with pytest.raises(ConfigError, match="QImitationConfig cannot train a network of the continuous"):
        ImitationLearner(ActorCritic(CARTESIAN), steering(20, "continuous"), QImitationConfig(), seed=0)


@pytest.mark.parametrize(
    ("parameter", "value"),
    [("lr", 0.0), ("batch_size", 0), ("epochs", -1), ("lr_schedule", "linear"), ("validation_fraction", 1.0)],
)
def test_parameters_out_of_range_are_named(parameter: str, value: object) -> None:
    with pytest.raises(ConfigError, match=parameter):
        QImitationConfig(**{parameter: value})  # pyright: ignore[reportArgumentType]


def test_state_of_the_other_action_space_is_refused(tmp_path: Path) -> None:
    learner_for("discrete").save(tmp_path / "state.safetensors")
    with pytest.raises(CheckpointError, match="another architecture"):
        learner_for("continuous").load(tmp_path / "state.safetensors")


def test_divergence_is_an_error_of_its_own() -> None:
    learner = learner_for("continuous", epochs=1)
    with torch.no_grad():
        next(learner.network.parameters()).fill_(float("nan"))
    with pytest.raises(LearningError, match="diverged in epoch 1"):
        last(learner)
