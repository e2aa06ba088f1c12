"""Simulated ROS 2 robots of the built-in configurations that drive to their target.

Their topics go through DDS, the adapter and Zenoh.
"""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from edge_processes import edge, endpoint, write_config  # noqa: F401, fixtures
from processes import running
from ros_robots import LOCALIZED, ODOM_IN_MAP, ROBOTS, builtin_config, builtin_data, transforms_of

from edge.config import load
from edge.host.ports import free_port

HERE = Path(__file__).parent
SMALL = {"width_px": 320, "height_px": 256, "hfov_deg": 75, "rate_hz": 5}


def plan_of(name: str, endpoint: str) -> str:  # noqa: F811
    """Return the input of `ros_robot.py`."""
    body, settings = ROBOTS[name], builtin_config(name).ros2
    frames = dict.fromkeys(("camera/rgb", "camera/depth", "camera/info"), body.camera)
    frames |= {"odom": "odom"} | ({"lidar/scan": body.lidar} if body.lidar else {})
    return json.dumps({
        "endpoint": endpoint, "frames": frames, "topics": {n: settings.topic(n) for n in frames},
        "tf": LOCALIZED.hex(), "tf_static": transforms_of(body.tree).hex(),
        "odom_in_map": [ODOM_IN_MAP.x_m, ODOM_IN_MAP.y_m],
    })  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["turtlebot4"])
def test_a_robot_of_ros_is_driven_to_its_target(
    ros_python, ros_environ, edge, endpoint, tmp_path, name  # noqa: F811
):  # fmt: skip
    """With a detector that looks at pictures: no topic of ROS carries the simulator's truth."""
    data = builtin_data(
        name, ros2={"adapter": {"python": ros_python}}, zenoh={"endpoint": endpoint}
    )
    data["sensors"]["camera"] |= SMALL
    perception = load("demo").perception.model_dump(mode="json")
    data |= {"perception": perception, "mission": {"target": "television"}}
    here = {**data, "source": {"kind": "zenoh"}, "sinks": ["zenoh"]}
    here["zenoh"] = {"endpoint": f"tcp/127.0.0.1:{free_port()}"}
    for side in ("robot", "service"):
        (tmp_path / side).mkdir()
    robot_side = write_config(tmp_path / "robot", **here)
    service_side = write_config(tmp_path / "service", **data)
    with ExitStack() as stack:
        plan = plan_of(name, here["zenoh"]["endpoint"])
        command = [ros_python, "-u", str(HERE / "ros_robot.py"), plan]
        robot = stack.enter_context(running(command, ros_environ))
        robot.says("ready")
        service = edge("run", service_side, "--once").says("ready:")
        edge("sim", robot_side)
        path = {"PYTHONPATH": f"{HERE.parents[1]}:{ros_environ['PYTHONPATH']}"}
        command = [sys.executable, "-m", "edge.cli", "ros2-adapter", str(service_side)]
        stack.enter_context(running(command, {**ros_environ, **path}))
        assert service.wait() == 0, service.output
    assert "reached: television" in service.output
    assert robot.count("goal") > 0
