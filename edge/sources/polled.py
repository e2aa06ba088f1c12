"""Base class of sources that poll for messages: synchronizer, decoder and waiting."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import zenoh

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError
from edge.config import Config
from edge.geometry import SE2
from edge.loop.source import InputStatus
from edge.sources.decoder import INFOS, KINDS, CdrDecoder
from edge.sources.goal_status import GoalStatusInbox
from edge.sources.streams import KEPT
from edge.sources.synchronizer import TimeSynchronizer, streams_of
from edge.sources.tf import RobotFrames
from edge.text import one_line
from edge.types import Observation

PAUSE_S = 0.0003
"""Time in seconds between two polls of the rings (buffers of messages, `edge.bus.session.Ring`)."""


class PolledSource(ABC):
    """A source (`edge.loop.source.Source`) whose subclasses receive the messages, in `_drain`.

    Args:
        frames: see `CdrDecoder`; also gives the mounts of sensors if tf has them.
        clock: time of arrivals, in ns.

    Attributes:
        inbox: the goal statuses of the controller.

    Raises:
        ConfigError: the configuration needs a cloud but has no `sensors.lidar`.
    """

    def __init__(
        self,
        config: Config,
        session: zenoh.Session,
        frames: RobotFrames | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        mount_at = frames.mount_at if frames is not None and frames.by_tf else None
        self._synchronizer = TimeSynchronizer(config, clock, mount_at)
        self._decoder = CdrDecoder(self._synchronizer, clock, frames)
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        self.inbox = GoalStatusInbox(session, config.zenoh)
        fields = self._synchronizer.streams
        # Topic → number of messages to buffer between two polls; odometry is read first.
        self._capacities = {topics.ODOMETRY: config.source.odometry_ring}
        n_cameras = len(config.sensors.cameras)
        self._capacities |= {t: 1 for t, info in INFOS.items() if info.camera_index < n_cameras}
        self._capacities |= {
            topic: KEPT
            for topic, kind in KINDS.items()
            if kind.field in fields and kind.camera_index < n_cameras
        }
        for topic in self._capacities:
            self._synchronizer.inputs.listen(topic.key, self._where(topic))

    @staticmethod
    def check_options(config: Config, **options: Any) -> None:
        """Raise an error for an invalid configuration; see `edge.config.components`."""
        streams_of(config)

    @property
    def counters(self) -> dict[str, int]:
        return self._synchronizer.counters

    @property
    def epoch(self) -> int:
        return self._synchronizer.odometry.epoch

    @property
    def pose(self) -> SE2 | None:
        return self._synchronizer.odometry.newest_pose

    def input_table(self) -> tuple[InputStatus, ...]:
        """Return the table of inputs; see `edge.loop.source.Source`."""
        return self._synchronizer.inputs.rows()

    def poll(self) -> Observation | None:
        """Return the newest observation; see `edge.loop.source.Source`."""
        self._drain()
        return self._synchronizer.poll()

    def wait(self, timeout_s: float) -> bool:
        """Wait for messages; polls every 0.3 ms, since rings cannot be waited on."""
        deadline_s = time.monotonic() + timeout_s
        while not self._drain():
            if time.monotonic() >= deadline_s:
                return False
            time.sleep(PAUSE_S)
        return True

    def close(self) -> None:
        self.inbox.close()

    @abstractmethod
    def _where(self, topic: Topic) -> str:
        """Return the key, ROS topic or address of a topic; called by the constructor."""

    @abstractmethod
    def _drain(self) -> int:
        """Pass new messages to the synchronizer, at most one ring's length of each topic.

        Returns:
            Their number.
        """

    def _take_transforms(
        self, name: str, payload: zenoh.ZBytes | bytes, frames: RobotFrames, static: bool
    ) -> None:
        """Process a tf message that was received under this name, and count its faults."""
        self._synchronizer.received(name)
        if self._is_too_large(name, payload):
            return
        try:
            problem = frames.take(bytes(payload), static)
        except DecodeError as error:
            self._synchronizer.count(name, "malformed", one_line(error))
            return
        if problem:
            self._synchronizer.count(name, "malformed", f"{problem}, cannot be used")
        else:
            self._synchronizer.inputs.on_used(name)

    def _is_too_large(self, name: str, payload: zenoh.ZBytes | bytes) -> bool:
        """Return True for a message over the size limit, and count it under this name."""
        size = len(payload)
        if size > self._max_bytes:
            self._synchronizer.inputs.on_message(name)
            self._synchronizer.count(name, "oversized", f"{size} bytes")
        return size > self._max_bytes
