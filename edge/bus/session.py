"""Opening a Zenoh session as this project's processes want it.

The service listens, everything else connects to it as a client: a listening peer passes messages
on between its clients, never between peers, so the simulator hears the controller only this way.
Multicast discovery is off: it is not to be relied on in containers and closed networks. A
connector that finds nobody keeps trying, for ever.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Literal

import zenoh

from edge import config
from edge.bus.topics import Qos, Topic
from edge.errors import Stopped, UnavailableError
from edge.host.interruptible import start_unjoined

log = logging.getLogger("edge.bus.session")

BLOCKED_S = 1.0
CLOSE_S = 2.0

_ATTEMPT_MS = 500
_PAUSE_S = 0.2
_NOBODY = "Unable to connect to any of"

Role = Literal["listen", "connect"]

# With a `BLOCK` message Zenoh waits, for up to 5 s, until its slowest receiver takes it. So does
# the session that passes it on between its clients, and its two receiving threads serve them all:
# one stopped viewer would make it deaf. Outside lockstep no topic may block. `DROP` leaves out only
# the receiver that is behind; what must arrive is sent again by whoever publishes it.
_URGENT: dict = {
    "reliability": zenoh.Reliability.RELIABLE,
    "priority": zenoh.Priority.INTERACTIVE_HIGH,
    "express": True,
}
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

_WAIT_BEFORE_CLOSE = "transport/link/tx/queue/congestion_control/block/wait_before_close"  # µs
_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}


class BusError(UnavailableError):
    """No session: one line that says which endpoint, why, and what to do."""


def session_config(settings: config.Zenoh, role: Role, exact: bool = False) -> zenoh.Config:
    """The Zenoh configuration of a process that plays `role`.

    With `mode: client` nobody listens: all connect to a router that runs elsewhere.

    Whoever takes nothing for `BLOCKED_S`, while something waits for it that must not be dropped
    (an answer to a request, or what another's peer publishes so), is let go; a client comes back by
    itself. Where it must be `exact`, Zenoh's 5 s are left.
    """
    connects = role == "connect" or settings.mode == "client"
    values = {
        "mode": "client" if connects else "peer",
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": settings.shared_memory,
        # Publishers that keep their last message for who comes late (`edge.bus.ros2`) want stamps.
        "timestamping/enabled": settings.mode == "client",
        "connect/endpoints": [settings.endpoint] if connects else [],
        "connect/timeout_ms": _ATTEMPT_MS,
        "connect/exit_on_failure": False,
        "connect/retry": _RETRY,
        "listen/endpoints": [] if connects else [settings.endpoint],
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
    }
    if not exact:
        values[_WAIT_BEFORE_CLOSE] = int(1e6 * BLOCKED_S)
    result = zenoh.Config()
    for key, value in values.items():
        result.insert_json5(key, json.dumps(value))
    return result


@contextmanager
def zenoh_session(
    settings: config.Zenoh, role: Role, stop: threading.Event | None = None, exact: bool = False
) -> Iterator[zenoh.Session]:
    """A session as from `open_session`, closed at exit however its peers do.

    For a peer that takes nothing, Zenoh's closing waits up to 12 s (it flushes, then lingers).
    After `CLOSE_S` it goes on in a thread, which nobody waits for (`edge.host.interruptible`).
    """
    opened = open_session(settings, role, stop, exact)
    try:
        yield opened
    finally:
        closing = start_unjoined("zenoh-close", _close, opened)
        closing.join(CLOSE_S)
        if closing.is_alive():
            log.warning("a peer at %s takes nothing: not waited for", settings.endpoint)


def _close(opened: zenoh.Session) -> None:
    with suppress(zenoh.ZError):  # it took longer than Zenoh's own limit
        opened.close()


def open_session(
    settings: config.Zenoh,
    role: Role,
    stop: threading.Event | None = None,
    exact: bool = False,
) -> zenoh.Session:
    """A session; the caller closes it (an unclosed one can hang the process's exit).

    Who connects waits here until there is somebody to connect to; a session that lost its peer
    finds it again by itself. Zenoh's own waiting cannot be interrupted, so it is done in short
    attempts, between which signals are heard.

    Args:
        stop: gives up waiting when it is set.
        exact: see `session_config`.

    Raises:
        BusError: the endpoint is taken or is no endpoint.
        Stopped: `stop` was set.
    """
    zenoh.try_init_log_from_env()
    stop = stop or threading.Event()
    told = False
    while True:
        try:
            return zenoh.open(session_config(settings, role, exact))
        except zenoh.ZError as error:
            if _NOBODY not in str(error):
                raise BusError(_explain(settings.endpoint, role, str(error))) from None
        if not told:
            told = True
            log.info("waiting for somebody at %s", settings.endpoint)
        if stop.wait(_PAUSE_S):
            raise Stopped(f"zenoh.endpoint: stopped while nobody was at {settings.endpoint}")


def declare_publisher(
    session: zenoh.Session, topic: Topic, settings: config.Zenoh
) -> zenoh.Publisher:
    """A publisher with the congestion control, reliability and priority of the topic's QoS."""
    return session.declare_publisher(settings.key(topic.key), **_QOS[topic.qos])


class Ring:
    """The newest messages of one key, for one thread, which takes a ring's worth a look.

    Until the ring is empty would be for ever where somebody sends faster than they are taken.

    Args:
        kept: messages that wait between two looks; the oldest is let go when one more comes.

    Attributes:
        overruns: looks that found the ring full once more. How many messages it had let go by
            then, or still has, nobody knows. Full once is whoever looks, late or just begun; and a
            ring of one is for what says the same again and again, of which none is missed.
    """

    def __init__(self, session: zenoh.Session, key: str, kept: int) -> None:
        self.overruns = 0
        self._full = False
        self._key, self._kept = key, kept
        self._arriving = self._declare(session, key, zenoh.handlers.RingChannel(kept))

    def take(self) -> list[zenoh.Sample]:
        """What came since the last look, oldest first, `kept` at most; the rest can wait."""
        samples: list[zenoh.Sample] = []
        while len(samples) < self._kept:
            if (sample := self._arriving.try_recv()) is None:
                break
            samples.append(sample)
        was_full, self._full = self._full, len(samples) == self._kept > 1
        if was_full and self._full:
            self._overrun()
        return samples

    def close(self) -> None:
        self._arriving.undeclare()

    def _declare(
        self, session: zenoh.Session, key: str, ring: zenoh.handlers.RingChannel
    ) -> zenoh.Subscriber:
        return session.declare_subscriber(key, ring)

    def _overrun(self) -> None:
        self.overruns += 1
        if self.overruns == 1:
            log.warning("%s: messages come faster than they are taken: %d a look, others are lost "
                        "(further such looks are only counted)", self._key, self._kept)  # fmt: skip


class QueryRing(Ring):
    """The same for the queries of one key; one that is let go ends without an answer."""

    def _declare(
        self, session: zenoh.Session, key: str, ring: zenoh.handlers.RingChannel
    ) -> zenoh.Queryable:
        return session.declare_queryable(key, ring)


def _explain(endpoint: str, role: Role, reason: str) -> str:
    if "already in use" in reason:
        return (
            f"zenoh.endpoint: {endpoint} is in use: another service runs there; "
            "stop it, or give this one another port"
        )
    cause = reason.split(" at /")[0].strip("[ ")
    return f"zenoh.endpoint: cannot {role} to {endpoint}: {cause}"
