"""A robot whose sensors' data is tampered with by a relay: it stands, and does not drive back."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence

import pytest
from edge_processes import Edge, write_config
from live_patience import eventually

from edge.bus.topics import ODOMETRY, Topic
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.host.ports import free_port
from edge.lab.eval.soak.relay import MessageFilter, Relay, freeze, restamped

STAMPED = ("camera/rgb", "camera/depth", "camera/info", "odom", "sim/segmentation")
FARTHEST_M = 1.2  # a computer that is busy needs longer than one that is not
BACK_M = 0.3


def backward() -> MessageFilter:
    first: list[int] = []

    def alter(topic: Topic, payload: bytes) -> Sequence[bytes]:
        if topic.key not in STAMPED:
            return (payload,)
        stamp_ns = messages.peek_stamp_ns(payload)
        first[:] = first or [stamp_ns]
        return (restamped(payload, 2 * first[0] - stamp_ns),)

    return alter


class Track:
    """Track of the robot from its own messages, with driven distance; forwards messages."""

    def __init__(self) -> None:
        self.alter: MessageFilter | None = None
        self.v_mps = self.path_m = 0.0
        self.xy: tuple[float, float] | None = None
        self.way: list[tuple[float, float]] = []

    def __call__(self, topic: Topic, payload: bytes) -> Sequence[bytes]:
        if topic is ODOMETRY:
            told = messages.decode_odometry(payload)
            before, (x, y) = self.xy, told.T_map_base[:2, 3].tolist()
            self.path_m += 0.0 if before is None else math.dist(before, (x, y))
            self.xy, self.v_mps = (x, y), told.v_mps
            self.way.append((x, y))
        return (payload,) if self.alter is None else self.alter(topic, payload)

    def tamper(self, alter: MessageFilter | None) -> None:
        self.path_m, self.way = 0.0, []
        self.alter = alter


@pytest.fixture
def driven(edge: Callable[..., Edge], endpoint, tmp_path) -> Iterator[tuple[Edge, Track]]:
    """Run a service, a controller and a robot behind a relay, at speed."""
    camera = {"width_px": 160, "height_px": 128, "rate_hz": 10.0}
    settings = {"sensors": {"camera": camera}, "mission": {"target": "surfboard"}}
    robot = ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}")
    (tmp_path / "robot").mkdir()
    config = write_config(tmp_path, zenoh={"endpoint": endpoint}, **settings)
    service = edge("run", config).says("ready:")
    track, stop = Track(), threading.Event()
    relay = Relay(robot, ZenohConfig(endpoint=endpoint), stop)
    relay.alter = track
    try:
        far = write_config(tmp_path / "robot", zenoh=robot.model_dump(), **settings)
        edge("sim", far, "--no-motion")
        edge("sim", config, "--motion-only")
        service.until(lambda: track.v_mps > 0.3, "the robot never drove")
        yield service, track
    finally:
        stop.set()
        relay.close()


@pytest.mark.parametrize(
    ("alter", "why"),
    [
        (lambda: freeze(True), "no pixel has changed"),
        pytest.param(backward, "no usable observations", marks=pytest.mark.slow),
    ],
    ids=["frozen", "backward"],
)
def test_tampered_sensor_data_stop_the_robot_until_they_recover(driven, alter, why):
    service, track = driven
    said = len(service.lines)
    track.tamper(alter())
    service.until(lambda: "standing still" in "\n".join(service.lines[said:]), "it never stood")
    eventually(lambda: track.v_mps == 0.0, "it drives on")
    stood_m, way = track.path_m, len(track.way)
    eventually(lambda: len(track.way) > way + 400, "it sends no more")
    assert track.path_m < FARTHEST_M
    assert track.path_m - stood_m < BACK_M, "it drove on, or back"
    assert why in "\n".join(service.lines[said:])
    track.tamper(None)
    eventually(lambda: track.path_m > 0.5, "it never drove on")
