"""A trained network as the heuristic of a planner (Sec. 5.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.heuristics.heuristic import GaussianGuidance, Guidance, Heuristic, SoftmaxGuidance
from visualrhp.heuristics.networks import ActorCritic, QNetwork
from visualrhp.scene.scene import Scene
from visualrhp.types import State

DEFAULT_TEMPERATURE = 1.0
"""tau of Eq. 2; the paper does not state its own."""


class LearnedHeuristic(Heuristic):
    """Guides by a network: the softmax of action values, or a Gaussian policy with its value.

    Args:
        network: is looked at, not copied; a network in training guides with its present weights.
        temperature: tau of Eq. 2 (discrete action space).

    Raises:
        ConfigError: the temperature is not positive.
    """

    def __init__(self, network: QNetwork | ActorCritic, temperature: float = DEFAULT_TEMPERATURE) -> None:
        if not temperature > 0.0:
            raise ConfigError(f"temperature={temperature}: the temperature of Eq. 2 must be positive")
        self.network = network
        self.temperature = temperature
        self.action_space = network.action_space

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        """Look at B states, each in its scene, in one call of the network.

        Raises:
            CheckpointError: a Cartesian network meets a scene of another density than its own (Sec. 7.5).
        """
        observe = self.network.observation
        if observe.num_objects is not None:
            for scene in scenes:
                if scene.num_objects != observe.num_objects:
                    raise CheckpointError(
                        f"this Cartesian network reads scenes of {observe.num_objects} objects and cannot guide in "
                        f"one of {scene.num_objects}; every density needs its own (Sec. 7.5)"
                    )
        observations = torch.from_numpy(np.stack([observe(*pair) for pair in zip(scenes, states, strict=True)]))
        closed = torch.tensor([state.gripper_closed for state in states])
        device = next(self.network.parameters()).device
        with torch.inference_mode():
            outputs = self.network(observations.to(device), closed.to(device))
        if isinstance(outputs, torch.Tensor):
            return SoftmaxGuidance(_numpy(outputs), self.temperature)
        return GaussianGuidance(*map(_numpy, outputs))


def _numpy(tensor: torch.Tensor) -> np.ndarray:
    return tensor.double().cpu().numpy()
