"""A house that most evaluations are tried in."""

from __future__ import annotations

import pytest
from small_house import small_house

from edge.config import Config


@pytest.fixture(scope="module")
def config(tmp_path_factory) -> Config:
    """With a camera of 5 Hz, which sees enough."""
    folder = tmp_path_factory.mktemp("house")
    return small_house(folder, mission={"time_limit_s": 60.0}, sim={"step_s": 0.2})
