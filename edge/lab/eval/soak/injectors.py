"""Fault injectors of `edge soak`, as generators; `faults` has the table that uses them.

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
"""A running fault."""
Injector = Callable[[SoakHarness, np.random.Generator], Injection]
"""Returns an `Injection` that has not started yet."""
Action = Callable[[SoakHarness], object]
"""Begins or ends a fault."""

LATE_S = 0.4  # delay of the messages by `DELAY_MESSAGES`
_BATCH = 40  # messages of a flood in one step; there are several steps a second


def between(begin: Action, end: Action = lambda harness: None) -> Injector:
    """Return an injector that calls `begin`, waits until the fault is over, and calls `end`."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        begin(harness)
        try:
            yield from _wait()
        finally:
            end(harness)

    return fault


def _wait() -> Injection:
    while True:
        yield


def alter_messages(make: Callable[[np.random.Generator], MessageFilter]) -> Injector:
    """Return an injector that makes the relay alter messages; `make` returns the filter."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        harness.relay.alter = make(rng)
        try:
            yield from _wait()
        finally:
            harness.relay.alter = None

    return fault


def flood_messages(*payloads: Callable[[np.random.Generator], tuple[str, bytes]]) -> Injector:
    """Return an injector that publishes messages (key, payload) all the time, a batch at a time."""

    def fault(harness: SoakHarness, rng: np.random.Generator) -> Injection:
        while True:
            for make in payloads:
                for _ in range(_BATCH):
                    harness.put(*make(rng))
            yield

    return fault


DELAY_MESSAGES = between(lambda h: h.relay.delay(LATE_S), lambda h: h.relay.delay(0.0))
STOP_SIMULATOR = between(
    lambda h: h.children.send_signal("simulator", signal.SIGSTOP),
    lambda h: h.children.send_signal("simulator", signal.SIGCONT),
)
ENTER_NEXT_HOUSE = between(lambda h: h.start_next_house())
CUT_SESSION = between(lambda h: h.relay.cut(), lambda h: _reconnect(h))
KILL_ROUTER = between(lambda h: h.children.kill("router"), lambda h: h.start_router())
KILL_CONTROLLER = between(lambda h: h.children.kill("controller"), lambda h: h.start_controller())
SWAP_TO_BAD_MODEL = between(lambda h: h.request_models(do="use", model=BROKEN))
BLOCK_LOG_READER = between(lambda h: h.log.block(), lambda h: h.log.open_reader())


def _reconnect(harness: SoakHarness) -> None:
    """Open the relay's session again, unless the service has ended.

    Without a router the service is the server: nothing would answer, and the wait has no end.
    """
    if harness.service.poll() is None:
        harness.relay.connect()


def signal_model(number: int) -> Injector:
    """Return an injector that sends a signal to the model's process."""

    def send(harness: SoakHarness) -> None:
        process = harness.model_process()
        if process is None:
            raise UserError(
                "the model of the service has no process of its own; set perception.isolation to "
                "process"
            )
        os.kill(process.pid, number)

    return between(send)


def fill_disk(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    """Stop the growth of all files of the service, as on a full disk. Written data stays intact."""
    pid = harness.service.pid
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield from _wait()
    finally:  # a child started during the fault has inherited the limit
        for limited in (pid, *(child.pid for child in descendants(pid))):
            with suppress(ProcessLookupError):
                resource.prlimit(limited, resource.RLIMIT_FSIZE, before)


def reload_changed_config(*choices: dict[str, dict[str, object]]) -> Injector:
    """Return an injector that reloads the first of these changes that makes a difference."""

    def reload(harness: SoakHarness) -> None:
        present = harness.config_file.read_bytes()
        for changes in choices:
            harness.write_config(**changes)
            if harness.config_file.read_bytes() != present:
                break
        harness.service.send_signal(signal.SIGHUP)

    return between(reload)


def reload_bad_config(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    present = harness.config_file.read_bytes()
    bad = (b"mission: [", b'{"perception": {"detector": {"kind": "guess"}}}', present[:-9], b"\xff")
    harness.config_file.write_bytes(bad[rng.integers(len(bad))])
    harness.service.send_signal(signal.SIGHUP)
    try:
        yield from _wait()
    finally:
        harness.config_file.write_bytes(present)


def _swap_model(harness: SoakHarness) -> None:
    """Switch to the copy of the model, or back, with `force` as the computer may be slow."""
    running = harness.request_models(do="status")
    configured = harness.config.perception.detector.model  # type: ignore[union-attr]
    # A swap that is still on probation or has failed reports the old model as `previous`.
    present = running["model" if running["state"] in ("kept", "idle") else "previous"]
    harness.request_models(do="use", model=configured if present == TWIN else TWIN, force=True)


def _write_log(harness: SoakHarness) -> None:
    """Make the service write all its threads to the log."""
    harness.service.send_signal(signal.SIGUSR1)


def _close_log_reader(harness: SoakHarness) -> None:
    harness.log.close_reader()
    _write_log(harness)


def _open_log_reader(harness: SoakHarness) -> None:
    harness.log.open_reader()
    _write_log(harness)


SWAP_MODEL = between(_swap_model)
CLOSE_LOG_READER = between(_close_log_reader, _open_log_reader)


def stop_viewer(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    harness.start_viewer()
    stops_s = time.monotonic() + 3.0  # after it has started
    try:
        while time.monotonic() < stops_s:
            yield
        harness.children.send_signal("viewer", signal.SIGSTOP)
        yield from _wait()
    finally:
        harness.children.kill("viewer")


def read_live_page(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    for path in cycle((*PUBLIC, *LIVE_PAGES)):
        harness.text(path)
        yield


def send_incomplete_requests(harness: SoakHarness, rng: np.random.Generator) -> Injection:
    """Open more connections than the service keeps; none sends a complete request."""
    address = harness.config.http.host, harness.config.http.port
    with ExitStack() as opened:
        while True:
            for request in _INCOMPLETE:
                with suppress(OSError):  # the service refuses when there are too many
                    visitor = socket.create_connection(address, ANSWER_S)
                    opened.enter_context(visitor).sendall(request)
            yield


def flood_requests(make: Callable[[np.random.Generator], bytes]) -> Injector:
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


# Beginnings of requests, which never get an end.
_INCOMPLETE = (b"", b"GET /live/map HT", b"GET /live/map HTTP/1.1\r\nHost: 127.0.0.1\r\n")
REQUESTS = (b'{"do": "status"}', b'{"do": "resume"}')
"""Valid requests for a flood."""
ANSWER = b'{"stamp": 1, "state": "accepted"}'
"""A valid goal status."""


def malformed_request(rng: np.random.Generator) -> bytes:
    return relay.malformed(b'{"do": "new", "instruction": "go to the bed"}', rng)
