"""Roll-outs of batched environments with random actions."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.scene.sampling import SceneDistribution

FEW = SceneDistribution(num_objects=(1, 3))


def random_policy(seed: int, env: BatchedClutterEnv):
    generator = torch.Generator().manual_seed(seed)

    def act(td):
        if env.action_space.name == "discrete":
            return td.set("action", torch.randint(8, (env.num_envs,), generator=generator))
        return td.set("action", torch.empty(env.num_envs, 4).uniform_(-1.5, 1.5, generator=generator))

    return act


def run(env: BatchedClutterEnv, act, num_steps: int, current: TensorDict | None = None):
    current = env.reset() if current is None else current
    steps = []
    for _ in range(num_steps):
        step, current = env.step_and_maybe_reset(act(current))
        steps.append(step)
    return torch.stack(steps, 1), current
