"""Fixtures that every test may use."""

from __future__ import annotations

import os
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

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """The folder of papers, worlds, logs and weights beside the clone; skips where it is not."""
    if not SHARED.is_dir():
        pytest.skip(f"test data not there: {SHARED.name}/ beside the clone")
    return SHARED
