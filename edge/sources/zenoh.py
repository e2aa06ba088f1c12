"""Observations from Zenoh: CDR on ring channels that the loop polls, never callbacks.

A ring keeps the newest messages and lets the rest go, so a loop that lags never lags more. A look
takes a ring's worth of each at most, so that no flood keeps the loop from its next tick.
Frames are decoded only when they are used.
"""

from __future__ import annotations

import time

import zenoh

from edge.bus import topics
from edge.bus.session import Ring
from edge.config import Config
from edge.geometry import SE2
from edge.sources.decoder import KINDS, CdrDecoder
from edge.sources.goal_status import GoalStatusInbox
from edge.sources.streams import KEPT
from edge.sources.synchronizer import TimeSynchronizer
from edge.types import Observation

PAUSE_S = 0.0003


class ZenohSource:
    """The sensors under `zenoh.prefix` as Observations (an `edge.loop.source.Source`).

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._synchronizer = TimeSynchronizer(config)
        self._decoder = CdrDecoder(self._synchronizer)
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        # How many messages of each topic to keep between polls; odometry is drained first.
        kept = {topics.ODOMETRY: config.source.odometry_ring, topics.CAMERA_INFO: 1}
        heard = self._synchronizer.streams
        kept |= {topic: KEPT for topic, kind in KINDS.items() if kind.field in heard}
        self._rings = {
            topic: Ring(session, config.zenoh.key(topic.key), n) for topic, n in kept.items()
        }
        self.inbox = GoalStatusInbox(session, config.zenoh)

    @property
    def counters(self) -> dict[str, int]:
        return self._synchronizer.counters

    @property
    def epoch(self) -> int:
        return self._synchronizer.odometry.epoch

    @property
    def pose(self) -> SE2 | None:
        return self._synchronizer.odometry.newest_pose

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
        for ring in self._rings.values():
            ring.close()
        self.inbox.close()

    def _drain(self) -> int:
        """Hand a ring's worth of each topic to the decoder; how many messages it was."""
        n = 0
        for topic, ring in self._rings.items():
            samples = ring.take()
            n += len(samples)
            for sample in samples:
                size = len(sample.payload)
                if size > self._max_bytes:
                    self._synchronizer.count(topic.key, "oversized", f"{size} bytes")
                else:
                    self._decoder.offer(topic, sample.payload.to_bytes())
        self.counters["overrun"] = sum(ring.overruns for ring in self._rings.values())
        return n
