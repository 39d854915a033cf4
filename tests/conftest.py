"""The order of the tests."""

from __future__ import annotations

import pytest

LONGEST = ("test_repro.py", "test_kills.py")
"""Files that take minutes."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files, each on a worker of its own: none of them is still running alone at the end."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
