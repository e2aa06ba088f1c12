"""The controller's process on a real Zenoh session, with a robot played by the test."""

from __future__ import annotations

import itertools
import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from fake_zenoh import Flooded
from live_patience import PATIENCE_S
from simulated import simulated

from edge.bus import topics
from edge.bus.session import open_session
from edge.bus.wire import messages
from edge.config import Config
from edge.geometry import SE2, Grid
from edge.host.ports import free_port
from edge.lab.motion import process

GOAL = SE2(2.0, 1.0, 0.5)
CELLS = np.zeros((60, 80), np.int8)
STEP_S = 0.1


class Robot:
    """Simulator and service in one: moves as commanded, in lockstep or not."""

    def __init__(self, config: Config) -> None:
        self.session = open_session(config.zenoh, "listen")
        self.settings = config.zenoh
        self.pose, self.v, self.w, self.stamp_ns = SE2(0.5, 1.0, 0.0), 0.0, 0.0, 10**9
        self.take_commands = self._hear(topics.CMD_VEL)
        self.answers = self._hear(topics.GOAL_STATUS)

    def _hear(self, topic: topics.Topic) -> zenoh.Subscriber:
        ring = zenoh.handlers.RingChannel(256)
        return self.session.declare_subscriber(self.settings.key(topic.key), ring)

    def put(self, topic: topics.Topic, payload: bytes) -> None:
        self.session.put(
            self.settings.key(topic.key), payload, congestion_control=zenoh.CongestionControl.BLOCK
        )

    def odometry(self) -> None:
        T = self.pose.matrix()
        self.put(topics.ODOMETRY, messages.encode_odometry(self.stamp_ns, T, self.v, self.w))

    def tick(self) -> None:
        self.put(topics.TICK, json.dumps({"stamp": self.stamp_ns}).encode())

    def map(self) -> None:
        grid = messages.encode_occupancy_grid(self.stamp_ns, Grid(CELLS, (0.0, 0.0), 0.05))
        self.put(topics.MAP, grid)

    def map_and_goal(self) -> None:
        self.map()
        self.put(topics.GOAL, messages.encode_pose_stamped(77, GOAL))

    def command(self, again: Callable[[], None], stamp_ns: int = 0) -> tuple:
        """Return the next command of a stamp or later; resend `again`, which may be lost."""
        deadline_s, next_s = time.monotonic() + PATIENCE_S, time.monotonic() + 0.5
        while time.monotonic() < deadline_s:
            while (sample := self.take_commands.try_recv()) is not None:
                command = messages.decode_twist_stamped(sample.payload.to_bytes())
                if command[0] >= stamp_ns:
                    return command
            if time.monotonic() > next_s:
                again()
                next_s += 0.5
            time.sleep(0.0005)
        raise AssertionError(f"no command for {stamp_ns} in {PATIENCE_S} s")

    def move(self, v: float, w: float) -> None:
        yaw = self.pose.yaw_rad + 0.5 * w * STEP_S
        self.pose = SE2(
            self.pose.x_m + v * STEP_S * math.cos(yaw),
            self.pose.y_m + v * STEP_S * math.sin(yaw),
            self.pose.yaw_rad + w * STEP_S,
        )
        self.v, self.w = v, w
        self.stamp_ns += int(STEP_S * 1e9)

    def heard(self) -> list[dict]:
        said = []
        while (sample := self.answers.try_recv()) is not None:
            said.append(json.loads(sample.payload.to_bytes()))
        return said


def _config(lockstep: bool) -> Config:
    return simulated({
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}", "shared_memory": False},
        "sim": {"lockstep": lockstep},
        "motion": {"rate_hz": 50.0},
    })  # fmt: skip


@pytest.fixture
def robot(request: pytest.FixtureRequest) -> Iterator[Robot]:
    config = _config(request.param)
    stop = threading.Event()
    robot = Robot(config)
    thread = threading.Thread(target=process.main, args=(config, stop))
    thread.start()
    try:
        yield robot
    finally:
        stop.set()
        thread.join(PATIENCE_S)
        robot.session.close()
    assert not thread.is_alive()


lockstep = pytest.mark.parametrize("robot", [True], indirect=True)
real_time = pytest.mark.parametrize("robot", [False], indirect=True)


def _ask(robot: Robot) -> tuple[float, float]:
    def send() -> None:
        robot.odometry()
        robot.tick()

    send()
    _, v, w = robot.command(send, robot.stamp_ns)
    return v, w


@lockstep
def test_lockstep_drives_to_the_goal_one_answer_a_stamp(robot: Robot):
    robot.move(*_ask(robot))
    robot.map_and_goal()
    said: list[dict] = []
    for _ in range(400):
        robot.move(*_ask(robot))
        said += robot.heard()
        if said and said[-1]["state"] != "accepted":
            break
    assert [(a["stamp"], a["state"]) for a in said] == [(77, "accepted"), (77, "reached")]
    assert robot.pose.distance_to(GOAL.x_m, GOAL.y_m) <= 0.12


@lockstep
def test_lockstep_answers_a_repeated_stamp_with_the_same_command(robot: Robot):
    _ask(robot)
    robot.map_and_goal()
    robot.stamp_ns += 10**8
    first = _ask(robot)
    assert first != (0.0, 0.0)
    for repeat in (robot.odometry, robot.tick):
        repeat()
        stamp_ns, *again = robot.command(repeat, robot.stamp_ns)
        assert (stamp_ns, *again) == (robot.stamp_ns, *first)


@lockstep
def test_lockstep_waits_for_the_tick(robot: Robot):
    _ask(robot)
    robot.stamp_ns += 10**8
    robot.odometry()
    time.sleep(0.2)
    while (sample := robot.take_commands.try_recv()) is not None:  # the stamp before, once more
        stamp_ns = messages.decode_twist_stamped(sample.payload.to_bytes())[0]
        assert stamp_ns < robot.stamp_ns
    robot.tick()
    assert robot.command(robot.tick, robot.stamp_ns)[0] == robot.stamp_ns


@lockstep
def test_garbage_on_every_topic_is_survived(robot: Robot):
    _ask(robot)
    for topic in (topics.MAP, topics.GOAL, topics.ODOMETRY, topics.TICK):
        for payload in (b"", b"\x00\x01\x00\x00junk", b"{}", b"[" * 3000, bytes(4097)):
            robot.put(topic, payload)
    robot.stamp_ns += 10**8
    assert _ask(robot) == (0.0, 0.0)


def wait_for(robot: Robot, moving: bool) -> None:
    """Send odometry, and maps to a robot that is to move, until it does (or does not)."""

    def send() -> None:
        robot.stamp_ns += 10**7
        robot.odometry()
        if moving:
            robot.map()

    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        send()
        if (robot.command(send, robot.stamp_ns)[1] > 0.0) == moving:
            return
    raise AssertionError(f"never {'moving' if moving else 'still'}")


def connect(robot: Robot) -> None:
    """Wait for the controller, and send it a goal."""
    robot.odometry()
    robot.command(robot.odometry)
    robot.map_and_goal()


@real_time
def test_real_time_commands_stop_without_odometry(robot: Robot):
    connect(robot)
    wait_for(robot, moving=True)
    # Silence: the newest command is a stop, again and again.
    stops = 0
    while stops < 3:
        command = robot.command(lambda: None, robot.stamp_ns)
        stops = stops + 1 if command == (robot.stamp_ns, 0.0, 0.0) else 0
    # And it goes on when the odometry is back.
    wait_for(robot, moving=True)


@real_time
def test_real_time_stops_without_maps_and_resumes_with_them(robot: Robot, caplog):
    connect(robot)
    wait_for(robot, moving=True)
    # The odometry goes on, the maps do not.
    while "no map" not in caplog.text:
        wait_for(robot, moving=False)
    wait_for(robot, moving=False)
    wait_for(robot, moving=True)


@pytest.mark.parametrize(
    "payload", [b"", b"null", b"[1]", b'{"stamp": "1"}', b'{"stamp": true}', b"\xff", bytes(5000)]
)
def test_parse_tick_refuses(payload):
    with pytest.raises(ValueError, match=r"stamp|JSON|bytes"):
        process.parse_tick(payload)


def test_malformed_messages_are_counted_and_logged_once(caplog):
    good = messages.encode_odometry(5, np.eye(4), 0.1, 0.2)
    bus = process.Bus(Flooded("edge/odom", [b"", b"junk", good, good[:50], good]), simulated())
    read = bus.read(topics.ODOMETRY, messages.decode_odometry)
    assert [o.stamp_ns for o in read] == [5, 5]
    assert bus.malformed == {"odom": 3}
    assert len([r for r in caplog.records if "odom" in r.getMessage()]) == 1


def test_one_read_takes_at_most_a_full_ring():
    flood = (messages.encode_odometry(n, np.eye(4), 0.0, 0.0) for n in itertools.count(1))
    bus = process.Bus(Flooded("edge/odom", flood), simulated())
    for look in range(3):
        read = bus.read(topics.ODOMETRY, messages.decode_odometry)
        assert [o.stamp_ns for o in read] == list(range(64 * look + 1, 64 * look + 65))


@pytest.mark.parametrize(("lockstep", "taken"), [(True, 2), (False, 3)])
def test_lockstep_ignores_a_repeated_map(lockstep, taken):
    grid, heard = Grid(CELLS, (0.0, 0.0), 0.05), []
    maps = [messages.encode_occupancy_grid(stamp_ns, grid) for stamp_ns in (1, 1, 2)]
    bus = process.Bus(Flooded("edge/map", maps), simulated({"sim": {"lockstep": lockstep}}))
    for _ in maps:  # its ring holds but one
        bus.feed(SimpleNamespace(on_map=heard.append))
    assert len(heard) == taken
