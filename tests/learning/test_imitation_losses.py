"""Eq. 5, Eq. 6 and the value margin, computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.learning.imitation_losses import actor_critic_imitation_loss, q_imitation_loss, q_targets, value_margin


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


@given(
    q=st.lists(st.floats(-40.0, 5.0), min_size=8, max_size=8),
    action=st.integers(0, 7),
    margin=st.floats(0.0, 5.0),
)
def test_targets_never_exceed_the_current_value_or_the_margin(q: list[float], action: int, margin: float) -> None:
    values = torch.tensor([q])
    targets = q_targets(values, torch.tensor([action]), torch.tensor([-6.0]), torch.tensor([margin]))[0]
    others = torch.arange(8) != action
    assert targets[action].item() == -6.0
    assert (targets[others] <= values[0, others]).all()
    assert (targets[others] <= -6.0 - margin + 1e-6).all()


def test_losses_of_a_batch_are_means_of_those_of_its_pairs() -> None:
    generator = torch.Generator().manual_seed(0)

    def random(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    q, index, returns, margin = -20.0 * random(3, 8), torch.tensor([2, 0, 7]), -10.0 * random(3), random(3)
    outputs, action = (random(3, 4), 0.1 + random(3, 4), -20.0 * random(3)), random(3, 4)
    coefficients = (0.5, 0.7, 0.01)
    whole = (
        q_imitation_loss(q, index, returns, margin),
        actor_critic_imitation_loss(outputs, action, returns, *coefficients),
    )
    rows = [slice(row, row + 1) for row in range(3)]
    single = (
        [q_imitation_loss(q[row], index[row], returns[row], margin[row]) for row in rows],
        [
            actor_critic_imitation_loss(
                (outputs[0][row], outputs[1][row], outputs[2][row]), action[row], returns[row], *coefficients
            )
            for row in rows
        ],
    )
    for (loss, terms), parts in zip(whole, single, strict=True):
        torch.testing.assert_close(loss, torch.stack([part for part, _ in parts]).mean())
        for name, term in terms.items():
            torch.testing.assert_close(term, torch.stack([part[name] for _, part in parts]).mean())


def test_no_gradient_flows_into_the_targets() -> None:
    q = torch.full((1, 8), -9.0, requires_grad=True)
    targets = q_targets(q, torch.tensor([0]), torch.tensor([-6.0]), torch.tensor([2.0]))
    assert not targets.requires_grad


def test_a_masked_q_loss_learns_the_value_of_failures_and_nothing_of_their_other_actions() -> None:
    q = torch.tensor([[-5.0, -7.0] + [-99.0] * 6] * 3, requires_grad=True)
    action, returns, margin = torch.zeros(3, dtype=torch.int64), torch.full((3,), -6.0), torch.full((3,), 2.0)
    is_target, is_valued = torch.tensor([True, False, True]), torch.tensor([True, True, False])
    loss, terms = q_imitation_loss(q, action, returns, margin, is_target, is_valued)
    assert loss.item() == pytest.approx((2.0 + 1.0 + 1.0) / 3)
    assert terms["selected"].item() == pytest.approx(2.0 / 3)
    loss.backward()
    torch.testing.assert_close(q.grad[:, :2] * 3, torch.tensor([[2.0, 2.0], [2.0, 0.0], [0.0, 2.0]]))


def test_masks_of_the_actor_critic_loss_select_the_pairs_of_policy_and_value() -> None:
    torch.manual_seed(0)
    outputs = torch.rand(4, 4), torch.rand(4, 4) + 0.1, torch.rand(4)
    action, returns = torch.rand(4, 4), torch.rand(4)
    policy, value = torch.tensor([True, False, True, False]), torch.tensor([True, True, False, False])

    def terms_of(rows: torch.Tensor) -> dict[str, torch.Tensor]:
        chosen = tuple(output[rows] for output in outputs)
        return actor_critic_imitation_loss(chosen, action[rows], returns[rows], 1.0, 1.0, 0.0)[1]

    _, masked = actor_critic_imitation_loss(outputs, action, returns, 1.0, 1.0, 0.0, 1.0, policy, value)
    torch.testing.assert_close(masked["log_likelihood"], terms_of(policy)["log_likelihood"])
    torch.testing.assert_close(masked["value_error"], terms_of(value)["value_error"])
    nothing = torch.zeros(4, dtype=torch.bool)
    loss, _ = actor_critic_imitation_loss(outputs, action, returns, 1.0, 1.0, 0.0, 1.0, nothing, nothing)
    assert loss.item() == 0.0


def test_the_margin_is_computed_on_the_device_of_the_pairs() -> None:
    """On a GPU, the pairs are in its memory; the meta device stands in for it."""
    assert value_margin(torch.tensor([3, 1], device="meta"), 3, 1.0, 0.9).device.type == "meta"
