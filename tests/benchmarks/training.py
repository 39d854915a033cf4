"""Imitation, the update of C3PO, and collecting with updating, against plain PyTorch and Stable-Baselines3."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from tests.benchmarks.plain_training import PlainC3PO, PlainImitation, plain
from tests.benchmarks.timing import Effort, compare, show, show_title, timed
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.heuristics.networks import ActorCritic
from visualrhp.learning.c3po import C3PO
from visualrhp.learning.configs import ActorCriticImitationConfig, C3POConfig
from visualrhp.learning.imitation import ImitationLearner
from visualrhp.learning.imitation_data import ImitationData
from visualrhp.observation import make_observation
from visualrhp.scene import SceneDistribution

_SIDE = 512
_ENVS = 10
_EPOCHS = 10
"""Of the policy per iteration, the default of Stable-Baselines3."""


def run(effort: Effort) -> None:
    torch.manual_seed(0)
    full = effort.repetitions > 1
    network = ActorCritic(make_observation("image", None))
    env = make_env(num_workers=0)
    transitions = collect(env, network, 4000 if full else 40)
    env.close()
    network_pass(effort, network, 500 if full else 10)
    show_title("Samples a second, one thread, against plain PyTorch (tests/benchmarks/plain_training.py)")
    for batch_size in (256, 2000) if full else (20,):
        imitation(effort, network, transitions, batch_size)
    for batch_size in (500, 2000) if full else (20,):
        c3po_update(effort, network, transitions, batch_size)
    against_stable_baselines3(effort, 10_000 if full else 40, _ENVS if full else 2)


def make_env(num_workers: int | None, num_envs: int = _ENVS) -> BatchedClutterEnv:
    distribution = SceneDistribution(num_objects=(1, 7))
    return BatchedClutterEnv(distribution, "continuous", "image", num_envs, seed=0, num_workers=num_workers)


def network_pass(effort: Effort, network: ActorCritic, size: int) -> None:
    """A pass of the network against a matrix product of as many operations."""
    show_title("Image network, one thread")
    images = torch.randint(0, 6, (size, 64, 64), dtype=torch.uint8)
    closed = torch.zeros(size)

    def step() -> None:
        mean, std, value = network(images, closed)
        (mean.sum() + std.sum() + value.sum()).backward()

    counter = FlopCounterMode(display=False)
    with counter:
        step()
    products = max(1, round(counter.get_total_flops() / (2 * _SIDE**3)))
    matrix = torch.randn(_SIDE, _SIDE)
    compare(
        f"forward and backward pass of {size} samples",
        timed(step),
        timed(lambda: [matrix @ matrix for _ in range(products)]),
        f"{counter.get_total_flops() / size / 1e6:.1f} MFLOP a sample as matrix products",
        max(1, effort.repetitions // 3),
    )


def collect(env: BatchedClutterEnv, network: ActorCritic, count: int) -> Any:
    """Transitions [N, T] of the policy of ``network``."""
    learner = C3PO(network, env, C3POConfig(frames_per_batch=count, batch_size=count), seed=0)
    return learner.collector.collect(learner.act, count)[0]


def imitation(effort: Effort, network: ActorCritic, transitions: Any, batch_size: int) -> None:
    """Epochs over the same pairs, mirrored with probability 1/2."""
    flat = transitions.flatten(0, 1)
    images, closed, actions = flat["observation"], flat["gripper_closed"].view(-1), flat["action"]
    returns = torch.linspace(-30.0, -1.0, len(images))
    observe = make_observation("image", None)
    data = ImitationData(
        observe,
        observe.store(iter(images.numpy())),
        closed.bool(),
        actions,
        returns,
        torch.ones(len(images), dtype=torch.int32),
        torch.arange(len(images), dtype=torch.int32),
    )
    config = ActorCriticImitationConfig(
        batch_size=batch_size, epochs=10_000, validation_fraction=0.0, lr_schedule="constant"
    )
    epochs = ImitationLearner(plain_weights(network), data, config, seed=0).run()
    reference = PlainImitation(plain(network), (images, closed.float(), actions, returns), config)
    _samples(effort, f"imitation, batches of {batch_size}", len(images), lambda: next(epochs), reference.epoch)


def c3po_update(effort: Effort, network: ActorCritic, transitions: Any, batch_size: int) -> None:
    """Two epochs of each of the two losses on the same transitions."""
    config = C3POConfig(transitions.numel(), batch_size, baseline_epochs=2, policy_epochs=2)
    env = make_env(num_workers=0)
    learner = C3PO(plain_weights(network), env, config, seed=0)

    def update() -> None:
        learner.optimize_baseline(learner.with_old_parameters(transitions))
        learner.optimize_policy(learner.with_old_parameters(transitions))

    flat = transitions.flatten(0, 1)
    following = flat["next"]
    parts = (
        flat["observation"],
        flat["gripper_closed"].view(-1).float(),
        flat["action"],
        following["reward"].view(-1),
        following["terminated"].view(-1),
        following["observation"],
        following["gripper_closed"].view(-1).float(),
    )
    reference = PlainC3PO(plain(network), config)
    count = 4 * transitions.numel()
    _samples(effort, f"update of C3PO, batches of {batch_size}", count, update, lambda: reference.update(parts))
    env.close()


def _samples(effort: Effort, what: str, count: int, ours: Callable[[], object], theirs: Callable[[], object]) -> None:
    repetitions = max(1, effort.repetitions // 3)
    own, reference = timed(ours), timed(theirs)
    times = np.array([[own(), reference()] for _ in range(repetitions)])
    show(what, times[:, 0], times[:, 1], "plain PyTorch")
    print(f"  samples a second: {count / times[:, 0].min():.0f}, plain PyTorch {count / times[:, 1].min():.0f}")


def plain_weights(network: ActorCritic) -> ActorCritic:
    """A copy of the network, as it is."""
    found = ActorCritic(network.observation)
    found.load_state_dict(network.state_dict())
    return found


# --------------------------------------------------------------------------------------------- Stable-Baselines3
def against_stable_baselines3(effort: Effort, count: int, num_envs: int) -> None:
    """PPO: ``count`` transitions are collected, then used in ten epochs; the same environment and plain network."""
    try:
        import stable_baselines3
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv
    except ImportError:
        print("\nStable-Baselines3 is not installed: the comparison with it is skipped.")
        return
    show_title(
        f"PPO: collect and update {count} transitions, {num_envs} tasks, {_EPOCHS} epochs, batches of 500, wall time"
    )
    batch_size = min(500, count)
    config = C3POConfig(count, batch_size, baseline_step=False, policy_epochs=_EPOCHS, clip_epsilon=0.2, lr=3e-4)
    env = make_env(None, num_envs)
    learner = C3PO(ActorCritic(make_observation("image", None)), env, config, seed=0)
    iterations = learner.run(10_000)
    peers: dict[str, Any] = {}
    for name, kind in (
        ("Stable-Baselines3, one process", DummyVecEnv),
        ("Stable-Baselines3, a process a task", SubprocVecEnv),
    ):
        vector = make_vec_env(_make_gymnasium, n_envs=num_envs, seed=0, vec_env_cls=kind)
        peers[name] = stable_baselines3.PPO(
            "MultiInputPolicy",
            vector,
            n_steps=count // num_envs,
            batch_size=batch_size,
            n_epochs=_EPOCHS,
            policy_kwargs={"features_extractor_class": _features_extractor(), "net_arch": []},
            device="cpu",
            seed=0,
        )
    next(iterations)  # starts the workers
    rows = []
    for _ in range(max(1, effort.repetitions // 15)):  # the peers take a minute each
        row = [_wall_time(lambda: next(iterations))]
        row += [_wall_time(lambda peer=peer: peer.learn(count, reset_num_timesteps=False)) for peer in peers.values()]
        rows.append(row)
    times = np.array(rows)
    for number, name in enumerate(peers, start=1):
        show(f"{count} transitions", times[:, 0], times[:, number], name)
        peers[name].get_env().close()
    env.close()


def _wall_time(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def _make_gymnasium() -> gymnasium.Env[Any, Any]:
    torch.set_num_threads(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gymnasium.make(
            "visualrhp/ClutterManipulation-v0", action_space="continuous", observation="image", num_objects=(1, 7)
        )


def _features_extractor() -> type[nn.Module]:
    """The shared layers of the plain network."""
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

    class Features(BaseFeaturesExtractor):
        def __init__(self, space: Any) -> None:
            super().__init__(space, 128)
            network = plain(ActorCritic(make_observation("image", None)))
            self.encoder, self.body = network.encoder, network.body

        def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
            encoded = self.encoder(observations["observation"].to(torch.uint8))
            closed = observations["gripper_closed"].reshape(len(encoded), -1)[:, -1:]  # of a one-hot code
            return self.body(torch.cat([encoded, closed.float()], dim=-1))

    return Features
