"""The adapter beside a live ROS 2 (rclpy, Fast DDS): what it passes, and what becomes of goals."""

from __future__ import annotations

import json
import queue
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
import zenoh
from patience import PATIENCE_S, eventually
from processes import Process, running
from ros_peer_facts import ABORTED, ENDLESS, PIXELS, REACHED, REJECTED
from simulated import simulated

from edge.bus.session import zenoh_session
from edge.bus.wire import messages
from edge.config import Config
from edge.geometry import SE2, Grid
from edge.host.ports import free_port

PEER = Path(__file__).with_name("ros_peer.py")


@pytest.fixture(scope="module")
def config(ros_python, tmp_path_factory) -> Iterator[tuple[Config, Path]]:
    data = {
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
        "ros2_adapter": {
            "python": ros_python,
            "sensors": {"camera/rgb": "/camera/image", "odom": "/odom", "lidar/scan": "/nowhere"},
            "results": {"goal": "/edge/goal", "map": "/edge/map"},
        },
        "perception": {"detector": {"kind": "sim"}},
    }
    path = tmp_path_factory.mktemp("adapter") / "robot.yaml"
    path.write_text(json.dumps(data))
    return simulated(data), path


class Service:
    """The service's end of it: gives goals, hears what comes of them."""

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._config, self._session = config, session
        self.heard: dict[str, queue.SimpleQueue[bytes]] = {}
        self._subscribers = []
        for name in ("camera/rgb", "odom", "goal_status"):
            arrived = self.heard[name] = queue.SimpleQueue()
            subscriber = session.declare_subscriber(
                config.zenoh.key(name), lambda s, a=arrived: a.put(s.payload.to_bytes())
            )
            self._subscribers.append(subscriber)

    def put(self, name: str, payload: bytes) -> None:
        self._session.put(self._config.zenoh.key(name), payload)

    def goal(self, stamp_ns: int, x_m: float) -> None:
        self.put("goal", messages.encode_pose_stamped(stamp_ns, SE2(x_m, -1.0, 0.5)))

    def next(self, name: str, repeat: Callable[[], None] = lambda: None) -> bytes:
        """The next message, `repeat` called twice a second until it is there."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            repeat()
            try:
                return self.heard[name].get(timeout=0.5)
            except queue.Empty:
                pass
        pytest.fail(f"no {name}")

    def drain(self, name: str) -> None:
        while not self.heard[name].empty():
            self.heard[name].get()

    def answers(self, stamp_ns: int, x_m: float) -> Iterator[tuple[str, str]]:
        """What is said of a goal, which is given again and again; old goals' answers left out."""
        while True:
            answer = json.loads(self.next("goal_status", lambda: self.goal(stamp_ns, x_m)))
            if answer["stamp"] == stamp_ns:
                yield answer["state"], answer["reason"]

    def outcome(self, stamp_ns: int, x_m: float) -> list[tuple[str, str]]:
        """All answers to a goal, to the last."""
        answers = []
        for answer in self.answers(stamp_ns, x_m):
            answers.append(answer)
            if answer[0] != "accepted":
                return answers
        raise AssertionError


@pytest.fixture(scope="module")
def service(config) -> Iterator[Service]:
    with zenoh_session(config[0].zenoh, "listen") as session:
        yield Service(config[0], session)


@pytest.fixture(scope="module")
def robot(ros_python, ros_environ) -> Iterator[Process]:
    with running([ros_python, "-u", str(PEER)], ros_environ) as peer:
        peer.says("ready")
        yield peer


@pytest.fixture(scope="module")
def adapter(config, service, robot, ros_environ) -> Iterator[Process]:
    root = Path(__file__).parents[2]
    path = {"PYTHONPATH": f"{root}:{ros_environ['PYTHONPATH']}"}
    command = [sys.executable, "-m", "edge.cli", "ros2-adapter", str(config[1])]
    with running(command, {**ros_environ, **path}) as process:
        process.says("passes 3 topics in and 2 out")
        yield process
        if process.process.poll() is None:
            assert process.end() == 0


def test_messages_of_ros_reach_the_service_as_they_are(adapter, service):
    payload = service.next("camera/rgb")
    header = messages.decode_image_header(payload)
    assert (header.width, header.height, header.encoding) == (8, 8, "rgb8")
    assert header.frame_id == "camera"
    rgb = np.zeros((8, 8, 3), np.uint8)
    messages.decode_image_into(payload, header, rgb)
    assert rgb.tobytes() == PIXELS
    adapter.says("/nowhere: no message yet: nobody publishes it")


def test_results_reach_ros_and_what_is_no_message_does_not(adapter, service, robot):
    cells = np.full((20, 30), -1, np.int8)
    cells[3, 4] = 100
    service.put("map", b"not a map")
    adapter.says("map: left out: not little-endian CDR: begins 6e6f7420")
    service.put("map", messages.encode_occupancy_grid(7, Grid(cells, (0.0, 1.0), 0.05)))
    robot.says(json.dumps({"map": [30, 20, 0.05, 100 - 599]}))


def test_a_goal_comes_back_as_the_odometry_that_ros_makes_of_it(adapter, service):
    stamp_ns = 1_700_000_000_123_456_789
    payload = service.next("odom", lambda: service.goal(stamp_ns, REJECTED))
    odometry = messages.decode_odometry(payload)
    assert odometry.stamp_ns == stamp_ns
    assert odometry.v_mps == 0.25
    np.testing.assert_allclose(odometry.T_map_base, SE2(REJECTED, -1.0, 0.5).matrix(), atol=1e-12)


def test_what_the_action_says_of_a_goal_is_its_answer(adapter, service, robot):
    service.outcome(1_700_000_000_123_456_789, REJECTED)  # the one of the test before
    on_way = ("accepted", "2.5 m to go, 1 recoveries")
    aborted = "aborted by /navigate_to_pose: no valid path\nfound"
    expected = {
        REACHED: [("accepted", ""), on_way, ("reached", "")],
        ABORTED: [("accepted", ""), on_way, ("failed", aborted)],
        REJECTED: [("failed", "rejected by /navigate_to_pose")],
    }
    for i, (x_m, answers) in enumerate(expected.items()):
        got = service.outcome(10**18 + i, x_m)
        assert got[-1] == answers[-1]
        assert set(got) <= set(answers)
    assert robot.count(f'"asked": {REACHED}') == 1, "repeated, driven once"


def test_a_replaced_goal_is_cancelled_and_so_is_one_that_is_given_up(adapter, service, robot):
    for stamp_ns in (2 * 10**18, 2 * 10**18 + 1):
        assert next(service.answers(stamp_ns, ENDLESS)) == ("accepted", "")
    robot.says('"cancelled"', times=1)
    adapter.says("the service repeats its goal no more")  # nobody repeats the second
    robot.says('"cancelled"', times=2)


def node_of(adapter: Process) -> psutil.Process:
    return eventually(lambda: psutil.Process(adapter.process.pid).children())[0]


def test_a_node_that_crashes_is_started_again(adapter, service):
    node_of(adapter).send_signal(signal.SIGSEGV)
    adapter.says("the node ended (signal 11): started again in 1 s")
    adapter.says("passes 3 topics in and 2 out", times=2)
    service.drain("camera/rgb")
    service.next("camera/rgb")


def test_when_the_action_goes_away_its_goal_has_failed(adapter, service, robot):
    answers = service.answers(10**18 + 100, ENDLESS)
    assert next(answers)[0] == "accepted"
    robot.end()
    while (answer := next(answers))[0] == "accepted":
        pass
    assert answer == ("failed", "/navigate_to_pose is gone")


def test_the_node_outlives_nobody(adapter):
    node = node_of(adapter)
    adapter.process.kill()
    adapter.process.wait()
    node.wait(PATIENCE_S)
