"""Observations from Zenoh: ring channels that the loop polls, never callbacks.

A ring keeps the newest messages and lets the rest go, so a loop that lags never lags more. A look
takes a ring's worth of each at most, so that no flood keeps the loop from its next tick.
"""

from __future__ import annotations

import time

import zenoh

from edge.bus import topics
from edge.bus.session import Ring
from edge.bus.topics import Topic
from edge.config import Config
from edge.geometry import SE2
from edge.sources.assembler import Assembler
from edge.sources.streams import KEPT
from edge.types import Observation

_PAUSE_S = 0.0003


class ZenohSource:
    """The sensors under `zenoh.prefix` as Observations (an `edge.loop.source.Source`).

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        self._assembler = Assembler(config)
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        self._rings = {
            topic: Ring(session, topic.under(config.zenoh.prefix), kept)
            for topic, kept in self._kept(config).items()
        }

    def _kept(self, config: Config) -> dict[Topic, int]:
        """How many messages of each topic to keep between polls; odometry is drained first."""
        rings = {topics.ODOMETRY: config.source.odometry_ring, topics.CAMERA_INFO: 1}
        rings |= dict.fromkeys(self._assembler.streams, KEPT)
        if topics.CLOUD in rings:
            rings[topics.SCAN] = KEPT
        if topics.OBJECT_IDS in rings:
            rings[topics.OBJECT_LABELS] = 1
        return rings

    @property
    def counters(self) -> dict[str, int]:
        return self._assembler.counters

    @property
    def epoch(self) -> int:
        return self._assembler.odometry.epoch

    @property
    def pose(self) -> SE2 | None:
        return self._assembler.odometry.newest_pose

    def poll(self) -> Observation | None:
        """See `edge.loop.source.Source`."""
        self._drain()
        return self._assembler.poll()

    def wait(self, timeout_s: float) -> bool:
        """See `edge.loop.source.Source`; looks every 0.3 ms, since rings cannot be waited on."""
        deadline_s = time.monotonic() + timeout_s
        while not self._drain():
            if time.monotonic() >= deadline_s:
                return False
            time.sleep(_PAUSE_S)
        return True

    def close(self) -> None:
        for ring in self._rings.values():
            ring.close()

    def _drain(self) -> int:
        """Hand a ring's worth of each topic to the assembler; how many messages it was."""
        n = 0
        for topic, ring in self._rings.items():
            samples = ring.take()
            n += len(samples)
            for sample in samples:
                size = len(sample.payload)
                if size > self._max_bytes:
                    self._assembler.count(topic, "oversized", f"{size} bytes")
                else:
                    self._assembler.offer(topic, sample.payload.to_bytes())
        self.counters["overrun"] = sum(ring.overruns for ring in self._rings.values())
        return n
