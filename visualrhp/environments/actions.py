"""Checks of the actions that callers give to the environments, before anything moves.

NumPy converts much that is no action: strings of digits, booleans, dates, and complex numbers (to their real parts). It
also cuts 1.99 off to 1 and spreads one number over four. Here, a number stays what it is, or is refused.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.environments.arguments import shown
from visualrhp.errors import ActionError
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace
from visualrhp.types import FloatArray, IntArray

_NUM_ACTIONS = DiscreteActionSpace.NUM_ACTIONS
_DIMENSION = ContinuousActionSpace.DIMENSION
_INTEGERS = "iu"
_NUMBERS = "fiu"


def discrete_action(action: Any) -> int:
    """The index of a discrete action.

    Args:
        action: an integer of Python, NumPy or torch, or an array or sequence of one integer.

    Raises:
        ActionError: it is something else (a boolean or 3.0, for instance), or out of range.
    """
    if type(action) is int:
        index = action
    else:
        array = _as_array(action, 1)
        is_index = array is not None and array.dtype.kind in _INTEGERS and array.shape in ((), (1,))
        index = int(array.item()) if array is not None and is_index else -1
    if not 0 <= index < _NUM_ACTIONS:
        raise ActionError(f"a discrete action is an integer from 0 to {_NUM_ACTIONS - 1}, not {shown(action)}")
    return index


def continuous_action(action: Any) -> FloatArray:
    """A copy of a continuous action, [4] float64.

    Args:
        action: an array, tensor or sequence of four numbers; they may be outside [-1, 1].

    Raises:
        ActionError: it is something else (a string or booleans, for instance), or not finite.
    """
    array = action if type(action) is np.ndarray else _as_array(action, _DIMENSION)
    if array is None or array.dtype.kind not in _NUMBERS or array.shape != (_DIMENSION,):
        raise _no_continuous_action(action)
    with np.errstate(over="ignore") if array.dtype.itemsize > 8 else nullcontext():  # too long: infinite, thus refused
        result = array.astype(np.float64)
    if not math.isfinite(sum(result.tolist())):
        if not np.isfinite(result).all():
            raise _no_continuous_action(action)
        result.clip(-1.0, 1.0, out=result)  # as for execution; their sum overflows
    return result


def _no_continuous_action(action: Any) -> ActionError:
    return ActionError(f"a continuous action is an array of {_DIMENSION} finite numbers, not {shown(action)}")


def _as_array(action: Any, length: int) -> npt.NDArray[Any] | None:
    """``action`` as an array of NumPy, its type kept; None if it cannot be one action of ``length`` numbers."""
    try:
        if hasattr(action, "detach") and hasattr(
            action, "cpu"
        ):  # a tensor of torch, perhaps with gradients or on another device
            return _tensor_as_array(action)
        if isinstance(action, np.ndarray):
            return None if np.ma.is_masked(action) else np.asarray(action)
        if hasattr(action, "__len__") and len(action) != length:
            return None
        if isinstance(action, (list, tuple)):  # NumPy would make [True, 0.5] numbers
            parts = [_as_array(part, 1) for part in action if not isinstance(part, (list, tuple))]
            numbers = [part for part in parts if part is not None and part.dtype.kind in _NUMBERS and not part.shape]
            return np.array([number.item() for number in numbers]) if len(numbers) == length else None
        return np.asarray(action)
    except Exception:  # raised by the code of a foreign object, or by NumPy
        return None


def _tensor_as_array(tensor: Any) -> npt.NDArray[Any]:
    """A tensor without its gradients, in the memory of this process; float64 for floats, as NumPy has no bfloat16."""
    tensor = tensor.detach().cpu()
    return (tensor.double() if tensor.is_floating_point() else tensor).numpy()


def batch_of_actions(actions: Any, is_discrete: bool, num_slots: int) -> IntArray | FloatArray:
    """The actions of N slots, if all are valid: a batch is executed as a whole or not at all.

    Args:
        actions: a tensor of torch, [N] integers or [N, 4] numbers; None if there is none.
        is_discrete: which of the two.
        num_slots: N.

    Returns:
        [N] integers, or [N, 4] float64 clipped to [-1, 1].

    Raises:
        ActionError: the tensor has another shape or type, or holds an action that is not in the action space; the
            message names the slot.
    """
    shape = (num_slots,) if is_discrete else (num_slots, _DIMENSION)
    needed = f"{list(shape)} {'integers' if is_discrete else 'numbers'}"
    if actions is None:
        raise ActionError(f"the tensordict has no entry 'action'; it should be a tensor of {needed}")
    try:
        array = np.asarray(_tensor_as_array(actions))
    except Exception as error:  # no tensor, or one without data (of the device meta)
        raise ActionError(f"'action' should be a tensor of {needed}, not {shown(actions)}") from error
    if array.shape != shape or array.dtype.kind not in (_INTEGERS if is_discrete else _NUMBERS):
        raise ActionError(f"'action' should be a tensor of {needed}, not of {list(array.shape)} {shown(actions.dtype)}")
    if is_discrete:
        is_valid = (array >= 0) & (array < _NUM_ACTIONS)
        if not is_valid.all():
            slot = int(np.argmin(is_valid))
            raise ActionError(
                f"a discrete action is an integer from 0 to {_NUM_ACTIONS - 1}, not {array[slot]} (slot {slot})"
            )
        return array
    is_valid = np.isfinite(array)
    if not is_valid.all():
        slot = int(np.argmin(is_valid.all(-1)))
        raise ActionError(
            f"a continuous action is an array of {_DIMENSION} finite numbers, not {array[slot].tolist()} (slot {slot})"
        )
    return np.clip(array, -1.0, 1.0)
