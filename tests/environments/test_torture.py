"""Some thousand random calls of both environments; ``python -m tests.torture environments`` makes more."""

from __future__ import annotations

from tests.torture.environments import run


def test_random_calls_hold_no_surprise() -> None:
    result = run(4000, seed=0)
    assert result["calls"] == 4000 and result["surprises"] == 0, "\n\n".join(result["examples"])
    assert len(result["by_call"]) == 21 and min(result["by_call"].values()) > 0


def test_a_surprise_is_counted(monkeypatch) -> None:
    """An environment that takes any number for an action is found out."""
    monkeypatch.setattr("visualrhp.environments.clutter_manipulation.discrete_action", lambda action: 7)
    result = run(1000, seed=0)
    assert result["surprises"] > 0 and "Surprise" in "".join(result["examples"])
