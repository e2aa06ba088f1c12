"""Observations from Zenoh: CDR in ring channels that the loop polls, without callbacks.

A ring keeps the newest messages, so a slow loop never falls further behind. One poll reads at most
one ring's length of messages of each topic, so a flood cannot block the loop. Frames are decoded
only when they are used.
"""

from __future__ import annotations

from typing import ClassVar

import zenoh

from edge.bus.session import Ring
from edge.bus.topics import Topic
from edge.config import Config
from edge.sources.polled import PolledSource


class ZenohSource(PolledSource):
    """Source of the sensors under `zenoh.prefix`."""

    NOT_FROM_ZENOH: ClassVar[tuple[Topic, ...]] = ()
    """Topics that a subclass receives in another way."""

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._key = config.zenoh.key
        super().__init__(config, session)
        self._rings = {
            topic: Ring(session, config.zenoh.key(topic.key), n)
            for topic, n in self._capacities.items()
            if topic not in self.NOT_FROM_ZENOH
        }

    def close(self) -> None:
        for ring in self._rings.values():
            ring.close()
        super().close()

    def _where(self, topic: Topic) -> str:
        return self._key(topic.key)

    def _drain(self) -> int:
        n = 0
        for topic, ring in self._rings.items():
            samples = ring.take()
            n += len(samples)
            for sample in samples:
                if not self._is_too_large(topic.key, sample.payload):
                    self._decoder.offer(topic, sample.payload.to_bytes())
        self.counters["overrun"] = sum(ring.overruns for ring in self._rings.values())
        return n
