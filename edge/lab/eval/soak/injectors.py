"""Fault injectors, as generators.

The code before the first `yield` starts the fault. The code after each `yield` runs a few times a
second during the fault. The `finally` block ends it.
"""

from __future__ import annotations

import os
import resource
import signal
import socket
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, suppress
from itertools import cycle

import numpy as np

from edge.bus import topics
from edge.errors import UserError
from edge.host.processes import descendants
from edge.lab.eval.soak import relay
from edge.lab.eval.soak.harness import ANSWER_S, BROKEN, TWIN, SoakHarness
from edge.lab.eval.soak.invariants import LIVE_PAGES
from edge.lab.eval.soak.relay import MessageFilter
from edge.live.view import PUBLIC

Injection = Generator[None, None, None]
Injector = Callable[[SoakHarness, np.random.Generator], Injection]

LATE_S = 0.4
_BATCH = 40  # messages of a flood in one step; there are several steps a second


def hold_until_end(end: Callable[[], object] = lambda: None) -> Injection:
    """Wait until the fault is over, then call `end`."""
    try:
        while True:
            yield
    finally:
        end()


def relay_alters(make: Callable[[np.random.Generator], MessageFilter]) -> Injector:
    """Return an injector that makes the relay alter messages."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        harness.relay.alter = make(rng)
        try:
            yield from hold_until_end()
        finally:
            harness.relay.alter = None

    return fault


def message_flood(*payloads: Callable[[np.random.Generator], tuple[str, bytes]]) -> Injector:
    """Return an injector that publishes messages (key, payload) all the time, a batch at a time."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        while True:
            for make in payloads:
                for _ in range(_BATCH):
                    harness.put(*make(rng))
            yield

    return fault


def late(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.relay.delay(LATE_S)
    yield from hold_until_end(lambda: harness.relay.delay(0.0))


def simulator_stopped(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.send("simulator", signal.SIGSTOP)
    yield from hold_until_end(lambda: harness.send("simulator", signal.SIGCONT))


def next_house(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.start_next_house()
    yield from hold_until_end()


def cut(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.relay.cut()
    yield from hold_until_end(harness.relay.connect)


def router_killed(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.kill("router")
    yield from hold_until_end(harness.start_router)


def controller_killed(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.kill("controller")
    yield from hold_until_end(harness.start_controller)


def model_signalled(number: int) -> Injector:
    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        process = harness.model_process()
        if process is None:
            raise UserError(
                "the model of the service has no process of its own; set perception.isolation to "
                "process"
            )
        os.kill(process.pid, number)
        yield from hold_until_end()

    return fault


def disk_full(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    """Stop the growth of all files of the service, as on a full disk. Written data stays intact."""
    before = resource.prlimit(harness.service.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(harness.service.pid, resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield from hold_until_end()
    finally:  # a child started during the fault has inherited the limit
        for pid in (
            harness.service.pid,
            *(child.pid for child in descendants(harness.service.pid)),
        ):
            with suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def reloaded(*choices: dict[str, dict[str, object]]) -> Injector:
    """Return an injector that reloads the first of these changes that makes a difference."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        present = harness.config_file.read_bytes()
        for changes in choices:
            harness.write_config(**changes)
            if harness.config_file.read_bytes() != present:
                break
        harness.service.send_signal(signal.SIGHUP)
        yield from hold_until_end()

    return fault


def badly_reloaded(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    present = harness.config_file.read_bytes()
    bad = (b"mission: [", b'{"perception": {"detector": {"kind": "guess"}}}', present[:-9], b"\xff")
    harness.config_file.write_bytes(bad[rng.integers(len(bad))])
    harness.service.send_signal(signal.SIGHUP)
    yield from hold_until_end(lambda: harness.config_file.write_bytes(present))


def swapped(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    """Switch to the copy of the model, or back, with `force` as the computer may be slow."""
    running = harness.models(do="status")
    own = harness.config.perception.detector.model  # type: ignore[union-attr]
    at_work = running["model"] if running["state"] in ("kept", "idle") else running["previous"]
    harness.models(do="use", model=own if at_work == TWIN else TWIN, force=True)
    yield from hold_until_end()


def badly_swapped(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.models(do="use", model=BROKEN)
    yield from hold_until_end()


def log_reader_gone(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    """Close the reader of the log, then make the service write.

    SIGUSR1 prints all threads now, and again once the reader is back.
    """
    harness.log.leave()
    harness.service.send_signal(signal.SIGUSR1)
    try:
        yield from hold_until_end()
    finally:
        harness.log.open()
        harness.service.send_signal(signal.SIGUSR1)


def log_reader_stuck(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.log.stick()
    yield from hold_until_end(harness.log.open)


def viewer_stopped(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.start_viewer()
    stops_s = time.monotonic() + 3.0  # after it has started
    try:
        while time.monotonic() < stops_s:
            yield
        harness.send("viewer", signal.SIGSTOP)
        yield from hold_until_end()
    finally:
        harness.kill("viewer")


def page_open(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    for path in cycle((*PUBLIC, *LIVE_PAGES)):
        harness.text(path)
        yield


def visitors_stuck(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    """Open more connections than the service keeps; none sends a complete request."""
    address = harness.config.http.host, harness.config.http.port
    with ExitStack() as opened:
        while True:
            for request in _HALVES:
                with suppress(OSError):  # at times there are too many
                    visitor = socket.create_connection(address, ANSWER_S)
                    opened.enter_context(visitor).sendall(request)
            yield


def request_flood(make: Callable[[np.random.Generator], bytes]) -> Injector:
    """Return an injector that sends requests without waiting for answers."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        keys = [
            harness.config.zenoh.key(name)
            for name in (topics.MISSION_REQUEST, topics.MODELS_REQUEST)
        ]
        while True:
            for _ in range(_BATCH):
                harness.session.get(keys[rng.integers(2)], payload=make(rng), timeout=1.0)
            yield

    return fault


_HALVES = (b"", b"GET /live/map HT", b"GET /live/map HTTP/1.1\r\nHost: 127.0.0.1\r\n")
REQUESTS = (b'{"do": "status"}', b'{"do": "resume"}')
ANSWER = b'{"stamp": 1, "state": "accepted"}'


def nonsense(rng: np.random.Generator) -> bytes:
    return relay.broken(b'{"do": "new", "instruction": "go to the bed"}', rng)
