"""A trivial task with the interfaces of the real one: walk along a line to its right end, and do not fall off the left.

Position x; the goal is x >= 1, x < 0 is a drop. Discrete: action 0 goes right by 0.25, 1 goes left, all others stay.
Continuous: the first component times 0.25. Observation [5]: x, and four bumps around the places 0, 0.25, 0.5 and 0.75.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from visualrhp.planning.planner import Decision
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.types import ActionSpaceName, State

STEP = 0.25
LIMIT = 10
FEATURES = 5


def features(x: torch.Tensor) -> torch.Tensor:
    """Positions [B] to observations [B, 5]."""
    bumps = torch.exp(-(((x[:, None] - STEP * torch.arange(4)) / 0.15) ** 2))
    return torch.cat([x[:, None], bumps], -1).float()


class Corridor(EnvBase):
    """N corridors side by side; corridor ``index`` starts at 0, 0.25 or 0.5 by turns."""

    def __init__(self, action_space: ActionSpaceName, num_envs: int = 4) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=(num_envs,))
        batch = (num_envs,)
        self.action_space = make_action_space(action_space)
        self.num_envs = num_envs
        self.next_index = torch.arange(num_envs)
        self.instance = torch.zeros(num_envs, dtype=torch.int64)
        self.taken = torch.zeros(num_envs, dtype=torch.int64)
        self.x = torch.zeros(num_envs, dtype=torch.float64)
        flag = Categorical(2, shape=batch, dtype=torch.bool)
        self.observation_spec = Composite(
            observation=Unbounded(shape=(*batch, FEATURES)),
            gripper_closed=flag,
            state=Unbounded(shape=(*batch, 1), dtype=torch.float64),
            instance=Unbounded(shape=batch, dtype=torch.int64),
            is_goal=flag.clone(),
            is_dropped=flag.clone(),
            shape=batch,
        )
        self.action_spec = (
            Categorical(8, shape=batch) if action_space == "discrete" else Bounded(-1.0, 1.0, shape=(*batch, 4))
        )
        self.reward_spec = Unbounded(shape=(*batch, 1))
        done = Binary(1, shape=(*batch, 1), dtype=torch.bool)
        self.done_spec = Composite(done=done, terminated=done.clone(), truncated=done.clone(), shape=batch)

    # What the exploration policy sees; a model is the slot's number here.
    @property
    def models(self) -> Sequence[int]:
        return range(self.num_envs)

    @property
    def states(self) -> list[float]:
        return self.x.tolist()

    @property
    def instances(self) -> list[int]:
        return self.instance.tolist()

    @property
    def num_actions(self) -> list[int]:
        return self.taken.tolist()

    @staticmethod
    def observe(scene: object, state: State) -> np.ndarray:
        return features(torch.tensor([state.vector[0]]))[0].numpy()

    def recall(self, instances: torch.Tensor, states: torch.Tensor) -> TensorDict:
        closed = torch.zeros(len(states), dtype=torch.bool)
        return TensorDict({"observation": features(states[:, 0]), "gripper_closed": closed}, batch_size=[len(states)])

    def _set_seed(self, seed: int | None) -> None:
        pass

    def _entries(self) -> dict[str, torch.Tensor]:
        state = self.x[:, None].clone()
        nothing = torch.zeros(self.num_envs, dtype=torch.bool)
        return {
            **self.recall(self.instance, state),
            "state": state,
            "instance": self.instance.clone(),
            "is_goal": nothing,
            "is_dropped": nothing.clone(),
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDict:
        chosen = torch.ones(self.num_envs, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118 - not a dict
            chosen = tensordict["_reset"].reshape(-1)
        self.instance[chosen] = self.next_index[chosen]
        self.next_index[chosen] += self.num_envs
        self.x[chosen] = STEP * (self.instance[chosen] % 3).double()
        self.taken[chosen] = 0
        return TensorDict(self._entries(), batch_size=self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict["action"]
        if self.action_space.name == "discrete":
            move = (action == 0).double() - (action == 1).double()
        else:
            move = action[:, 0].double().clip(-1.0, 1.0)
        self.x = self.x + STEP * move
        self.taken += 1
        goal, dropped = self.x >= 1.0 - 1e-9, self.x < -1e-9
        terminated = (goal | dropped)[:, None]
        truncated = (self.taken >= LIMIT)[:, None] & ~terminated
        reward = torch.where(dropped, -50.0, -1.0)[:, None].float()
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
        entries = {**self._entries(), "is_goal": goal, "is_dropped": dropped, "reward": reward, **flags}
        return TensorDict(entries, batch_size=self.batch_size)

    def snapshot(self) -> dict[str, torch.Tensor]:
        return {name: getattr(self, name).clone() for name in ("instance", "next_index", "taken", "x")}

    def restore(self, snapshot: Mapping[str, torch.Tensor]) -> TensorDict:
        for name in ("instance", "next_index", "taken", "x"):
            setattr(self, name, snapshot[name].clone())
        flags = {key: torch.zeros(self.num_envs, 1, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        return TensorDict({**self._entries(), **flags}, batch_size=self.batch_size)


class CorridorPlanner:
    """In place of receding horizon planning: a uniformly random action; remembers how many tasks it was asked."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def plan_batch(
        self, models: Sequence[object], states: Sequence[object], rngs: Sequence[np.random.Generator]
    ) -> list[Decision]:
        self.asked.append(len(models))
        return [Decision(int(rng.integers(8))) for rng in rngs]


class TinyQNetwork(nn.Module):
    """Observation [B, 5] to action values [B, 8]."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.layers = nn.Sequential(nn.Linear(FEATURES, 32), nn.Tanh(), nn.Linear(32, 8))

    def forward(self, observation: torch.Tensor, gripper_closed: torch.Tensor) -> torch.Tensor:
        return 10.0 * self.layers(observation)


class TinyActorCritic(nn.Module):
    """Observation [B, 5] to means [B, 4], stds [B, 4] and values [B], with a shared body as in Sec. 7.2."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.body = nn.Sequential(nn.Linear(FEATURES, 32), nn.Tanh())
            self.mean, self.std, self.value = nn.Linear(32, 4), nn.Linear(32, 4), nn.Linear(32, 1)

    def forward(
        self, observation: torch.Tensor, gripper_closed: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        hidden = self.body(observation)
        value = 10.0 * self.value(hidden)[:, 0]
        return torch.tanh(self.mean(hidden)), torch.sigmoid(self.std(hidden)) + 0.05, value


def success_rate(action_space: ActionSpaceName, act: Callable[[torch.Tensor], torch.Tensor]) -> dict[str, float]:
    """Share of the episodes from the three starts that ``act`` (observations to actions) brings to the goal."""
    env = Corridor(action_space, num_envs=3)
    step, solved = env.reset(), torch.zeros(3, dtype=torch.bool)
    with torch.no_grad():
        for _ in range(LIMIT - 1):
            step, following = env.step_and_maybe_reset(step.set("action", act(step["observation"])))
            solved |= step["next", "is_goal"]
            step = following
    return {"success_rate": solved.float().mean().item()}
