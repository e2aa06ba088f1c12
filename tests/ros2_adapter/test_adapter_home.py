"""The simulated robot as one of ROS 2's, driven home through DDS, the adapter and Zenoh."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from edge_processes import edge, endpoint, write_config  # noqa: F401, fixtures
from processes import running

from edge.config import load
from edge.host.ports import free_port

ROBOT = Path(__file__).with_name("ros_robot.py")
SENSORS = {name: f"/{name}" for name in ("camera/rgb", "camera/depth", "camera/info", "odom")}
SLOW = {"camera": {"rate_hz": 5}}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_robot_of_ros_is_driven_to_its_target(ros_python, ros_environ, edge, endpoint, tmp_path):  # noqa: F811
    """With a detector that looks at pictures: no topic of ROS carries the simulator's truth."""
    here = {"zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"}}
    there = {
        "zenoh": {"endpoint": endpoint}, "sensors": SLOW,
        "ros2_adapter": {"python": ros_python, "sensors": SENSORS, "results": {"map": "/edge/map"}},
    }  # fmt: skip
    perception = load("demo").perception.model_dump(mode="json")
    for side in ("robot", "service"):
        (tmp_path / side).mkdir()
    robot_side = write_config(tmp_path / "robot", **here, sensors=SLOW)
    service_side = write_config(tmp_path / "service", **there, perception=perception)
    with ExitStack() as stack:
        command = [ros_python, "-u", str(ROBOT), here["zenoh"]["endpoint"], "edge"]
        robot = stack.enter_context(running(command, ros_environ))
        robot.says("ready")
        service = edge("run", service_side, "--once").says("ready:")
        edge("sim", robot_side)
        root = Path(__file__).parents[2]
        path = {"PYTHONPATH": f"{root}:{ros_environ['PYTHONPATH']}"}
        command = [sys.executable, "-m", "edge.cli", "ros2-adapter", str(service_side)]
        stack.enter_context(running(command, {**ros_environ, **path}))
        assert service.wait() == 0, service.output
    assert "reached: television" in service.output
    assert robot.count("goal") > 0
