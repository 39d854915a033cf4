"""What a batched environment tells torchrl about its entries, and the devices that these can be on."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded

from visualrhp.environments.arguments import shown
from visualrhp.environments.slots import TaskFamily
from visualrhp.errors import ConfigError
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace


def observation_spec(family: TaskFamily, batch: torch.Size) -> Composite:
    """The entries of ``reset`` and ``step`` for the batch size [N], without rewards and the flags ``done``."""
    observe = family.observe
    shape = torch.Size([*batch, *observe.shape])
    return Composite(
        observation=Categorical(int(observe.high) + 1, shape=shape, dtype=torch.uint8)
        if observe.dtype is np.uint8
        else Unbounded(shape=shape, dtype=torch.float32),
        gripper_closed=Categorical(2, shape=batch, dtype=torch.bool),
        state=Unbounded(shape=torch.Size([*batch, family.state_dimension]), dtype=torch.float64),
        instance=Unbounded(shape=batch, dtype=torch.int64),
        is_goal=Categorical(2, shape=batch, dtype=torch.bool),
        is_dropped=Categorical(2, shape=batch, dtype=torch.bool),
        shape=batch,
    )


def action_spec(family: TaskFamily, batch: torch.Size) -> TensorSpec:
    """The actions: [N] int64, or [N, 4] float32."""
    if family.action_space == "discrete":
        return Categorical(DiscreteActionSpace.NUM_ACTIONS, shape=batch, dtype=torch.int64)
    return Bounded(-1.0, 1.0, shape=torch.Size([*batch, ContinuousActionSpace.DIMENSION]), dtype=torch.float32)


def reward_spec(batch: torch.Size) -> TensorSpec:
    """The rewards: [N, 1] float32."""
    return Unbounded(shape=torch.Size([*batch, 1]), dtype=torch.float32)


def done_spec(batch: torch.Size) -> Composite:
    """The three flags that say whether an episode is over: [N, 1] bool."""
    flag = Binary(1, shape=torch.Size([*batch, 1]), dtype=torch.bool)
    return Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=batch)


def usable_device(device: Any) -> torch.device:
    """The device called ``device``.

    Raises:
        ConfigError: there is no such device, or torch cannot use it.
    """
    try:
        usable = torch.device(device)
        torch.empty(0, device=usable)
    except Exception as error:  # torch raises errors of many types
        reason = str(error).partition("\n")[0][:300]
        raise ConfigError(f"device={shown(device)} cannot be used: {reason}; choose cpu, or another one") from error
    return usable
