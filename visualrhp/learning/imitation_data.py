"""State-action pairs of demonstrations, stored compactly and unpacked to tensors (Sec. 6.2).

Time indices: a demonstration has the states s_0 ... s_L and the actions a_0 ... a_{L-1}; the pair (s_l, a_l) is
followed by the rewards r_{l+1} ... r_L, and ``steps_to_go`` is L - l.
"""

from __future__ import annotations

import functools
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from visualrhp.demonstrations.returns import monte_carlo_returns
from visualrhp.errors import DataError
from visualrhp.observation.observation import Observation, ObservationStore
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import DiscreteActionSpace
from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import Episode


@functools.cache
def _mirrored_continuous(device: torch.device) -> torch.Tensor:
    """Signs of the components of the mirrored action."""
    return torch.tensor([1.0, -1.0, -1.0, 1.0], device=device)


@functools.cache
def _mirrored_discrete(device: torch.device) -> torch.Tensor:
    """The mirrored actions."""
    return torch.tensor(DiscreteActionSpace.MIRRORED, device=device)


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
        unpacked: the observations and those of the mirrored scenes [T, ...] each, unpacked on the device of the
            tensors (:meth:`resident`); None if a batch is unpacked when it is used.
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
    unpacked: tuple[torch.Tensor, torch.Tensor] | None = None

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

    def resident(self, device: torch.device) -> ImitationData:
        """The same pairs in the memory of ``device``, where a batch needs no transfer: 8 kB per label image."""
        observations = self.observations[np.arange(len(self))]
        unpacked = [torch.from_numpy(each).to(device) for each in (observations, self._mirror(observations))]
        tensors = {name: part.to(device) for name, part in vars(self).items() if isinstance(part, torch.Tensor)}
        return replace(self, unpacked=(unpacked[0], unpacked[1]), **tensors)

    def __getitem__(self, rows: torch.Tensor) -> ImitationBatch:
        """The pairs with the indices ``rows`` [B]."""
        return self.batch(rows)

    def batch(self, rows: torch.Tensor, mirror: torch.Tensor | None = None) -> ImitationBatch:
        """The pairs with the indices ``rows`` [B]; those in the mask ``mirror`` [B] mirrored."""
        device = self.returns.device
        rows = rows.to(device, non_blocking=True)
        mirror = None if mirror is None else mirror.to(device, non_blocking=True)
        action = self.action[rows]
        if mirror is not None and action.dim() == 1:
            action = torch.where(mirror, _mirrored_discrete(device)[action], action)
        elif mirror is not None:
            action = torch.where(mirror[:, None], action * _mirrored_continuous(device), action)
        return ImitationBatch(
            observation=self._observations(rows, mirror),
            gripper_closed=self.gripper_closed[rows],
            action=action,
            returns=self.returns[rows],
            steps_to_go=self.steps_to_go[rows].to(torch.int64),
            is_target=None if self.is_target is None else self.is_target[rows],
            is_valued=None if self.is_valued is None else self.is_valued[rows],
        )

    def _observations(self, rows: torch.Tensor, mirror: torch.Tensor | None) -> torch.Tensor:
        if self.unpacked is not None:
            found = self.unpacked[0][rows]
            mirrored = found if mirror is None else self.unpacked[1][rows]
        else:
            observations = self.observations[rows.numpy()]
            found = torch.from_numpy(observations)
            mirrored = found if mirror is None else torch.from_numpy(self._mirror(observations))
        return found if mirror is None else torch.where(mirror.view(-1, *[1] * (found.dim() - 1)), mirrored, found)

    def _mirror(self, observations: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(self.observation.mirror(observations))

    def split(self, fraction: float, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Indices of training and held-out pairs; whole demonstrations are held out, ``fraction`` of them."""
        demonstration = self.demonstration.cpu()
        numbers = torch.unique(demonstration)
        order = torch.randperm(len(numbers), generator=generator)
        held_out = torch.isin(demonstration, numbers[order[: round(fraction * len(numbers))]])
        return torch.nonzero(~held_out)[:, 0], torch.nonzero(held_out)[:, 0]
