"""Random calls of both environments, valid and hostile, against small models of their contracts.

A model knows the seeds, indices, states and ends of the episodes, and computes every transition with its own
:class:`TransitionModel`. A surprise is another result than the model's, to the bit; another error than the named one; a
warning that is missing or not due; or a message of more than 2,000 characters.
"""

from __future__ import annotations

import copy
import pickle
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import torch

from tests.torture.batched_environment import BatchedCalls
from tests.torture.contract import LIMIT, Slot, Surprise, bits, call
from visualrhp.environments import ClutterManipulation
from visualrhp.errors import ActionError, ConfigError, SceneError
from visualrhp.observation import observation_for
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.simulation import make_action_space
from visualrhp.streams import Split
from visualrhp.types import State

ENVIRONMENT = "visualrhp/ClutterManipulation-v0"
_CALLS_PER_ENVIRONMENT = 400
_MOST_EXAMPLES = 20


class Failing:
    """Whatever is done with it fails."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        raise RuntimeError("no")

    def __repr__(self) -> str:
        raise RuntimeError("no")


NO_ACTIONS: list[Any] = [
    *("abc", "3", b"1234", ["1", "0", "0", "0"], np.array(["1"] * 4), [[1], [2, 3]], [[1, 2], 3, 4, 5], 3j, [1j] * 4),
    *(np.full(4, 1j), np.full(4, "2020-01-01", "datetime64[D]"), np.timedelta64(3, "s"), np.zeros(4, "timedelta64[s]")),
    *(
        True,
        np.True_,
        [True] * 4,
        np.ones(4, bool),
        [0.5, True, 0.0, 0.0],
        torch.ones(4) > 0,
        torch.zeros(4).to("meta"),
    ),
    *(None, [None] * 4, {}, {0, 1, 2, 3}, object(), np.zeros(4, dtype=object), np.zeros(4, [("x", float)]), len),
    *(Failing(), range(10**12), [10**400, 0, 0, 0], 10**6000, "x" * 10**6, [0.5] * 10**5, np.zeros((64, 64)), []),
    *(0.5, 1.99, 3.0, -1, 8, 2**64, [0.1] * 3, [0.1] * 5, np.zeros((1, 4)), np.zeros((4, 1)), [np.nan] * 4),
    *(
        [0.0, 0.0, 0.0, -np.inf],
        torch.full((4,), torch.nan),
        np.ma.masked,
        [[3]],
        [1, 2],
        np.zeros(0),
        np.full(4, np.inf),
    ),
]
"""No action of either space."""

NO_SEEDS: list[Any] = [-1, 1.5, True, "3", [1], 3j, np.timedelta64(3, "s"), Failing(), np.zeros(2)]
NO_OPTIONS: list[Any] = [
    *("abc", [1], 3, {1: 2, "b": 3}, {"colour": 3}, {"x" * 10**5: 1}, {"instance": -1}, {"instance": 1.5}, Failing()),
    *({"instance": True}, {"instance": "3"}, {"instance": 2**63}, {"instance": [3]}, {"instance": 0, "state": None}),
]
NO_STARTS: list[Any] = [
    *(
        {"scene": 3},
        {"state": 3},
        {"scene": 3, "state": 3},
        {"state": State(np.zeros(8))},
        {"state": State(np.full(8, np.nan))},
    ),
    {"state": State(np.arange(11.0))},
]


class GymnasiumCalls:
    """One Gymnasium environment and the model of its contract."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        fewest = int(rng.integers(1, 4))
        observation = str(rng.choice(["image", "cartesian"]))
        space = str(rng.choice(["discrete", "continuous"]))
        arguments: dict[str, Any] = {
            "action_space": space,
            "observation": observation,
            "num_objects": fewest if observation == "cartesian" else (1, fewest),
            "split": Split(int(rng.integers(len(Split)))),
            "render_mode": "rgb_array",
        }
        self.is_made = bool(rng.random() < 0.5)
        # Gymnasium's checker fails in the first step of an environment whose first reset was refused.
        made: dict[str, Any] = dict(arguments)
        self.env: Any = gymnasium.make(ENVIRONMENT, **made) if self.is_made else ClutterManipulation(**arguments)
        bounds = (fewest, fewest) if observation == "cartesian" else (1, fewest)
        self.distribution = SceneDistribution(num_objects=bounds)
        self.split, self.action_space = arguments["split"], make_action_space(space)  # type: ignore[arg-type]
        self.observe = observation_for(observation, self.distribution)
        self.slot: Slot | None = None
        self.seed: int | None = None
        self.next_index = 0
        self.is_warned = False
        self.calls: list[tuple[float, Callable[[], None]]] = [
            (60.0, self.step),
            (12.0, self.step_with_no_action),
            (5.0, self.reset),
            (2.0, self.reset_with_nonsense),
            (0.4, self.copy_or_pickle),
            (0.7, self.close),
            (0.3, self.render),
            (3.0, self.read),
        ]

    def reset(self) -> None:
        kind = self.rng.choice(["next", "seed", "instance", "state", "scene"], p=[0.5, 0.2, 0.1, 0.1, 0.1])
        seed = int(self.rng.integers(0, 1000)) if kind == "seed" or self.rng.random() < 0.1 else None
        options: dict[str, Any] | None = None
        index, given = None, None
        if kind == "instance":
            index = int(self.rng.integers(0, 50))
            options = {"instance": index if self.rng.random() < 0.5 else np.int64(index)}
        elif kind in ("state", "scene"):
            given = self.slot if kind == "state" else Slot.sample(self, int(self.rng.integers(100)), 7)
            if given is None or (kind == "state" and given.is_dropped):
                return
            options = {"state": given.state} | ({"scene": given.scene} if kind == "scene" else {})
        observation, info = call(lambda: self.env.reset(seed=seed, options=options))
        if seed is not None:
            self.seed, self.next_index = seed, 0
        elif self.seed is None:
            generator, _ = gymnasium.utils.seeding.np_random(self.env.unwrapped.np_random_seed)
            self.seed = int(generator.integers(2**31))
        if given is None:
            index = self.next_index if index is None else index
            self.slot, self.next_index = Slot.sample(self, self.seed, index), index + 1
        else:
            self.slot = Slot(given.scene, given.state, given.model, -1)
        self.is_warned = False
        self.compare(observation, info)

    def reset_with_nonsense(self) -> None:
        kind = int(self.rng.integers(3))
        if kind == 0:
            seed = NO_SEEDS[int(self.rng.integers(len(NO_SEEDS)))]
            call(lambda: self.env.reset(seed=seed), ConfigError)
        elif kind == 1:
            options = NO_OPTIONS[int(self.rng.integers(len(NO_OPTIONS)))]
            call(lambda: self.env.reset(seed=5, options=options), ConfigError)
        else:
            options = NO_STARTS[int(self.rng.integers(len(NO_STARTS)))]
            call(lambda: self.env.reset(seed=5, options=options), SceneError)
        self.read()

    def step(self) -> None:
        action: Any = self.action_space.sample(self.rng)
        given: Any = action
        if isinstance(action, int):
            given = [action, np.int64(action), np.array(action), torch.tensor(action)][int(self.rng.integers(4))]
        elif self.rng.random() < 0.3:
            action = action * 10.0 ** self.rng.integers(0, 308)
            given = [list(action), tuple(action), torch.tensor(action, requires_grad=True)][int(self.rng.integers(3))]
        if self.slot is None:
            call(lambda: self.env.step(given), (ActionError, gymnasium.error.ResetNeeded))
            return
        is_due = self.slot.is_over and not self.is_warned
        self.is_warned |= is_due
        observation, reward, terminated, truncated, info = call(lambda: self.env.step(given), warns=is_due)
        self.slot.step(action)
        if (reward, terminated, truncated) != (self.slot.reward, self.slot.is_terminal, self.slot.is_truncated):
            raise Surprise(f"step returned {(reward, terminated, truncated)}, and {self.slot} was expected")
        self.compare(observation, info)
        if self.slot.is_over and self.rng.random() < 0.9:
            self.reset()

    def step_with_no_action(self) -> None:
        action = NO_ACTIONS[int(self.rng.integers(len(NO_ACTIONS)))]
        call(lambda: self.env.step(action), (ActionError, gymnasium.error.ResetNeeded))
        self.read()

    def copy_or_pickle(self) -> None:
        twin = copy.deepcopy(self.env) if self.rng.random() < 0.5 else pickle.loads(pickle.dumps(self.env))
        if self.slot is not None and twin.unwrapped.state.vector.flags.writeable:
            raise Surprise("the state of a copy is writable")
        self.env = twin

    def close(self) -> None:
        call(self.env.close)
        self.slot = None

    def render(self) -> None:
        if self.slot is None:
            call(self.env.render, (ActionError, gymnasium.error.ResetNeeded))
        elif call(self.env.render).dtype != np.uint8:
            raise Surprise("render returned no picture")

    def read(self) -> None:
        plain = self.env.unwrapped
        if self.slot is None:
            for name in ("state", "scene", "model"):
                call(lambda name=name: getattr(plain, name), ActionError)
        elif plain.state != self.slot.state or plain.scene != self.slot.scene:
            raise Surprise(f"the state is not that of {self.slot}")

    def compare(self, observation: Any, info: Any) -> None:
        slot = self.slot
        assert slot is not None
        expected = {
            "is_goal": slot.is_goal,
            "is_dropped": slot.is_dropped,
            "num_actions": slot.num_actions,
            "instance": slot.index,
        }
        self.read()
        if info != expected:
            raise Surprise(f"info is {info}, and {expected} was expected")
        seen = self.observe(slot.scene, slot.state)
        if bits(observation["observation"]) != bits(seen) or observation["gripper_closed"] != slot.state.gripper_closed:
            raise Surprise("the observation is not that of the state")


def run(num_calls: int, seed: int) -> dict[str, Any]:
    """Call both environments ``num_calls`` times; an environment with a surprise is replaced.

    Returns:
        ``calls``, ``surprises``, ``by_call`` (how often each was made), ``examples`` of surprises (the call, and the
        last line of what happened), ``seconds``, and the ``limit`` of an episode that the model assumes.
    """
    rng = np.random.default_rng(seed)
    started, counts, examples, surprises, done = time.perf_counter(), Counter[str](), [], 0, 0
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        while done < num_calls:
            kind = GymnasiumCalls if rng.random() < 0.6 else BatchedCalls
            player = kind(rng)
            for name, make_call in _some(player, rng, min(_CALLS_PER_ENVIRONMENT, num_calls - done)):
                done += 1
                counts[name] += 1
                try:
                    make_call()
                except Exception:
                    surprises += 1
                    if len(examples) < _MOST_EXAMPLES:
                        examples.append(f"{name}: {traceback.format_exc(limit=-4)[-1500:]}")
                    break
            player.env.close()
    return {
        "calls": done,
        "surprises": surprises,
        "by_call": dict(counts),
        "examples": examples,
        "seconds": time.perf_counter() - started,
        "limit": LIMIT,
    }


def _some(player: Any, rng: np.random.Generator, count: int) -> Iterator[tuple[str, Callable[[], None]]]:
    """Calls of ``player``, drawn by their weights, with their names."""
    weights = np.array([weight for weight, _ in player.calls])
    for choice in rng.choice(len(weights), count, p=weights / weights.sum()):
        made = player.calls[choice][1]
        yield f"{type(player).__name__}.{made.__name__}", made
