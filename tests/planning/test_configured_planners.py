"""From ``conf/planner`` to the planners that need no network."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest

from pipelines.config import EvaluateConfig, GenerateDemosConfig
from pipelines.planners import build_planner, needed_network
from pipelines.workflow.app import compose
from visualrhp.planning import DHRRT, ClosedLoopKRRT, KinodynamicRRT, Planner

DEFAULT, DECISION = KinodynamicRRT(), KinodynamicRRT(max_simulations=20000)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["planner=kinodynamic_rrt"], replace(DEFAULT, time_limit_s=180.0)),
        (["planner=kinodynamic_rrt", "planner.shorten=true"], replace(DEFAULT, time_limit_s=180.0, shorten=True)),
        (["planner=closed_loop_krrt"], ClosedLoopKRRT(DECISION)),
        (["planner=closed_loop_krrt", "planner.keep_plan=false"], ClosedLoopKRRT(DECISION, keep_plan=False)),
        (["planner=dhrrt"], DHRRT(DECISION)),
        (["planner=dhrrt", "planner.rrt.time_limit_s=180.0"], DHRRT(replace(DECISION, time_limit_s=180.0))),
        (["planner=dhrrt", "planner.progress=0.05"], DHRRT(DECISION, progress=0.05)),
    ],
)
def test_a_planner_is_what_its_configuration_says(overrides: list[str], expected: Planner) -> None:
    config = compose("evaluate", EvaluateConfig, overrides).planner
    planner = build_planner(config, "continuous", 4)
    assert isinstance(planner, type(expected))
    given, wanted = asdict(planner), asdict(expected)  # pyright: ignore[reportArgumentType]
    for parameters in (given, given.get("rrt", {})):  # the tag of the configuration
        parameters.pop("algorithm", None)
    assert given == wanted
    assert planner.name == config.name
    assert needed_network(config, "continuous", "no folder", 4) is None


def test_demonstrations_are_not_shortened_unless_asked_for() -> None:
    assert compose("generate_demos", GenerateDemosConfig, []).planner.shorten is False
    assert compose("generate_demos", GenerateDemosConfig, ["planner.shorten=true"]).planner.shorten is True
