"""What the node is told, what it imports, and how it is started: no ROS is needed for that."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import threading
from pathlib import Path

import pytest
from patience import eventually
from simulated import simulated

from edge.cli.main import main
from edge.config import Config, ConfigError, load
from edge.config.yaml_text import parse_yaml
from edge.errors import UnavailableError
from edge.ros2_adapter import process

LIGHT = {"rclpy", "zenoh", "geometry_msgs", "launch"}


def adapted(**section: object) -> Config:
    section = {"python": sys.executable, "sensors": {"odom": "/odom"}, **section}
    return simulated({"ros2_adapter": section, "zenoh": {"topics": {"odom": "base/odom"}}})


@pytest.mark.parametrize("file", [process.NODE, process.LAUNCH_FILE], ids=lambda path: path.name)
def test_what_runs_in_ros_needs_nothing_of_ours(file):
    imported = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(str(node.module).split(".")[0])
    assert imported - set(sys.stdlib_module_names) <= LIGHT


def test_a_topic_is_passed_by_its_key_with_the_type_and_quality_that_are_usual():
    plan = process.make_plan(adapted(results={"map": "/edge/map"}))
    usual = {"reliable": False, "latched": False, "depth": 5, "max_bytes": 64_000_000}
    assert plan["sensors"] == [
        {"key": "edge/base/odom", "ros": "/odom", "type": "nav_msgs/msg/Odometry", **usual}
    ]
    (grid,) = plan["results"]
    assert (grid["key"], grid["type"]) == ("edge/map", "nav_msgs/msg/OccupancyGrid")
    assert grid["reliable"]
    assert grid["latched"]
    assert plan["goals"]["key"] == "edge/goal"
    assert plan["goals"]["answer_key"] == "edge/goal_status"
    assert json.loads(plan["zenoh"])["mode"] == "client"
    assert json.loads(json.dumps(plan)) == plan


def test_one_may_say_all_of_it():
    said = {"topic": "tf", "type": "tf2_msgs/msg/TFMessage", "reliable": False, "depth": 100}
    plan = process.make_plan(adapted(sensors={"tf": said}, goals=None))
    expected = {
        "key": "edge/tf", "ros": "tf", "type": "tf2_msgs/msg/TFMessage", "reliable": False,
        "latched": False, "depth": 100, "max_bytes": 64_000_000,
    }  # fmt: skip
    assert plan["sensors"] == [expected]
    assert plan["goals"] is None


def test_the_ready_configuration_has_a_plan():
    plan = process.make_plan(load("ros2-adapter"))
    assert {passed["key"] for passed in plan["sensors"]} == {
        "edge/camera/rgb", "edge/camera/depth", "edge/camera/info", "edge/odom",
    }  # fmt: skip
    assert plan["goals"]["action"] == "/navigate_to_pose"


def test_the_section_of_the_page_has_a_plan_too():
    page = Path(__file__).parents[2] / "docs" / "ros2-adapter.md"
    (block,) = re.findall(r"```yaml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    plan = process.make_plan(simulated(parse_yaml(block)))
    scan = next(passed for passed in plan["sensors"] if passed["key"] == "edge/lidar/scan")
    assert (scan["reliable"], scan["depth"]) == (True, 10)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"sensors": {}}, r"ros2_adapter\.sensors: nothing to pass: .*odom: /odom"),
        ({"sensors": {"tf": "/tf"}}, r"ros2_adapter\.sensors\.tf: not a topic with a ROS type"),
        ({"sensors": {"odom": "two words"}}, r"ros2_adapter\.sensors\.odom\.topic: string should"),
        ({"results": {"status": "/s"}}, r"ros2_adapter\.results\.status: not a topic with a ROS"),
        ({"sensors": {"odom": {"topic": "/o", "type": "Odometry"}}}, r"ros2_adapter\.sensors\."),
        ({"goals": "a b"}, r"ros2_adapter\.goals: string should"),
    ],
)
def test_what_is_wrong_with_it_is_told_in_one_line(section, said):
    with pytest.raises(ConfigError, match=f"^<defaults>: {said}[^\n]*$"):
        process.make_plan(adapted(**section))


@pytest.mark.parametrize("key", ["python", "setup"])
def test_a_file_that_is_not_there_is_told(key):
    with pytest.raises(UnavailableError, match=f"^<defaults>: ros2_adapter.{key}: cannot read /no"):
        process.command_of(adapted(**{key: "/no/such"}))


def test_without_ros_it_says_what_to_do_and_does_not_try_again(monkeypatch, capfd):
    """This Python has no rclpy, or had better not use it here."""
    monkeypatch.setenv("PYTHONPATH", "")
    with pytest.raises(UnavailableError, match="the node cannot run here"):
        process.supervise(adapted(python=bare_python()), threading.Event())
    assert "no rclpy" in capfd.readouterr().err


def bare_python() -> str:
    return getattr(sys, "_base_executable", sys.executable)


@pytest.fixture
def node(tmp_path, monkeypatch) -> Path:
    """Another node: it writes the plan down and does what the test says."""
    monkeypatch.setattr(process, "NODE", tmp_path / "node.py")
    monkeypatch.setattr(process, "_PAUSE_S", 0.01)
    return tmp_path / "node.py"


def test_a_node_that_fails_is_started_again_until_it_is_told_to_stop(node, tmp_path, caplog):
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
        process.supervise(adapted(setup=str(setup)), threading.Event())
    assert (tmp_path / "said").read_text() == "made-up"


def test_it_tells_where_the_launch_file_is(capsys):
    assert main(["ros2-adapter", "--launch-file"]) == 0
    assert Path(capsys.readouterr().out.strip()).read_text("utf-8").count("respawn=True") == 1
