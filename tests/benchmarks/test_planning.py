"""A decision and the parts that it is compared with do the same work."""

from __future__ import annotations

import pytest
import torch

from tests.benchmarks.planning import _Decision, _RecordingModel
from tests.benchmarks.walks import random_walks
from visualrhp.heuristics.conversion import heuristic_of
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import make_observation
from visualrhp.simulation import make_action_space
from visualrhp.types import ActionSpaceName


@pytest.mark.parametrize(("space", "shared"), [("continuous", True), ("discrete", True), ("discrete", False)])
def test_the_parts_leave_nothing_out(space: ActionSpaceName, shared: bool) -> None:
    torch.manual_seed(0)
    heuristic = heuristic_of(make_network(space, make_observation("image")))
    walk = random_walks(2, 3, space)[0]
    decision = _Decision(heuristic, walk, walk.states[-2], space, 3, shared)
    model = decision.model = _RecordingModel(walk.scene, make_action_space(space))
    model.calls = []
    decision.decide()
    simulated, model.calls = model.calls, []
    decision.parts()
    assert model.calls == decision.actions
    if shared:
        assert {state for state, _ in model.calls} == {state for state, _ in simulated}
        assert len(model.calls) == len(simulated)
    else:
        assert len(model.calls) == 9 >= len(simulated)
