"""A trained network as the heuristic of a planner (Sec. 5.2)."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from torch import nn

from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.heuristics.heuristic import GaussianGuidance, Guidance, Heuristic, SoftmaxGuidance
from visualrhp.heuristics.inference import FastNetwork
from visualrhp.heuristics.networks import ActorCritic, QNetwork
from visualrhp.scene.scene import Scene
from visualrhp.types import State

DEFAULT_TEMPERATURE = 1.0
"""tau of Eq. 2; the paper does not state its own."""


class LearnedHeuristic(Heuristic):
    """Guides by a network: the softmax of action values, or a Gaussian policy with its value.

    The network is computed by :mod:`visualrhp.heuristics.inference`: what it says of a state is the same to the bit
    whichever other states are asked about with it.

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
        self._parameters = tuple(network.parameters())
        *_, self._last_shared = (layer for layer in network.body if isinstance(layer, nn.Linear))
        self._fast, self._version = FastNetwork(network), self._present_version()

    def guide(self, scenes: Sequence[Scene], states: Sequence[State]) -> Guidance:
        """Look at B states, each in its scene, in one call of the network.

        States that are asked about several times, as discrete roll-outs that begin alike do, are looked at once.

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
        rows: dict[tuple[int, State], int] = {}
        row_of = [rows.setdefault((id(scene), state), len(rows)) for scene, state in zip(scenes, states, strict=True)]
        different = scenes, states
        if len(rows) < len(states):
            firsts = [row_of.index(row) for row in range(len(rows))]
            different = [scenes[k] for k in firsts], [states[k] for k in firsts]
        started = time.perf_counter()
        observations = np.array([observe(scene, state) for scene, state in zip(*different, strict=True)])
        observation_s = time.perf_counter() - started
        closed = np.array([state.gripper_closed for state in different[1]])
        outputs = [output[row_of].astype(np.float64) for output in self._present_network()(observations, closed)]
        if len(outputs) == 1:
            return SoftmaxGuidance(outputs[0], self.temperature, observation_s)
        means, stds, values = outputs
        return GaussianGuidance(means, stds, values, observation_s)

    def _present_network(self) -> FastNetwork:
        """The network with the weights that it has now."""
        version = self._present_version()
        if version != self._version:
            self._fast, self._version = FastNetwork(self.network), version
        return self._fast

    def _present_version(self) -> tuple[object, ...]:
        """Differs when the weights do.

        PyTorch counts the changes of a parameter in place, but not those that fused optimizers make: these are seen in
        the biases of the last layer that all outputs share, which no step of training leaves as they are.
        """
        biases = self._last_shared.bias.detach().cpu().numpy().tobytes()
        return (biases, *[parameter._version for parameter in self._parameters])
