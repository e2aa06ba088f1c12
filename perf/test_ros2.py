"""Benchmark: time from an odometry message to the goal, both measured on the robot's side.

The synchronizer waits for this odometry. The goal is sent as soon as there is an observation: the
computation of a tick is not included, it has its own budgets.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "tests"), str(ROOT / "tests" / "ros2_adapter")]

from live_patience import eventually  # noqa: E402
from live_ros import ROS_PYTHON, make_environ  # noqa: E402, of the tests
from results import result  # noqa: E402

from edge.bus import topics  # noqa: E402
from edge.bus.ros2.node import open_node  # noqa: E402
from edge.bus.ros2.topics import NAVIGATE_TO_POSE  # noqa: E402
from edge.bus.session import zenoh_session  # noqa: E402
from edge.bus.wire import messages  # noqa: E402
from edge.config import Config, parse  # noqa: E402
from edge.geometry import SE2, CameraModel  # noqa: E402
from edge.host.ports import free_port  # noqa: E402
from edge.sinks.navigate import NavigateToPoseClient  # noqa: E402
from edge.sinks.zenoh import ZenohSink  # noqa: E402
from edge.sources.ros2 import Ros2Source  # noqa: E402
from edge.sources.zenoh import ZenohSource  # noqa: E402
from edge.types import Goal  # noqa: E402

TICK_MS = 1e3 / 30
CAMERA = CameraModel.from_hfov(320, 256, 1.3)
FAR_NS = 10**15  # later than all stamps
STAMPS = range(10**9, FAR_NS, 40_000_000)


def goal_of(stamp_ns: int) -> Goal:
    return Goal(stamp_ns, SE2(1.0, 2.0, 0.5), "frontier", 7, (1.0, 2.5), 0.4, "chair")


def take_observation(source: ZenohSource | Ros2Source) -> None:
    """Wait for an observation; fail without one."""
    for _ in range(60):
        if (seen := source.poll()) is not None:
            seen.release()
            return
        source.wait(1.0)
    pytest.fail(f"no observation: {source.counters}")


def until_found(source: ZenohSource | Ros2Source, bring: Callable[[], None]) -> None:
    """Call `bring` until an observation comes; then drop all that is still under way."""

    def found() -> bool:
        bring()
        source.wait(0.2)
        if (seen := source.poll()) is None:
            return False
        seen.release()
        return True

    eventually(found)
    while source.wait(0.5):
        if (seen := source.poll()) is not None:
            seen.release()


def until_received(
    source: ZenohSource | Ros2Source, n: int, send: Callable[[int], None], stamps: Iterator[int]
) -> int:
    """Send n messages of one stamp, until all messages of a stamp have come.

    Any message may be dropped, so several stamps may be needed.

    Returns:
        The stamp.
    """

    def sent() -> int:
        stamp_ns, before = next(stamps), source.counters["received"]
        send(stamp_ns)
        while source.counters["received"] < before + n:
            if not source.wait(0.5):
                return 0
        return stamp_ns

    return eventually(sent)


def measure(benchmark, budget: str, setup: Callable, trip: Callable[[int], None]) -> None:
    benchmark.extra_info |= {"budget": budget, "reference_ms": TICK_MS}
    benchmark.pedantic(trip, setup=setup, rounds=300, warmup_rounds=20)


@pytest.mark.benchmark(timer=time.perf_counter)
def test_odometry_to_goal_over_zenoh(benchmark):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = parse({"zenoh": {"endpoint": endpoint}, "perception": {"detector": {"kind": "onnx"}}})
    settings, stamps = config.zenoh, iter(STAMPS)
    rgb = np.zeros((256, 320, 3), np.uint8)
    depth = np.full((256, 320), 1500, np.uint16)
    with (
        zenoh_session(settings, "listen") as ours,
        zenoh_session(settings, "connect") as robot,
    ):
        source, sink = ZenohSource(config, ours), ZenohSink(config, ours)
        goals = robot.declare_subscriber(
            settings.key(topics.GOAL.key), zenoh.handlers.FifoChannel(64)
        )

        def put(topic: topics.Topic, payload: bytes) -> None:
            robot.put(settings.key(topic.key), payload)

        def move(stamp_ns: int) -> None:
            put(topics.ODOMETRY, messages.encode_odometry(stamp_ns, np.eye(4), 0.0, 0.0))

        def show(stamp_ns: int) -> None:
            put(topics.CAMERA_INFO, messages.encode_camera_info(stamp_ns, "camera", CAMERA))
            put(topics.RGB, messages.encode_image(stamp_ns, "camera", rgb))
            put(topics.DEPTH, messages.encode_image(stamp_ns, "camera", depth))

        def see():
            return (until_received(source, 3, show, stamps),), {}

        def bring() -> None:
            stamp_ns = next(stamps)
            move(stamp_ns - 1)
            show(stamp_ns)
            move(stamp_ns + 1)

        def trip(stamp_ns: int) -> None:
            move(stamp_ns + 1)
            take_observation(source)
            goal = goal_of(stamp_ns)
            sink.tick(result(stamp_ns, goals=(goal,), goal=goal))
            while messages.decode_pose_stamped(goals.recv().payload.to_bytes())[0] != stamp_ns:
                pass

        until_found(source, bring)
        measure(benchmark, "odometry_to_goal_zenoh", see, trip)
        sink.close()
        source.close()


@contextmanager
def process(command: list[str], environ: dict[str, str]) -> Iterator[subprocess.Popen]:
    """Start a process that ends when its input closes, or on a signal."""
    pipe = subprocess.PIPE
    environ = {**os.environ, **environ}
    with subprocess.Popen(command, env=environ, stdin=pipe, stdout=pipe, text=True) as started:
        try:
            yield started
        finally:
            started.stdin.close()
            started.terminate()


@pytest.mark.benchmark(timer=time.perf_counter)
def test_odometry_to_goal_through_the_adapter(benchmark, tmp_path):
    """Measure with a live ROS 2 (rclpy, Fast DDS); two pipes to its process are included."""
    ros = make_environ(tmp_path / "packages")
    config = adapted_config(f"tcp/127.0.0.1:{free_port()}")
    path, stamps, statuses = tmp_path / "robot.yaml", iter(STAMPS), []
    path.write_text(json.dumps(config.model_dump(mode="json", exclude={"path"})))
    adapter = [sys.executable, "-m", "edge.cli", "ros2-adapter", str(path)]
    environ = {**ros, "PYTHONPATH": f"{ROOT}:{ros['PYTHONPATH']}"}
    echo = [str(ROS_PYTHON), "-u", str(Path(__file__).with_name("ros_echo.py"))]
    with (
        zenoh_session(config.zenoh, "listen") as session,
        process(echo, ros) as robot,
        process(adapter, environ),
    ):
        assert robot.stdout.readline() == "ready\n"
        source = Ros2Source(config, session)
        node = open_node(config, session, "sink")
        navigator = NavigateToPoseClient(node, "/navigate_to_pose", "odom", statuses.append)
        send_goal = node.client(
            "/navigate_to_pose/_action/send_goal", f"{NAVIGATE_TO_POSE}_SendGoal", timeout_s=1.0
        )

        def say(name: str, stamp_ns: int) -> None:
            robot.stdin.write(f"{name} {stamp_ns}\n")
            robot.stdin.flush()

        def bring() -> None:
            stamp_ns = next(stamps)
            say("rgb", FAR_NS)  # no picture is waited for: all to come are too late
            for name, ns in (("odom", stamp_ns - 1), ("scan", stamp_ns), ("odom", stamp_ns + 1)):
                say(name, ns)

        def see():
            navigator.update()
            return (until_received(source, 1, lambda stamp_ns: say("scan", stamp_ns), stamps),), {}

        def trip(stamp_ns: int) -> None:
            say("odom", stamp_ns + 1)
            take_observation(source)
            navigator.send(goal_of(stamp_ns))
            while robot.stdout.readline() != f"goal {stamp_ns}\n":
                pass

        eventually(send_goal.has_server)
        until_found(source, bring)
        measure(benchmark, "odometry_to_goal_adapter", see, trip)
        source.close()


def adapted_config(endpoint: str) -> Config:
    return parse({
        "zenoh": {"endpoint": endpoint}, "source": {"kind": "ros2"}, "sinks": ["ros2"],
        "ros2": {
            "via": "adapter", "map_frame": "odom", "mounts": "config",
            "topics": {"camera/rgb": "/camera"}, "adapter": {"python": str(ROS_PYTHON)},
        },
        "sensors": {"lidar": {"rings": 1}}, "mapping": {"input": "cloud"},
        "perception": {"detector": {"kind": "onnx"}, "back_projection": "cloud"},
    })  # fmt: skip
