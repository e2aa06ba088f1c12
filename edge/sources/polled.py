"""What sources share that look for messages: the time synchronizer behind, and the looking."""

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
from edge.loop.source import InputRow
from edge.sources.decoder import KINDS, CdrDecoder
from edge.sources.goal_status import GoalStatusInbox
from edge.sources.streams import KEPT
from edge.sources.synchronizer import TimeSynchronizer, streams_of
from edge.sources.tf import Frames
from edge.text import one_line
from edge.types import Observation

PAUSE_S = 0.0003


class PolledSource(ABC):
    """An `edge.loop.source.Source`, but for `_drain`, which brings the messages, and `_where`.

    Args:
        frames: see `CdrDecoder`; also where the sensors sit, if that is for tf to say.
        clock: of arrivals, in ns.

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """

    def __init__(
        self,
        config: Config,
        session: zenoh.Session,
        frames: Frames | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        mount_at = frames.mount_at if frames is not None and frames.by_tf else None
        self._synchronizer = TimeSynchronizer(config, clock, mount_at)
        self._decoder = CdrDecoder(self._synchronizer, clock, frames)
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        self.inbox = GoalStatusInbox(session, config.zenoh)
        heard = self._synchronizer.streams
        self._kept = {topics.ODOMETRY: config.source.odometry_ring, topics.CAMERA_INFO: 1}
        self._kept |= {topic: KEPT for topic, kind in KINDS.items() if kind.field in heard}
        """How many messages of each topic to keep between polls; odometry is drained first."""
        for topic in self._kept:
            self._synchronizer.inputs.listen(topic.key, self._where(topic))

    @staticmethod
    def check_options(config: Config, **options: Any) -> None:
        """Refuse a configuration that no source could be made of; see `edge.config.named`."""
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

    def input_table(self) -> tuple[InputRow, ...]:
        """See `edge.loop.source.Source`."""
        return self._synchronizer.inputs.rows()

    def poll(self) -> Observation | None:
        """See `edge.loop.source.Source`."""
        self._drain()
        return self._synchronizer.poll()

    def wait(self, timeout_s: float) -> bool:
        """See `edge.loop.source.Source`; looks every 0.3 ms, since rings cannot be waited on."""
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
        """Return the key, the ROS topic or the address where a topic is listened to. The
        constructor calls it."""

    @abstractmethod
    def _drain(self) -> int:
        """Hand what came to the synchronizer, a ring's worth of each topic at most; how many
        messages it was."""

    def _take_transforms(
        self, name: str, payload: zenoh.ZBytes | bytes, frames: Frames, static: bool
    ) -> None:
        """Take a message of tf, that came under this name."""
        self._synchronizer.received(name)
        if self._is_too_large(name, payload):
            return
        try:
            untaken = frames.take(bytes(payload), static)
        except DecodeError as error:
            self._synchronizer.count(name, "malformed", one_line(error))
            return
        if untaken:
            self._synchronizer.count(name, "malformed", f"{untaken}, that fit nowhere")
        else:
            self._synchronizer.inputs.used(name)

    def _is_too_large(self, name: str, payload: zenoh.ZBytes | bytes) -> bool:
        """Counts it too, under this name."""
        size = len(payload)
        if size > self._max_bytes:
            self._synchronizer.inputs.came(name)
            self._synchronizer.count(name, "oversized", f"{size} bytes")
        return size > self._max_bytes
