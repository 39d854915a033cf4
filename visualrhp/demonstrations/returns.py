"""Monte Carlo returns of demonstrations (Eq. 4)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from visualrhp.simulation.rules import DISCOUNT
from visualrhp.types import FloatArray


def monte_carlo_returns(rewards: npt.ArrayLike, discount: float = DISCOUNT) -> FloatArray:
    r"""Return :math:`\sum_{k=0}^{L-l-1} \gamma^k r_{l+k+1}` for every step l of a demonstration (Eq. 4), [L]."""
    returns = np.array(rewards, dtype=np.float64)
    for step in range(len(returns) - 2, -1, -1):
        returns[step] += discount * returns[step + 1]
    return returns
