"""A Python with rclpy and Fast DDS from the package index, where there is one; see `.ci/run`."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
ROS_PYTHON = Path(os.environ.get("EDGE_ROS_PYTHON", HERE.parents[1] / ".venv/ros/bin/python"))


def make_environ(folder: Path) -> dict[str, str]:
    """Return the environment of ROS processes, with the packages made in `folder`.

    Skips without ROS. Its own domain is visible on this machine only.
    """
    if not ROS_PYTHON.exists():
        pytest.skip(f"no ROS 2: {ROS_PYTHON} is not there (or set EDGE_ROS_PYTHON)")
    if shutil.which("g++") is None:
        pytest.skip("no g++ here to make ROS packages with")
    script = HERE / "make_ros_packages.py"
    made = subprocess.run([ROS_PYTHON, script, folder], capture_output=True, text=True, check=False)
    if made.returncode == os.EX_UNAVAILABLE:
        pytest.skip(made.stderr)
    assert made.returncode == 0, made.stderr
    return {
        "PYTHONPATH": str(folder), "LD_LIBRARY_PATH": str(folder),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(os.getpid() % 100 + 1),
    }  # fmt: skip
