"""A live ROS 2, for tests that need one."""

from __future__ import annotations

import pytest
from live_ros import ROS_PYTHON, make_environ


@pytest.fixture(scope="session")
def ros_environ(tmp_path_factory) -> dict[str, str]:
    """See `make_environ`."""
    return make_environ(tmp_path_factory.mktemp("ros") / "packages")


@pytest.fixture(scope="session")
def ros_python() -> str:
    return str(ROS_PYTHON)
