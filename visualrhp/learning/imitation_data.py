"""State-action pairs of demonstrations, stored compactly and unpacked to tensors (Sec. 6.2).

Time indices: a demonstration has the states s_0 ... s_L and the actions a_0 ... a_{L-1}; the pair (s_l, a_l) is
followed by the rewards r_{l+1} ... r_L, and ``steps_to_go`` is L - l.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

from visualrhp.demonstrations.returns import monte_carlo_returns
from visualrhp.errors import DataError
from visualrhp.observation.observation import Observation, ObservationStore
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import DiscreteActionSpace
from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import Episode

_MIRRORED_CONTINUOUS = torch.tensor([1.0, -1.0, -1.0, 1.0])
_MIRRORED_DISCRETE = torch.tensor(DiscreteActionSpace.MIRRORED)


@dataclass(frozen=True)
class ImitationBatch:
    """B state-action pairs of demonstrations, as tensors.

    Attributes:
        observation: [B, 64, 64] uint8 labels or [B, 4 m + 6] float32 features.
        gripper_closed: [B] bool.
        action: [B] int64 or [B, 4] float32.
        returns: [B] float32, Monte Carlo targets (Eq. 4).
        steps_to_go: [B] int64, L - l.
        is_target: [B] bool, pairs whose action the policy learns; None for all.
        is_valued: [B] bool, pairs whose return the value learns; None for all.
    """

    observation: torch.Tensor
    gripper_closed: torch.Tensor
    action: torch.Tensor
    returns: torch.Tensor
    steps_to_go: torch.Tensor
    is_target: torch.Tensor | None = None
    is_valued: torch.Tensor | None = None

    def mirrored(self, rows: torch.Tensor, observation: Observation) -> ImitationBatch:
        """The same pairs, with those in the mask ``rows`` [B] mirrored."""
        parts = dict(vars(self))
        mirror = torch.from_numpy(np.ascontiguousarray(observation.mirror(self.observation.numpy())))
        mask = rows.view(-1, *[1] * (mirror.dim() - 1))
        parts["observation"] = torch.where(mask, mirror, self.observation)
        if self.action.dim() == 1:
            parts["action"] = torch.where(rows, _MIRRORED_DISCRETE[self.action], self.action)
        else:
            parts["action"] = torch.where(rows[:, None], self.action * _MIRRORED_CONTINUOUS, self.action)
        return ImitationBatch(**parts)


@dataclass(frozen=True)
class ImitationData:
    """T state-action pairs of demonstrations, stored compactly: a batch is unpacked when it is used.

    Attributes:
        observation: the observation that the network reads.
        observations: T observations.
        gripper_closed: [T] bool.
        action: [T] int64 or [T, 4] float32.
        returns: [T] float32, Monte Carlo targets (Eq. 4).
        steps_to_go: [T] int32, L - l.
        demonstration: [T] int32, number of the demonstration of each pair.
        is_target: [T] bool, pairs whose action the policy learns; None for all.
        is_valued: [T] bool, pairs whose return the value learns; None for all.
    """

    observation: Observation
    observations: ObservationStore
    gripper_closed: torch.Tensor
    action: torch.Tensor
    returns: torch.Tensor
    steps_to_go: torch.Tensor
    demonstration: torch.Tensor
    is_target: torch.Tensor | None = None
    is_valued: torch.Tensor | None = None

    @classmethod
    def from_demonstrations(
        cls,
        demonstrations: Iterable[tuple[TaskInstance, Episode]],
        observe: Observation,
        discount: float = DISCOUNT,
    ) -> ImitationData:
        """Observe all states of the demonstrations except the last ones; one demonstration is in memory at a time.

        Raises:
            DataError: there are no demonstrations.
        """
        closed, returns = array("b"), array("f")
        steps_to_go, numbers = array("i"), array("i")
        actions: list[np.ndarray] = []

        def observed() -> Iterator[np.ndarray]:
            for number, (task, episode) in enumerate(demonstrations):
                length = len(episode)
                closed.extend(state.gripper_closed for state in episode.states[:-1])
                returns.extend(monte_carlo_returns(episode.rewards, discount))
                steps_to_go.extend(range(length, 0, -1))
                numbers.extend([number] * length)
                action = np.array(episode.actions)
                actions.append(action if action.ndim == 1 else action.astype(np.float32))
                for state in episode.states[:-1]:
                    yield observe(task.scene, state)

        observations = observe.store(observed())
        if not actions:
            raise DataError("there are no demonstrations to imitate")
        return cls(
            observation=observe,
            observations=observations,
            gripper_closed=torch.tensor(np.array(closed, dtype=np.bool_)),
            action=torch.from_numpy(np.concatenate(actions)),
            returns=torch.tensor(np.array(returns)),
            steps_to_go=torch.tensor(np.array(steps_to_go)),
            demonstration=torch.tensor(np.array(numbers)),
        )

    def __len__(self) -> int:
        return len(self.returns)

    def __getitem__(self, rows: torch.Tensor) -> ImitationBatch:
        """Unpack the pairs with the indices ``rows`` [B]."""
        return ImitationBatch(
            observation=torch.from_numpy(self.observations[rows.numpy()]),
            gripper_closed=self.gripper_closed[rows],
            action=self.action[rows],
            returns=self.returns[rows],
            steps_to_go=self.steps_to_go[rows].to(torch.int64),
            is_target=None if self.is_target is None else self.is_target[rows],
            is_valued=None if self.is_valued is None else self.is_valued[rows],
        )

    def split(self, fraction: float, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Indices of training and held-out pairs; whole demonstrations are held out, ``fraction`` of them."""
        numbers = torch.unique(self.demonstration)
        order = torch.randperm(len(numbers), generator=generator)
        held_out = torch.isin(self.demonstration, numbers[order[: round(fraction * len(numbers))]])
        return torch.nonzero(~held_out)[:, 0], torch.nonzero(held_out)[:, 0]
