"""The order of the tests."""

from __future__ import annotations

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests of the whole pipeline: one worker needs minutes for them, while the other does the rest."""
    items.sort(key=lambda item: item.path.name != "test_repro.py")
