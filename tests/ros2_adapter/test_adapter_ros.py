"""Adapter next to a live ROS 2 (rclpy, Fast DDS): its messages and goals.

It has only the rights of `config/secure`.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest
import zenoh
from live_patience import PATIENCE_S, eventually
from processes import Process, running
from ros_peer_facts import ABORTED, ENDLESS, MOUNTED, PIXELS, REACHED, REJECTED, STAMP_NS
from secure_files import etc_edge, settings_of
from simulated import simulated

from edge.bus.ros2.node import Ros2Subscription, open_node
from edge.bus.ros2.requests import BOOL
from edge.bus.ros2.topics import PUBLISHED, SUBSCRIBED
from edge.bus.session import zenoh_session
from edge.bus.wire import messages, transforms
from edge.bus.wire.cdr import HEADER
from edge.config import Config
from edge.geometry import SE2, Grid
from edge.host.ports import free_port
from edge.sinks.navigate import NavigateToPoseClient
from edge.types import Goal, GoalStatus

HERE = Path(__file__).parent
PEER = HERE / "ros_peer.py"
# All topics except "goal", which the action replaces, and topics that are off by default.
_OFF = {"goal", "detections", "objects", "keepout_mask", "keepout_info", "answer"}
# All but those of a second camera, and the stop button.
N_SUBSCRIBED = sum(not name.startswith("camera2/") for name in SUBSCRIBED) + 1
READY = (
    f"passing up to {N_SUBSCRIBED} topics from ROS 2 to edge, "
    f"and {len(PUBLISHED.keys() - _OFF)} from edge to ROS 2"
)


@pytest.fixture(scope="module")
def etc(tmp_path_factory) -> Path:
    return etc_edge(tmp_path_factory.mktemp("etc-edge"))


@pytest.fixture(scope="module")
def config(etc, ros_python, tmp_path_factory) -> tuple[Config, Path]:
    of = settings_of(etc, "certificates", free_port())
    data = {
        "zenoh": of("operator").model_dump(mode="json"),
        "source": {"kind": "ros2"},
        "sinks": ["ros2"],
        "ros2": {
            "via": "adapter",
            "topics": {"camera/rgb": "/camera/image", "lidar/scan": "/nowhere"},
            "adapter": {"python": ros_python},
        },
        "perception": {"detector": {"kind": "sim"}},
    }
    path = tmp_path_factory.mktemp("adapter") / "robot.yaml"
    path.write_text(json.dumps(data))
    return simulated(data), path


class Service:
    """The service's end of it: its node and its client of the action."""

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._settings = config.ros2
        self.session = session
        self.node = open_node(config, session, "test")
        self.told: list[GoalStatus] = []
        action = config.ros2.topic("navigate_to_pose")
        self.navigator = NavigateToPoseClient(self.node, action, "map", self.told.append)

    def hear(self, name: str, latched: bool = False) -> Ros2Subscription:
        return self.node.subscription(self._settings.topic(name), (SUBSCRIBED[name],), 8, latched)

    def say(self, name: str, payload: bytes, latched: bool = False) -> None:
        self.node.publisher(self._settings.topic(name), PUBLISHED[name], latched).put(payload)

    def drive(self, stamp_ns: int, x_m: float) -> None:
        place = SE2(x_m, -1.0, 0.5)
        self.navigator.send(Goal(stamp_ns, place, "frontier", 1, (x_m, -1.0), 0.5, "chair"))

    def answers(self, stamp_ns: int, until: str) -> list[tuple[str, str]]:
        """Return the statuses of a goal until it has this state."""

        def told():
            self.navigator.update()
            answers = [(a.state, a.reason) for a in self.told if a.stamp_ns == stamp_ns]
            return answers if until in {state for state, _ in answers} else None

        return eventually(told)


@pytest.fixture(scope="module")
def service(config) -> Iterator[Service]:
    with zenoh_session(config[0].zenoh, "listen") as session:
        yield Service(config[0], session)


@pytest.fixture
def odometry(service) -> Iterator[Ros2Subscription]:
    """As long as the service hears it, a sensor watches the robot's way."""
    subscription = service.hear("odom")
    yield subscription
    subscription.close()


@pytest.fixture(scope="module")
def robot(ros_python, ros_environ) -> Iterator[Process]:
    with running([ros_python, "-u", str(PEER)], ros_environ) as peer:
        peer.says("ready")
        yield peer


@pytest.fixture(scope="module")
def adapter(config, etc, service, robot, ros_environ) -> Iterator[Process]:
    own = {
        "PYTHONPATH": f"{HERE.parents[1]}:{ros_environ['PYTHONPATH']}",
        "EDGE__ZENOH__CLIENT_FILE": str(etc / "adapter.json5"),
    }
    command = [sys.executable, "-m", "edge.cli", "ros2-adapter", str(config[1])]
    with running(command, {**ros_environ, **own}) as process:
        process.says(READY)
        yield process


def payload_of(subscription: Ros2Subscription) -> bytes:
    return eventually(subscription.take)[0][1].to_bytes()


def test_ros_messages_reach_the_service_unchanged(adapter, service, odometry):
    images = service.hear("camera/rgb")
    payload = payload_of(images)
    header = messages.decode_image_header(payload)
    assert (header.width, header.height, header.encoding) == (8, 8, "rgb8")
    assert header.frame_id == "camera"
    rgb = np.zeros((8, 8, 3), np.uint8)
    messages.decode_image_into(payload, header, rgb)
    assert rgb.tobytes() == PIXELS
    moved = messages.decode_odometry(payload_of(odometry))
    assert (moved.stamp_ns, moved.frame_id, moved.v_mps) == (STAMP_NS, "odom", 0.25)
    images.close()


def test_topics_without_subscribers_are_not_taken_from_ros(adapter, service, robot):
    images = service.hear("camera/rgb")
    before = robot.count('"watched": 0')
    payload_of(images)
    images.close()
    robot.says('"watched": 0', times=before + 1)


def test_a_silent_topic_is_reported_with_the_reason(adapter, service):
    nothing = service.hear("lidar/scan")
    adapter.says("/nowhere: no message yet: it has no publisher")
    nothing.close()


def test_a_late_subscriber_gets_static_transforms(adapter, service):
    late = service.hear("tf_static", latched=True)
    ((transform,), _) = transforms.decode_transforms(payload_of(late))
    assert (transform.parent, transform.child) == ("base_link", "camera")
    np.testing.assert_allclose(transform.T[:3, 3], MOUNTED)
    late.close()


def test_a_latched_stop_from_before_and_a_best_effort_button_are_heard(adapter, service):
    for _ in range(2):  # as often as the service starts
        with closing(service.node.subscription("/edge/stop", (BOOL,), 16, latched=True)) as topic:
            heard: set[int] = set()  # the first byte after the header

            def both(topic=topic, heard=heard) -> bool:
                heard.update(payload.to_bytes()[len(HEADER)] for _, payload in topic.take())
                return heard == {0, 1}

            eventually(both, lambda heard=heard: f"heard only {heard}")
        time.sleep(1.0)  # the adapter notices that it is closed
    assert adapter.count("offering incompatible QoS") == 0


def test_invalid_messages_do_not_reach_ros(adapter, service, robot):
    cells = np.full((20, 30), -1, np.int8)
    cells[3, 4] = 100
    service.say("map", b"not a map", latched=True)
    adapter.says(
        "occupancy: message dropped: not little-endian CDR: the message begins with 6e6f7420"
    )
    service.say("map", messages.encode_occupancy_grid(7, Grid(cells, (0.0, 1.0), 0.05)))
    robot.says(json.dumps({"map": [30, 20, 0.05, 100 - 599]}))


ON_ITS_WAY = [("accepted", ""), ("accepted", "1 recoveries, 2.5 m left")]


@pytest.mark.parametrize(
    ("x_m", "on_its_way", "end"),
    [
        (REACHED, ON_ITS_WAY, ("reached", "")),
        (ABORTED, ON_ITS_WAY, ("failed", "aborted by Nav2 (error 204): no valid path found")),
        (REJECTED, [], ("failed", "refused by navigate_to_pose")),
    ],
)
def test_the_actions_status_of_a_goal_is_its_answer(
    adapter, service, robot, odometry, x_m, on_its_way, end
):
    stamp_ns = int(x_m)
    service.drive(stamp_ns, x_m)
    *before, last = service.answers(stamp_ns, until=end[0])
    assert last == end
    assert set(before) <= set(on_its_way)  # feedback may be late
    robot.says(f'"asked": {x_m}')
    assert robot.count(f'"asked": {x_m}') == 1


def test_invalid_requests_are_dropped(adapter, service):
    key = service.node.dialect.data_key(0, "/navigate_to_pose/_action/send_goal", "", "")
    for junk in (b"junk", b"\0\1\0\0junk"):
        replies = service.session.get(key, payload=junk, timeout=PATIENCE_S)
        assert list(replies) == []
    adapter.says("a request was dropped: ")


def test_the_adapter_cancels_a_replaced_goal(adapter, service, robot, odometry):
    before = robot.count('"cancelled"')
    for stamp_ns in (20, 21):
        service.drive(stamp_ns, ENDLESS)
        assert service.answers(stamp_ns, until="accepted") != []
    eventually(lambda: service.navigator.update() or robot.count('"cancelled"') > before)
    service.navigator.cancel()
    robot.says('"cancelled"', times=before + 2)


def test_a_goal_of_an_ended_service_is_cancelled(adapter, service, robot):
    before, followed = robot.count('"cancelled"'), service.hear("odom")
    payload_of(followed)
    service.drive(30, ENDLESS)
    service.answers(30, until="accepted")
    followed.close()
    adapter.says("its navigation goal is cancelled")
    robot.says('"cancelled"', times=before + 1)
    assert service.answers(30, until="failed")[-1] == ("failed", "cancelled by Nav2")


def node_of(adapter: Process) -> psutil.Process:
    return eventually(lambda: psutil.Process(adapter.process.pid).children())[0]


def test_a_node_that_crashes_is_started_again(adapter, service, odometry):
    node_of(adapter).send_signal(signal.SIGSEGV)
    adapter.says("the adapter's node ended (signal 11): starting it again in 1 s")
    adapter.says(READY, times=2)
    odometry.take()
    payload_of(odometry)


def test_when_the_action_goes_away_its_goal_has_failed(adapter, service, robot, odometry):
    service.drive(40, ENDLESS)
    service.answers(40, until="accepted")
    robot.end()
    assert service.answers(40, until="failed")[-1] == ("failed", "navigate_to_pose is gone")


def test_the_node_ends_with_the_adapter_and_cancels_its_goal(
    adapter, service, odometry, ros_python, ros_environ
):
    with running([ros_python, "-u", str(PEER)], ros_environ) as robot:
        service.drive(50, ENDLESS)
        service.answers(50, until="accepted")
        node = node_of(adapter)
        adapter.process.kill()
        adapter.process.wait()
        robot.says('"cancelled"')
        node.wait(PATIENCE_S)
