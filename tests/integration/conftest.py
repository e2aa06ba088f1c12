"""An address of a test's own, `edge` commands that end with the test, and time for them."""

from __future__ import annotations

from pathlib import Path

import pytest
from edge_processes import edge, endpoint  # noqa: F401, fixtures

HERE = Path(__file__).parent
LIMIT_S = 900  # longer than a test waits for any one thing, so that it can say what did not happen


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LIMIT_S))
