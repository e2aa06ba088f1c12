"""Input, imports and start of the adapter node, without ROS."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import threading
from pathlib import Path

import pytest
from live_patience import eventually
from simulated import simulated

from edge.cli.main import main
from edge.config import Config, ConfigError, load
from edge.config.yaml_text import parse_yaml
from edge.errors import UnavailableError
from edge.ros2_adapter import process
from edge.ros2_adapter.node import passing

LIGHT = {"rclpy", "zenoh", "launch", "action", "passing"}


def adapted(adapter: dict | None = None, **ros2: object) -> Config:
    """Return a robot's configuration with this Python in place of ROS's."""
    adapter = {"python": sys.executable, **(adapter or {})}
    section = {"via": "adapter", "adapter": adapter, **ros2}
    return simulated({"source": {"kind": "ros2"}, "sinks": ["ros2"], "ros2": section})


@pytest.mark.parametrize(
    "file", [*process.NODE.glob("*.py"), process.LAUNCH_FILE], ids=lambda path: path.name
)
def test_the_ros_node_imports_only_light_packages(file):
    imported = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(str(node.module).split(".")[0])
    assert imported - set(sys.stdlib_module_names) <= LIGHT


def passed(plan: dict, ros: str) -> dict:
    (one,) = (one for one in (*plan["heard"], *plan["said"]) if one["ros"] == ros)
    return one


COMPRESSED = "/oakd/rgb/image_raw/compressed"
QUALITIES = [
    ("/odom", "nav_msgs/msg/Odometry", {"reliable": False, "latched": False, "depth": 100}),
    (COMPRESSED, "sensor_msgs/msg/CompressedImage", {"reliable": True, "depth": 5}),
    ("/scan", "sensor_msgs/msg/LaserScan", {"reliable": True}),
    ("/tf", "tf2_msgs/msg/TFMessage", {"reliable": False, "latched": False, "depth": 100}),
    ("/tf_static", "tf2_msgs/msg/TFMessage", {"reliable": True, "latched": True, "depth": 100}),
    ("/edge/occupancy", "nav_msgs/msg/OccupancyGrid", {"latched": True, "depth": 1}),
    ("/edge/path", "nav_msgs/msg/Path", {"reliable": True, "latched": False}),
]


@pytest.mark.parametrize(("ros", "kind", "quality"), QUALITIES, ids=[row[0] for row in QUALITIES])
def test_each_topic_has_its_key_type_and_qos(ros, kind, quality):
    config = adapted({"reliable": ["camera/rgb", "lidar/scan"]}, topics={"camera/rgb": COMPRESSED})
    one = passed(process.make_plan(config), ros)
    assert one.items() >= {"key": f"edge/ros2{ros}", "type": kind, **quality}.items()


def test_a_stop_is_heard_latched_best_effort_and_reliably():
    heard = [one for one in process.make_plan(adapted())["heard"] if one["ros"] == "/edge/stop"]
    assert {(one["reliable"], one["latched"]) for one in heard} == {
        (False, False), (True, False), (True, True),
    }  # fmt: skip
    assert {(one["key"], one["type"]) for one in heard} == {
        ("edge/ros2/edge/stop", "std_msgs/msg/Bool")
    }


class MadeOf:
    """An object with these attributes."""

    def __init__(self, **attributes: object) -> None:
        self.__dict__ |= attributes


def test_only_a_silent_sensor_is_reported(monkeypatch, caplog):
    publisher = MadeOf(matching_status=MadeOf(matching=True))
    ends = passing.AdapterEnds(
        node=MadeOf(create_subscription=lambda *_, **__: object(),
                    get_publishers_info_by_topic=lambda _: []),
        session=MadeOf(declare_publisher=lambda *_, **__: publisher),
        zenoh=MadeOf(CongestionControl=MadeOf(DROP="drop")), wake=lambda: None,
    )  # fmt: skip
    for name in ("make_qos", "make_callbacks"):  # they need rclpy
        monkeypatch.setattr(passing, name, lambda _: None)
    heard = process.make_plan(adapted(requests=True))["heard"]
    names = "/odom", "/edge/stop", "/edge/request"
    topics = [passing.FromRos(ends, one, None) for one in heard if one["ros"] in names]
    assert len(topics) == 5
    for now_s in (0.0, 10.0, 20.0):
        monkeypatch.setattr(passing, "time", MadeOf(monotonic=lambda now_s=now_s: now_s))
        for topic in topics:
            topic.update()
    assert all(topic.wanted for topic in topics)
    assert caplog.messages == ["/odom: no message yet: it has no publisher"]


def test_the_plan_is_json_with_the_zenoh_configuration():
    plan = process.make_plan(adapted())
    assert json.loads(json.dumps(plan)) == plan
    assert json.loads(plan["zenoh"])["mode"] == "client"
    assert (plan["node"], plan["max_bytes"]) == ("edge_adapter", 64_000_000)


def test_goals_go_to_the_action_or_to_a_topic():
    by_action = process.make_plan(adapted(topics={"navigate_to_pose": "/a/go"}))
    assert by_action["action"] == {
        "ros": "/a/go", "key": "edge/ros2/a/go", "type": "nav2_msgs/action/NavigateToPose",
    }  # fmt: skip
    assert "/goal_pose" not in {one["ros"] for one in by_action["said"]}
    assert "/edge/keepout_info" not in {one["ros"] for one in by_action["said"]}
    ros_names = {one["ros"] for one in (*by_action["heard"], *by_action["said"])}
    assert not ros_names & {"/edge/request", "/edge/answer"}
    with_requests = process.make_plan(adapted(requests=True))
    assert passed(with_requests, "/edge/request")["reliable"]
    assert passed(with_requests, "/edge/answer")["type"] == "std_msgs/msg/String"
    with_zones = process.make_plan(adapted(keepout_filter=True))
    info = passed(with_zones, "/edge/keepout_info")
    assert (info["type"], info["latched"]) == ("nav2_msgs/msg/CostmapFilterInfo", True)
    assert "/edge/objects" not in {one["ros"] for one in by_action["said"]}
    with_boxes = process.make_plan(adapted(detections_frame="camera"))
    assert passed(with_boxes, "/edge/objects")["type"] == "vision_msgs/msg/Detection3DArray"
    by_topic = process.make_plan(adapted(goals="topic"))
    assert by_topic["action"] is None
    assert passed(by_topic, "/goal_pose")["key"] == "edge/ros2/goal_pose"


@pytest.mark.parametrize("name", ["ros2-adapter", "turtlebot4", "jetson-realsense"])
def test_ready_configurations_have_a_plan(name):
    plan = process.make_plan(load(name, {}))
    assert plan["action"]["ros"] == "/navigate_to_pose"


def test_the_section_of_the_page_has_a_plan_too():
    page = Path(__file__).parents[2] / "docs" / "ros2.md"
    blocks = re.findall(r"```yaml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    (block,) = [block for block in blocks if block.startswith("ros2:") or "\nros2:" in block]
    plan = process.make_plan(simulated({"source": {"kind": "ros2"}, **parse_yaml(block)}))
    assert passed(plan, "/camera/color/image_raw")["reliable"]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"ros2": {"via": "adapter"}}, r"source\.kind: zenoh does not use ROS 2: set it to ros2"),
        (
            {"source": {"kind": "ros2"}},
            r"ros2\.via: rmw_zenoh needs no adapter: set ros2.via to adapter",
        ),
        ({"ros2": {"adapter": {"reliable": ["x"]}}}, r"ros2\.adapter\.reliable\.0: unknown 'x'"),
        ({"ros2": {"topics": {"odom": "a b"}}}, r"ros2\.topics\.odom: string should match"),
    ],
)
def test_its_faults_are_reported_in_one_line(data, said):
    with pytest.raises(ConfigError, match=f"^<defaults>: {said}[^\n]*$"):
        process.make_plan(simulated(data))


@pytest.mark.parametrize("key", ["python", "setup"])
def test_a_missing_file_is_reported(key):
    with pytest.raises(UnavailableError, match=f"^<defaults>: ros2.adapter.{key}: cannot read /no"):
        process.command_of(adapted({key: "/no/such"}))


def test_without_ros_the_adapter_fails_without_a_retry(monkeypatch, capfd):
    """This Python has no rclpy, or had better not use it here."""
    monkeypatch.setenv("PYTHONPATH", "")
    with pytest.raises(UnavailableError, match="node cannot run here"):
        process.supervise(adapted({"python": bare_python()}), threading.Event())
    assert "cannot import rclpy" in capfd.readouterr().err


def bare_python() -> str:
    return getattr(sys, "_base_executable", sys.executable)


@pytest.fixture
def node(tmp_path, monkeypatch) -> Path:
    """Return the path of a fake node, which the test writes."""
    monkeypatch.setattr(process, "NODE", tmp_path / "node.py")
    monkeypatch.setattr(process, "_PAUSE_S", 0.01)
    return tmp_path / "node.py"


def test_a_node_that_fails_is_started_again_until_a_stop(node, tmp_path, caplog):
    node.write_text(
        "import os, sys\n"
        "plan = sys.stdin.readline()\n"
        f"path = {str(tmp_path / 'runs')!r}\n"
        "open(path, 'a').write(plan)\n"
        "runs = len(open(path).readlines())\n"
        "if runs == 1: sys.exit(3)\n"
        "if runs == 2: os.kill(os.getpid(), 9)\n"
        "sys.stdin.read()\n"
    )
    config, stop, ended = adapted(), threading.Event(), []
    thread = threading.Thread(target=lambda: ended.append(process.supervise(config, stop)))
    thread.start()
    runs = tmp_path / "runs"
    eventually(lambda: runs.exists() and len(runs.read_text().splitlines()) == 3)
    stop.set()
    thread.join()
    assert ended == [os.EX_OK]
    assert [json.loads(line) for line in runs.read_text().splitlines()] == [
        process.make_plan(config)
    ] * 3
    assert ["exit code 3" in caplog.messages[0], "signal 9" in caplog.messages[1]] == [True, True]


def test_the_setup_file_is_sourced_first(node, tmp_path):
    setup = tmp_path / "setup file.bash"
    setup.write_text("export ROS_DISTRO=made-up\nread line\n")
    node.write_text(
        "import os, sys\n"
        f"open({str(tmp_path / 'said')!r}, 'w').write(os.environ['ROS_DISTRO'])\n"
        "sys.exit(69 if sys.stdin.readline() else 1)\n"
    )
    with pytest.raises(UnavailableError):
        process.supervise(adapted({"setup": str(setup)}), threading.Event())
    assert (tmp_path / "said").read_text() == "made-up"


def test_the_path_of_the_launch_file_is_printed(capsys):
    assert main(["ros2-adapter", "--launch-file"]) == 0
    assert Path(capsys.readouterr().out.strip()).read_text("utf-8").count("respawn=True") == 1
