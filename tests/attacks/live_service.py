"""A service whose loop runs in a thread, and a robot that stands still before its sensors."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import zenoh
from absurd_sensors import HEIGHT, WIDTH, Batch, batch
from live_patience import PATIENCE_S, eventually
from simulated import simulated

from edge.bus import topics
from edge.bus.client import send_request
from edge.bus.session import open_session
from edge.host.ports import free_port
from edge.launch import LaunchedService, open_service
from edge.loop.runner import loop

FRAME_S = 1 / 30


class Live:
    """A service under attack.

    Attributes:
        running: its parts; the loop's thread owns them, tests only read.
        peer: the attacker's session.
    """

    def __init__(self, running: LaunchedService, peer: zenoh.Session) -> None:
        self.running, self.peer = running, peer
        self.statuses: list[dict] = []
        self._settings = running.config.zenoh
        self._status = peer.declare_subscriber(self._settings.key(topics.STATUS.key), self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        self.statuses.append(json.loads(sample.payload.to_bytes()))

    @property
    def ticks(self) -> int:
        return self.running.service.latency.report(last=1).tick.count

    def send(self, said: Batch) -> None:
        for topic, payload in said.items():
            self.peer.put(self._settings.key(topic.key), payload)

    def wait(self, ticks: int) -> None:
        enough = self.ticks + ticks
        eventually(lambda: self.ticks >= enough, "the loop does not tick")

    def is_resumed(self, ticks: int = 3) -> None:
        """Wait until the service has read more frames and answered a request."""
        self.wait(ticks)
        key = self._settings.key(topics.MISSION_REQUEST)
        assert "phase" in send_request(self.peer, key, {"do": "status"}, PATIENCE_S, "mission")


@contextmanager
def live(sections: dict) -> Iterator[Live]:
    """Run a service with the simulator's detector, and 30 frames a second of a sane robot."""
    config = simulated({
        "zenoh": {"endpoint": f"tcp/127.0.0.1:{free_port()}", "shared_memory": False},
        "mission": {"target": "surfboard", "time_limit_s": 1e6},
        "sensors": {"lidar": {"z_m": 0.5}, "camera": {"width_px": WIDTH, "height_px": HEIGHT}},
        "report": {"status_hz": 20},
        **sections,
    })  # fmt: skip
    stop = threading.Event()
    with (
        open_service(config, []) as running,
        ThreadPoolExecutor(2) as pool,
        open_session(config.zenoh, "connect") as peer,
    ):
        service = Live(running, peer)
        works = [pool.submit(loop, running, stop), pool.submit(_stand, service, stop)]
        try:
            service.is_resumed()
            eventually(lambda: service.statuses, "it never told its status")
            yield service
        finally:
            stop.set()
            for work in works:
                work.result()


def _stand(service: Live, stop: threading.Event) -> None:
    while not stop.wait(FRAME_S):
        said = batch(time.time_ns())
        if service.running.config.mapping.input == "depth":
            del said[topics.CLOUD]
        service.send({**said, topics.LABELS: b'["chair"]'})
