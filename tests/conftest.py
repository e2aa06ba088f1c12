"""Fixtures that every test may use."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# No example may fail because the machine is slow, and CI must not fail today on an example that it
# did not draw yesterday.
settings.register_profile(
    "edge",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=bool(os.environ.get("CI")),
)
settings.load_profile("edge")

HERE = Path(__file__).resolve().parent
SHARED = HERE.parents[1] / "shared"

# Longer than a test of live processes waits for any one thing, so that it can say what did not
# happen.
LIVE = ("integration", "attacks")
LIVE_LIMIT_S = 900


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    folders = {HERE / name for name in LIVE}
    for item in items:
        if folders & set(item.path.parents) and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LIVE_LIMIT_S))


@pytest.fixture(autouse=True)
def _logging_as_before() -> Iterator[None]:
    """Commands that run in this process set up logging; the next test must not inherit it."""
    root, edge = logging.getLogger(), logging.getLogger("edge")
    before = (root.level, list(root.handlers), edge.level)
    yield
    root.handlers[:] = before[1]
    root.setLevel(before[0])
    edge.setLevel(before[2])


@pytest.fixture(autouse=True)
def _no_overrides(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the developer has set to override configurations is none of the tests' business."""
    for name in [name for name in os.environ if name.startswith("EDGE__")]:
        monkeypatch.delenv(name)


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """The folder of papers, worlds, logs and weights beside the clone; skips where it is not."""
    if not SHARED.is_dir():
        pytest.skip(f"test data not there: {SHARED.name}/ beside the clone")
    return SHARED
