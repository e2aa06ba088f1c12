"""Floods of requests: each is answered, and those that stop the robot get through."""

from __future__ import annotations

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from edge_processes import write_config
from live_patience import PATIENCE_S

from edge.bus.client import send_request
from edge.bus.session import open_session
from edge.config import ZenohConfig

pytestmark = pytest.mark.slow

KEY = "edge/mission/request"
FLOODERS = 3
PAUSES = 16
A_SECOND = 250  # requests of each flooder, if the machine is fast enough
LEAST = 50  # requests of each flooder, on a slow one
MOST_OPEN = 300  # requests of each flooder without an answer; together fewer than Zenoh buffers
FLOODS = {
    "new": [{"do": "new", "formula": "F chair"}, {"do": "new", "instruction": "find the bed"}],
    "stop and go": [{"do": "pause"}, {"do": "resume"}, {"do": "status"}],
    "nonsense": [{"do": "explode"}, {"do": "new"}, {"do": "new", "formula": "F" * 60_000}],
}


@pytest.mark.parametrize("asked_for", FLOODS.values(), ids=FLOODS)
def test_a_flood_is_answered_and_every_pause_is_honoured(edge, endpoint, tmp_path, asked_for):
    config = write_config(tmp_path, zenoh={"endpoint": endpoint}, mission={"target": "toilet"})
    service = edge("run", config).says("ready:")
    edge("sim", config)
    service.says("frontier")
    stop, under_way = threading.Event(), threading.Semaphore(0)

    def flood(_: int) -> list[list[bytes]]:
        """Return the answers to each request: their texts, or errors."""
        asked, answers = [], []

        def read_next() -> None:
            replies = asked[len(answers)]
            answers.append([(reply.ok or reply.err).payload.to_bytes() for reply in replies])

        with open_session(ZenohConfig(endpoint=endpoint), "connect") as session:
            # A new session may not know the service yet; `send_request` then tries again.
            send_request(session, KEY, {"do": "status"}, PATIENCE_S, "mission")
            under_way.release()
            while not stop.is_set() or len(asked) <= LEAST:
                payload = json.dumps(asked_for[len(asked) % len(asked_for)])
                asked.append(session.get(KEY, payload=payload, timeout=PATIENCE_S))
                if len(asked) - len(answers) >= MOST_OPEN:
                    read_next()
                time.sleep(1 / A_SECOND)
            while len(answers) < len(asked):
                read_next()
            return answers

    with (
        open_session(ZenohConfig(endpoint=endpoint), "connect") as session,
        ThreadPoolExecutor(FLOODERS) as pool,
    ):
        flooding = [pool.submit(flood, n) for n in range(FLOODERS)]
        paused = []
        try:
            assert all(under_way.acquire(timeout=PATIENCE_S) for _ in flooding)
            for _ in range(PAUSES):
                paused.append(
                    send_request(session, KEY, {"do": "pause"}, PATIENCE_S, "mission")["paused"]
                )
                time.sleep(0.2)
        finally:
            stop.set()
        answered = [answers for future in flooding for answers in future.result(PATIENCE_S)]
        assert paused == [True] * PAUSES
        assert {len(answers) for answers in answered} == {1}
        said = [json.loads(answer) for (answer,) in answered]
        assert not [answer for answer in said if "not running" in answer.get("error", "")]
        assert (
            send_request(session, KEY, {"do": "cancel"}, PATIENCE_S, "mission")["phase"] == "failed"
        )
