"""Zenoh sessions with this project's settings.

The service listens; all other processes connect to it as clients. A listening peer forwards
messages between its clients, but never between peers, so only this way does the simulator receive
the controller's messages. Multicast discovery is off: it is unreliable in containers and closed
networks. A client that finds no server, or is refused, retries forever. It gives up after `HOST_S`
if the endpoint's host name cannot be resolved.

`native` is Zenoh's own configuration (`zenoh.Config`), `settings` the section `zenoh` of ours.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Literal

import zenoh

from edge import config
from edge.bus.refusal import UnknownHostError, diagnose_refusal
from edge.bus.topics import Qos, Topic
from edge.bus.zenoh_file import (
    apply_settings,
    denies_prefix,
    endpoint_fault,
    get,
    open_addresses,
    read_zenoh_file,
    unreadable_file,
)
from edge.errors import ConfigError, Stopped, UnavailableError
from edge.host.interruptible import start_detached_thread
from edge.text import one_line, redact

log = logging.getLogger("edge.bus.session")

CLOSE_S = 2.0
"""Time in seconds that the caller waits for a session to close."""
HOST_S = 30.0
"""Timeout for name resolution: a computer that is just booting may have no name server yet."""
# Log texts; `{}` is an address, or the prefix.
OPEN_WARNING = (
    "{} is open: every client that reaches it may command the robot; see docs/security.md"
)
DENIED_WARNING = (
    "access_control allows no key below {}/ (zenoh.prefix): no message can be sent or received"
)
ENVELOPE_BYTES = 65536
"""More than Zenoh adds to a message: key, attachment and options."""

_PAUSE_S = 0.2  # between two attempts to connect
# Appended to `RUST_LOG`, Zenoh's log levels: these two modules log the entire configuration at
# lower levels.
_NO_CONFIGURATION = ",zenoh::api::session=info,zenoh::net::runtime::orchestrator=info"
_NO_SERVER_TEXT = "Unable to connect to any of"  # in Zenoh's error if no server answers

Role = Literal["listen", "connect", "route"]
"""`listen`: the service; `connect`: its clients; `route`: a router between them."""

# A `BLOCK` message waits up to 5 s for its slowest receiver. The session that forwards messages
# between its clients waits as well, and its two receiving threads serve all of them: one stopped
# viewer would block everything. So outside lockstep no topic may block. `DROP` only skips a
# receiver that is slow; if a message must arrive, its publisher repeats it.
_URGENT: dict = {
    "reliability": zenoh.Reliability.RELIABLE,
    "priority": zenoh.Priority.INTERACTIVE_HIGH,
    "express": True,
}
# Quality of service (`Topic.qos`) → arguments of `declare_publisher`.
_QOS: dict[Qos, dict] = {
    "drop": {
        "congestion_control": zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.BEST_EFFORT,
        "priority": zenoh.Priority.DATA,
        "express": False,
    },
    "urgent": {"congestion_control": zenoh.CongestionControl.DROP, **_URGENT},
    "block": {"congestion_control": zenoh.CongestionControl.BLOCK, **_URGENT},
}


class BusError(UnavailableError):
    """No session; the message is one line with the endpoint, the reason and what to do."""


class ConnectInterrupted(Stopped):
    """`stop` was set before there was a session.

    Attributes:
        refused: reason why the server refuses the session; None: no server was there.
        unknown: reason why the endpoint's host name cannot be resolved; None: it can.
    """

    def __init__(self, address: str, refused: str | None, unknown: str | None = None) -> None:
        situation = (
            f"no server answered at {address}" if refused is None else f"refused at {address}"
        )
        super().__init__(f"zenoh.endpoint: stopped while {situation}")
        self.refused, self.unknown = refused, unknown


def session_config(
    settings: config.ZenohConfig,
    role: Role,
    keep_zenoh_timeout: bool = False,
    most_bytes: int | None = None,
) -> zenoh.Config:
    """Return the Zenoh configuration of a process: Zenoh's own file, then our settings over it.

    See `edge.bus.zenoh_file`. With `mode: client` no process of role `listen` listens: all connect
    to a router that runs elsewhere, or to a process with role `route`.

    A message that must not be dropped (an answer to a request, or another peer's blocking message)
    waits at most one second for a peer. Then Zenoh disconnects that peer. A client reconnects by
    itself.

    Args:
        settings: `zenoh` of the configuration.
        role: `listen`, `connect` or `route`.
        keep_zenoh_timeout: let such a message wait for 5 s, as Zenoh does, not for one second.
        most_bytes: see `edge.bus.zenoh_file.apply_settings`.

    Raises:
        ConfigError: the file cannot be read, or has another mode.
        BusError: the endpoint is invalid.
    """
    if (fault := endpoint_fault(settings.endpoint)) is not None:
        raise BusError(_explain(settings.address, role, fault))
    key, name = zenoh_file_of(settings, role)
    listens = role == "route" or (role == "listen" and settings.mode == "peer")
    mode = "router" if role == "route" else "peer" if listens else "client"
    native = read_zenoh_file(key, name)
    try:
        return apply_settings(
            native,
            mode,
            settings.endpoint,
            listens,
            settings.shared_memory,
            keep_zenoh_timeout,
            most_bytes,
        )
    except ConfigError as error:
        raise ConfigError(f"{key}: {name}: {error}") from None
    except zenoh.ZError as error:
        raise BusError(_explain(settings.address, role, str(error))) from None


def check_settings(settings: config.ZenohConfig, role: Role) -> None:
    """Raise an error for settings that can never open a session.

    Raises:
        ConfigError: see `session_config`.
        BusError: see `session_config`; or a file with a certificate or password cannot be read.
    """
    native = session_config(settings, role)
    unreadable = unreadable_file(native, listens=bool(get(native, "listen/endpoints")))
    if unreadable is not None:
        raise BusError(_explain(settings.address, role, unreadable))


def zenoh_file_of(settings: config.ZenohConfig, role: Role) -> tuple[str, str | None]:
    """Return the key that names a role's Zenoh configuration file, and the file or None."""
    if role != "connect" or settings.client_file is None:
        return "zenoh.file", settings.file
    return "zenoh.client_file", settings.client_file


@contextmanager
def zenoh_session(
    settings: config.ZenohConfig,
    role: Role,
    stop: threading.Event | None = None,
    keep_zenoh_timeout: bool = False,
    most_bytes: int | None = None,
    report: Callable[[str], None] = lambda what: None,
) -> Iterator[zenoh.Session]:
    """Open a session as `open_session` does, and close it in limited time when the block ends.

    If a peer accepts no data, Zenoh needs up to 12 s to close (it flushes, then lingers). After
    `CLOSE_S` closing continues in a thread that is not joined (`edge.host.interruptible`).
    """
    opened = open_session(settings, role, stop, keep_zenoh_timeout, most_bytes, report)
    try:
        yield opened
    finally:
        if sys.is_finalizing():  # the process exits inside the block; no thread can start any more
            _close(opened)
        else:
            closing = start_detached_thread("zenoh-close", _close, opened)
            closing.join(CLOSE_S)
            if closing.is_alive():
                log.warning("zenoh: a peer at %s accepts no data: the session is given up; the "
                            "last messages to it may be lost", settings.address)  # fmt: skip


def _close(opened: zenoh.Session) -> None:
    with suppress(zenoh.ZError):  # if closing took longer than Zenoh's own limit
        opened.close()


def open_session(
    settings: config.ZenohConfig,
    role: Role,
    stop: threading.Event | None = None,
    keep_zenoh_timeout: bool = False,
    most_bytes: int | None = None,
    report: Callable[[str], None] = lambda what: None,
) -> zenoh.Session:
    """Open a session; the caller closes it (an unclosed session can hang the process's exit).

    A client waits here until a server answers. A session that loses its peer reconnects by itself.
    Zenoh's own waiting cannot be interrupted, so this function makes short attempts and handles
    signals between them.

    Args:
        settings: `zenoh` of the configuration.
        role: `listen`, `connect` or `route`.
        stop: stops waiting when it is set.
        keep_zenoh_timeout: see `session_config`.
        most_bytes: see `session_config`.
        report: called after each failed attempt with a line that describes the wait.

    Raises:
        ConfigError: Zenoh's own file cannot be used.
        BusError: the endpoint is in use or invalid, or its host cannot be resolved.
        ConnectInterrupted: `stop` was set.
    """
    _init_zenoh_log()
    stop = stop or threading.Event()
    native = session_config(settings, role, keep_zenoh_timeout, most_bytes)
    key, name = zenoh_file_of(settings, role)
    for address in open_addresses(native):
        log.warning("zenoh.endpoint: %s", OPEN_WARNING.format(address))
    if role != "route" and denies_prefix(native, settings.prefix):
        log.warning("%s: %s", key, DENIED_WARNING.format(settings.prefix))
    logged: set[str | None] = set()
    last_reason: str | None = None
    resolved_s = time.monotonic()  # when the host name was last resolved
    while True:
        try:
            return zenoh.open(native)
        except zenoh.ZError as error:
            if _NO_SERVER_TEXT not in str(error):
                unreadable = unreadable_file(native, listens=bool(get(native, "listen/endpoints")))
                cause = str(error) if unreadable is None else unreadable
                raise BusError(_explain(settings.address, role, cause)) from None
        # Here no server answered: find out why, then wait and try again.
        refused, unknown = _diagnose(settings, native, name or key)
        if unknown is None:
            resolved_s = time.monotonic()
        elif time.monotonic() - resolved_s >= HOST_S:
            why = f"{unknown}; correct the name, or give an address"
            raise BusError(f"zenoh.endpoint: {settings.address}: {why}")
        text = _wait_text(settings.address, refused, unknown)
        report(text)
        # Log a reason only the second time: a server that starts or is busy refuses once.
        reason = unknown or refused
        if reason not in logged and reason == last_reason:
            logged.add(reason)
            log.log(logging.INFO if reason is None else logging.WARNING, text)
        last_reason = reason
        if stop.wait(_PAUSE_S):
            raise ConnectInterrupted(settings.address, refused, unknown)


def _diagnose(
    settings: config.ZenohConfig, native: zenoh.Config, file: str
) -> tuple[str | None, str | None]:
    """Return why the server refuses a session, and why its host is unknown; see `_wait_text`."""
    try:
        return diagnose_refusal(settings.endpoint, native, file), None
    except UnknownHostError as error:
        return None, str(error)


def _wait_text(address: str, refused: str | None, unknown: str | None) -> str:
    """Return the line that describes a wait; with two None, no server is there."""
    if unknown is not None:
        return f"zenoh.endpoint: {address}: {unknown}; trying again for up to {HOST_S:g} s"
    if refused is not None:
        return f"zenoh: refused at {address}: {refused}; trying again"
    return f"waiting for a server at {address}"


def declare_publisher(
    session: zenoh.Session, topic: Topic, settings: config.ZenohConfig
) -> zenoh.Publisher:
    """Declare a publisher with the congestion control, reliability and priority of the topic."""
    return session.declare_publisher(settings.key(topic.key), **_QOS[topic.qos])


def _init_zenoh_log() -> None:
    """Let Zenoh log as `RUST_LOG` says, except its configuration, which may hold a password."""
    if (asked := os.environ.get("RUST_LOG")) and not asked.endswith(_NO_CONFIGURATION):
        os.environ["RUST_LOG"] = asked + _NO_CONFIGURATION
    zenoh.try_init_log_from_env()


class Ring:
    """The newest messages of one key, for one thread, which polls.

    Args:
        capacity: most messages that are kept, and that a poll returns. A full ring drops the
            oldest.

    Attributes:
        overruns: number of times that two polls in a row found the ring full. Messages were lost;
            it is unknown how many. A single full poll is normal after a late poll or at the start.
            Always 0 if `capacity` is 1, which is for topics whose last message is enough.
    """

    def __init__(self, session: zenoh.Session, key: str, capacity: int) -> None:
        self.overruns = 0
        self._full = False
        self._key, self._capacity = key, capacity
        self._subscriber = self._declare(session, key, zenoh.handlers.RingChannel(capacity))

    def take(self) -> list[zenoh.Sample]:
        """Return the messages since the last poll, oldest first; at most `capacity`."""
        samples: list[zenoh.Sample] = []
        # Not until the ring is empty: with a fast sender that would never end.
        while len(samples) < self._capacity:
            if (sample := self._subscriber.try_recv()) is None:
                break
            samples.append(sample)
        # A ring of capacity 1 never counts as full.
        was_full, self._full = self._full, len(samples) == self._capacity > 1
        if was_full and self._full:
            self._overrun()
        return samples

    def close(self) -> None:
        self._subscriber.undeclare()

    def _declare(
        self, session: zenoh.Session, key: str, ring: zenoh.handlers.RingChannel
    ) -> zenoh.Subscriber:
        return session.declare_subscriber(key, ring)

    def _overrun(self) -> None:
        self.overruns += 1
        if self.overruns == 1:
            log.warning("%s: messages arrive faster than they are read: only the newest %d of each "
                        "poll are kept (further such polls are only counted)",
                        self._key, self._capacity)  # fmt: skip


class QueryRing(Ring):
    """A ring of the queries of one key; a dropped query ends without an answer."""

    def _declare(
        self, session: zenoh.Session, key: str, ring: zenoh.handlers.RingChannel
    ) -> zenoh.Queryable:
        return session.declare_queryable(key, ring)


def _explain(address: str, role: Role, reason: str) -> str:
    """Return the message of a BusError for Zenoh's reason, without Zenoh's own decoration."""
    if "already in use" in reason:
        return (
            f"zenoh.endpoint: {address} is in use: another service runs there; "
            "stop it, or set another port for this one"
        )
    cause = reason.split('msg: "')[-1].split(" at /")[0].strip("[ ")
    return f"zenoh.endpoint: cannot {role} to {address}: {one_line(redact(cause))}"
