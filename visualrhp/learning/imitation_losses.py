"""Losses of imitation in both action spaces (Eq. 4, Eq. 5 and Eq. 6)."""

from __future__ import annotations

import torch
from torch.distributions import Independent, Normal

from visualrhp.simulation.rules import DISCOUNT


def value_margin(
    steps_to_go: torch.Tensor, margin_actions: int, margin_cost: float, discount: float = DISCOUNT
) -> torch.Tensor:
    r"""The value margin between the selected and the other actions (Sec. 6.2.1).

    .. math:: \lambda = \sum_{k=1}^{\eta} \gamma^{L-l-1+k} r_{cost}

    Args:
        steps_to_go: [B] L - l.
        margin_actions: eta, number of actions to correct a mistake.
        margin_cost: r_cost of each of these actions.
        discount: gamma.

    Returns:
        [B].
    """
    exponents = steps_to_go[:, None] - 1 + torch.arange(1, margin_actions + 1, device=steps_to_go.device)
    return margin_cost * (discount ** exponents.to(torch.float32)).sum(dim=1)


def q_targets(q: torch.Tensor, action: torch.Tensor, returns: torch.Tensor, margin: torch.Tensor) -> torch.Tensor:
    r"""Targets of all action values at visited states (Eq. 4 and Eq. 5).

    The target of the selected action is the Monte Carlo return; the target of another action is its current value,
    but at most that return minus the margin.

    Args:
        q: [B, 8] current action values; no gradient flows into the targets.
        action: [B] selected actions.
        returns: [B] q^tar(s_l, a_l).
        margin: [B] lambda.

    Returns:
        [B, 8].
    """
    targets = torch.minimum(q.detach(), (returns - margin)[:, None])
    return targets.scatter(1, action[:, None], returns[:, None])


def q_imitation_loss(
    q: torch.Tensor,
    action: torch.Tensor,
    returns: torch.Tensor,
    margin: torch.Tensor,
    is_target: torch.Tensor | None = None,
    is_valued: torch.Tensor | None = None,
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Squared error of the eight action values, summed over the actions and averaged over the batch (Eq. 4 and Eq. 5).

    Args:
        q, action, returns, margin: see :func:`q_targets`.
        is_target: [B] pairs whose other actions are worse by the margin; None for all.
        is_valued: [B] pairs whose return is the value of the selected action; None for all.

    Returns:
        the loss, and the contributions of the selected and of the other actions.
    """
    errors = (q - q_targets(q, action, returns, margin)).square()
    if is_target is not None and is_valued is not None:
        weights = (
            is_target[:, None].to(q.dtype).expand_as(q).scatter(1, action[:, None], is_valued[:, None].to(q.dtype))
        )
        errors = errors * weights
    selected = errors.gather(1, action[:, None]).mean()
    loss = errors.sum(dim=1).mean()
    return loss, {"selected": selected.detach(), "unselected": (loss - selected).detach()}


def actor_critic_imitation_loss(
    outputs: tuple[torch.Tensor, torch.Tensor, torch.Tensor],
    action: torch.Tensor,
    returns: torch.Tensor,
    likelihood_coefficient: float,
    value_coefficient: float,
    entropy_coefficient: float,
    return_unit: float = 1.0,
    is_target: torch.Tensor | None = None,
    is_valued: torch.Tensor | None = None,
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    r"""Loss of policy and value (Eq. 6), averaged over the batch.

    .. math:: L_{il} = E[-\Upsilon \log \pi(a_l | s_l) + c_1 (v^{tar}(s_l) - v(s_l))^2 + c_2 H(\pi(\cdot | s_l))]

    Args:
        outputs: means [B, 4], standard deviations [B, 4] and values [B] of the network.
        action: [B, 4].
        returns: [B] v^tar.
        likelihood_coefficient: Upsilon.
        value_coefficient: c1.
        entropy_coefficient: c2, of the penalty on high entropy.
        return_unit: unit of the returns in the squared error.
        is_target: [B] pairs whose action the policy learns; None for all.
        is_valued: [B] pairs whose return the value learns; None for all.

    Returns:
        the loss, and its terms without their coefficients.
    """
    mean, std, value = outputs
    policy = Independent(Normal(mean, std, validate_args=False), 1, validate_args=False)
    log_likelihood = _mean(policy.log_prob(action), is_target)
    value_error = _mean(((returns - value) / return_unit).square(), is_valued)
    entropy = policy.entropy().mean()
    loss = -likelihood_coefficient * log_likelihood + value_coefficient * value_error + entropy_coefficient * entropy
    terms = {"log_likelihood": log_likelihood, "value_error": value_error, "entropy": entropy}
    return loss, {name: term.detach() for name, term in terms.items()}


def _mean(values: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
    """Mean over the pairs in ``mask`` [B], 0 if there are none; over all pairs without a mask."""
    if mask is None:
        return values.mean()
    return torch.where(mask, values, 0.0).sum() / mask.sum().clamp(min=1)
