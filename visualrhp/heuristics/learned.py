"""A trained network as the heuristic of a planner (Sec. 5.2). Does not import torch."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from visualrhp.errors import ConfigError
from visualrhp.heuristics.heuristic import GaussianGuidance, Guidance, Heuristic, SoftmaxGuidance
from visualrhp.heuristics.inference import InferenceNetwork, Weights
from visualrhp.observation import Observation
from visualrhp.scene.scene import Scene
from visualrhp.types import ActionSpaceName, State

DEFAULT_TEMPERATURE = 1.0
"""tau of Eq. 2; the paper does not state its value."""


class LearnedHeuristic(Heuristic):
    """Guidance by a network: the softmax of action values, or a Gaussian policy with its value.

    The weights are copied: make a new heuristic when the weights of a network in training have changed. The guidance
    for a state does not depend on the other states in the batch.

    Args:
        weights: of the network, by their names in PyTorch's state dict.
        action_space: of the network.
        observation: that the network reads.
        temperature: tau of Eq. 2 (discrete action space).

    Attributes:
        network: evaluates the weights.
        observation, temperature: as given.

    Raises:
        ConfigError: the temperature is not positive.
        KeyError: a weight is missing.
    """

    def __init__(
        self,
        weights: Weights,
        action_space: ActionSpaceName,
        observation: Observation,
        temperature: float = DEFAULT_TEMPERATURE,
    ) -> None:
        if not temperature > 0.0:
            raise ConfigError(f"temperature={temperature}: the temperature of Eq. 2 must be positive")
        self.action_space = action_space
        self.observation = observation
        self.temperature = temperature
        self.network = InferenceNetwork(weights, action_space)

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        """Evaluate B states, each in its scene, in one call of the network; equal states are evaluated once.

        Raises:
            SceneError: a scene does not have the number of objects of the network (Sec. 7.5).
        """
        observe = self.observation
        for scene in scenes if observe.num_objects is not None else ():
            observe.check(scene)
        rows: dict[tuple[int, State], int] = {}
        row_of = [rows.setdefault((id(scene), state), len(rows)) for scene, state in zip(scenes, states, strict=True)]
        different = scenes, states
        if len(rows) < len(states):  # discrete roll-outs often share states
            firsts = [row_of.index(row) for row in range(len(rows))]
            different = [scenes[k] for k in firsts], [states[k] for k in firsts]
        started = time.perf_counter()
        observations = np.array([observe(scene, state) for scene, state in zip(*different, strict=True)])
        observation_s = time.perf_counter() - started
        closed = np.array([state.gripper_closed for state in different[1]])
        outputs = [output[row_of].astype(np.float64) for output in self.network(observations, closed)]
        if len(outputs) == 1:
            return SoftmaxGuidance(outputs[0], self.temperature, observation_s)
        means, stds, values = outputs
        return GaussianGuidance(means, stds, values, observation_s)
