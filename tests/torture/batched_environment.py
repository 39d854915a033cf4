"""Random calls of the batched environment against a model of its contract."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from tests.torture.contract import Slot, Surprise, bits, call
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.errors import ActionError, CheckpointError, ConfigError
from visualrhp.observation import observation_for
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.simulation import make_action_space
from visualrhp.streams import Split

NO_SEEDS: list[Any] = [-1, 1.5, True, "3", [1], np.timedelta64(3, "s")]


class BatchedCalls:
    """One batched environment and the model of its contract."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.num_envs = int(rng.integers(1, 5))
        fewest = int(rng.integers(1, 4))
        observation = str(rng.choice(["image", "cartesian"]))
        self.distribution = SceneDistribution(
            num_objects=(fewest, fewest) if observation == "cartesian" else (1, fewest)
        )
        self.split, self.seed = Split(int(rng.integers(len(Split)))), int(rng.integers(1000))
        self.action_space = make_action_space("discrete" if rng.random() < 0.5 else "continuous")
        self.observe = observation_for(observation, self.distribution)
        self.env = BatchedClutterEnv(
            self.distribution,
            self.action_space.name,
            observation,
            self.num_envs,
            self.seed,
            self.split,
            num_workers=int(rng.random() < 0.05),
        )
        self.slots: list[Slot] | None = None
        self.next_indices = list(range(self.num_envs))
        self.warned: set[int] = set()
        self.kept: tuple[Any, ...] | None = None  # a snapshot, and the model when it was taken
        self.calls: list[tuple[float, Callable[[], None]]] = [
            (50.0, self.step),
            (10.0, self.step_with_no_action),
            (5.0, self.reset),
            (2.0, self.reset_with_nonsense),
            (2.0, self.set_seed),
            (2.0, self.snapshot),
            (2.0, self.restore),
            (2.0, self.restore_another),
            (1.0, self.recall),
            (0.5, self.rollout),
            (0.5, self.copy_or_pickle),
            (0.5, self.close),
            (2.0, self.read),
        ]

    def _start(self, chosen: list[int]) -> None:
        slots: list[Any] = [None] * self.num_envs if self.slots is None else self.slots
        for slot in chosen:
            slots[slot] = Slot.sample(self, self.seed, self.next_indices[slot])
            self.next_indices[slot] += self.num_envs
            self.warned.discard(slot)
        self.slots = slots

    def reset(self) -> None:
        everything = list(range(self.num_envs))
        chosen, arguments = everything, {}
        given = None
        if self.slots is not None and self.rng.random() < 0.5:
            mask = torch.tensor(self.rng.random(self.num_envs) < 0.5)
            # torchrl takes the entries of the other slots from what it is given
            given = self.env.current().set("_reset", mask if self.rng.random() < 0.5 else mask[:, None])
            chosen = mask.nonzero()[:, 0].tolist()
            if not chosen:
                return
        if self.rng.random() < 0.2:
            arguments["seed"] = self.seed = int(self.rng.integers(1000))
            self.next_indices = everything.copy()
        seen = call(lambda: self.env.reset(given, **arguments))
        self._start(chosen)
        self.compare(seen)

    def reset_with_nonsense(self) -> None:
        seed = NO_SEEDS[int(self.rng.integers(len(NO_SEEDS)))]
        wrong = TensorDict({"_reset": torch.ones(self.num_envs)}, [self.num_envs])
        too_many = TensorDict({}, [self.num_envs + 1])
        functions: list[Callable[[], Any]] = [
            lambda: self.env.reset(seed=seed),
            lambda: self.env.set_seed(seed),
            lambda: self.env.reset(nonsense=1),
            lambda: self.env.reset(seed=3, options={}),
            lambda: self.env.reset(wrong),
            lambda: self.env.reset(too_many),
            lambda: self.env.to("sonar"),
        ]
        call(functions[int(self.rng.integers(len(functions)))], ConfigError)
        self.read()

    def set_seed(self) -> None:
        seed = int(self.rng.integers(1000))
        if self.rng.random() < 0.8:
            self.seed = seed
            self.env.set_seed(seed)
        else:
            self.env.set_seed(None)
        self.next_indices = list(range(self.num_envs))

    def _actions(self) -> torch.Tensor:
        if self.action_space.name == "discrete":
            return torch.tensor([int(self.action_space.sample(self.rng)) for _ in range(self.num_envs)])
        scale = 10.0 ** self.rng.integers(0, 3)
        actions = torch.tensor(self.rng.uniform(-scale, scale, (self.num_envs, 4)))
        return actions.float().requires_grad_() if self.rng.random() < 0.5 else actions

    def _take(self, actions: torch.Tensor, active: list[int]) -> None:
        assert self.slots is not None
        for slot in active:
            action = actions[slot].detach().double().numpy() if actions.ndim == 2 else int(actions[slot])
            self.slots[slot].step(action)

    def step(self) -> None:
        actions = self._actions()
        given = TensorDict({"action": actions}, [self.num_envs])
        if self.slots is None:
            call(lambda: self.env.step(given), ActionError)
            return
        active = list(range(self.num_envs))
        over = [slot for slot in active if self.slots[slot].is_over]
        if over and self.rng.random() < 0.8:  # leave them out
            active = [slot for slot in active if slot not in over]
            if not active:
                self.reset()
                return
            mask = torch.zeros(self.num_envs, dtype=torch.bool)
            mask[active] = True
            given = self.env.current().set("action", actions).set("_step", mask)
        is_due = any(slot in over and slot not in self.warned for slot in active)
        self.warned.update(slot for slot in active if slot in over)
        following = call(lambda: self.env.step(given), warns=is_due)["next"]
        self._take(actions, active)
        rewards = [[slot.reward if number in active else 0.0] for number, slot in enumerate(self.slots)]
        if following["reward"].tolist() != rewards:
            raise Surprise(f"the rewards are {following['reward'].tolist()}, and {rewards} were expected")
        self.compare(following)

    def step_with_no_action(self) -> None:
        count, is_discrete = self.num_envs, self.action_space.name == "discrete"
        shape = (count,) if is_discrete else (count, 4)
        wrong: list[Any] = [
            torch.full(shape, 1, dtype=torch.bool),
            torch.ones(shape, dtype=torch.complex64),
            torch.ones((count, 2), dtype=torch.int64),
            torch.full(shape, torch.nan),
            torch.empty(shape, device="meta"),
            torch.full((count, 1), 0.5),
            "abc",
            None,
        ]
        wrong += (
            [torch.full(shape, 1.99), torch.full(shape, 8), torch.full(shape, -1)]
            if is_discrete
            else [torch.zeros(count)]
        )
        action = wrong[int(self.rng.integers(len(wrong)))]
        given = TensorDict({} if action is None else {"action": action}, [count])
        call(lambda: self.env.step(given), ActionError)
        self.read()

    def snapshot(self) -> None:
        if self.slots is None:
            call(self.env.snapshot, ActionError)
            return
        taken = call(self.env.snapshot)
        self.kept = taken, [copy.copy(slot) for slot in self.slots], self.next_indices.copy(), self.seed

    def restore(self) -> None:
        if self.kept is None:
            return
        taken, slots, next_indices, seed = self.kept
        if seed != self.seed:
            call(lambda: self.env.restore(taken), CheckpointError)
            self.read()
            return
        seen = call(lambda: self.env.restore(taken))
        self.slots, self.next_indices = [copy.copy(slot) for slot in slots], next_indices.copy()
        self.warned.clear()
        self.compare(seen)

    def restore_another(self) -> None:
        if self.kept is None:
            return
        damaged = dict(self.kept[0])
        key = list(damaged)[int(self.rng.integers(len(damaged)))]
        if self.rng.random() < 0.5:
            del damaged[key]
        else:
            damaged[key] = torch.full((self.num_envs,), torch.nan)
        call(lambda: self.env.restore(damaged), CheckpointError)
        self.read()

    def recall(self) -> None:
        if self.slots is None or any(slot.seed != self.seed for slot in self.slots):
            return
        current = self.env.current()
        recalled = call(lambda: self.env.recall(current["instance"], current["state"]))
        if bits(recalled["observation"]) != bits(current["observation"]):
            raise Surprise("the recalled observations are not those that were seen")
        call(lambda: self.env.recall(current["instance"], current["state"].float()), ConfigError)

    def rollout(self) -> None:
        """Some steps of torchrl's own loop, with slots that are reset as their episodes end."""
        given: list[torch.Tensor] = []

        def policy(td):
            given.append(self._actions().detach())
            return td.set("action", given[-1])

        steps = call(lambda: self.env.rollout(4, policy, break_when_any_done=False))
        self._start(list(range(self.num_envs)))
        assert self.slots is not None
        for step, actions in enumerate(given):
            self._take(actions, list(range(self.num_envs)))
            flags = [[slot.is_over] for slot in self.slots]
            if steps["next", "done"][:, step].tolist() != flags:
                raise Surprise("a roll-out has other ends")
            over = [slot for slot in range(self.num_envs) if self.slots[slot].is_over]
            if over and step < len(given) - 1:
                self._start(over)
        self.read()

    def copy_or_pickle(self) -> None:
        twin = copy.deepcopy(self.env) if self.rng.random() < 0.5 else pickle.loads(pickle.dumps(self.env))
        self.env.close()
        self.env = twin
        self.warned.clear()
        self.read()

    def close(self) -> None:
        call(self.env.close)
        self.slots = None
        self.warned.clear()

    def read(self) -> None:
        if self.slots is None:
            for name in ("states", "scenes", "models", "instances", "num_actions"):
                call(lambda name=name: getattr(self.env, name), ActionError)
            call(self.env.current, ActionError)
            return
        if self.env.states != [slot.state for slot in self.slots]:
            raise Surprise("the states are not those of the model")
        if self.env.instances != [slot.index for slot in self.slots]:
            raise Surprise("the instances are not those of the model")
        if self.env.num_actions != [slot.num_actions for slot in self.slots]:
            raise Surprise(f"actions are {self.env.num_actions}, not {[slot.num_actions for slot in self.slots]}")

    def compare(self, seen: Any) -> None:
        """Compare what reset, step or restore returned."""
        self.read()
        assert self.slots is not None
        for number, slot in enumerate(self.slots):
            row = seen[number]
            expected = {
                "instance": slot.index,
                "gripper_closed": slot.state.gripper_closed,
                "is_goal": slot.is_goal,
                "is_dropped": slot.is_dropped,
                "terminated": slot.is_terminal,
                "truncated": slot.is_truncated,
                "done": slot.is_over,
            }
            found = {key: row[key].item() for key in expected}
            if found != expected:
                raise Surprise(f"slot {number} has {found}, and {expected} was expected")
            if bits(row["observation"]) != bits(self.observe(slot.scene, slot.state)):
                raise Surprise("the observation is not that of the state")
            if not row["state"].numpy().tobytes().startswith(slot.state.vector.tobytes()):
                raise Surprise("the state is not that of the model")
