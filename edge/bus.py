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
from typing import Literal

import zenoh

from edge import config
from edge.errors import Stopped, UserError
from edge.topics import Topic

log = logging.getLogger("edge.bus")

_ATTEMPT_MS = 500
_PAUSE_S = 0.2
_NOBODY = "Unable to connect to any of"

Role = Literal["listen", "connect"]

# A goal is small and rare: it goes ahead of bulk data, and at once. `BLOCK` may wait for seconds
# for a stopped subscriber, so only a sink's own thread may put such a topic.
_QOS: dict[str, dict] = {
    "drop": {
        "congestion_control": zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.BEST_EFFORT,
        "priority": zenoh.Priority.DATA,
        "express": False,
    },
    "block": {
        "congestion_control": zenoh.CongestionControl.BLOCK,
        "reliability": zenoh.Reliability.RELIABLE,
        "priority": zenoh.Priority.INTERACTIVE_HIGH,
        "express": True,
    },
}

_RETRY = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}


class BusError(UserError):
    """No session: one line that says which endpoint, why, and what to do."""


def session_config(settings: config.Zenoh, role: Role) -> zenoh.Config:
    """The Zenoh configuration of a process that plays `role`.

    With `mode: client` nobody listens: all connect to a router that runs elsewhere.
    """
    connects = role == "connect" or settings.mode == "client"
    values = {
        "mode": "client" if connects else "peer",
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": settings.shared_memory,
        "connect/endpoints": [settings.endpoint] if connects else [],
        "connect/timeout_ms": _ATTEMPT_MS,
        "connect/exit_on_failure": False,
        "connect/retry": _RETRY,
        "listen/endpoints": [] if connects else [settings.endpoint],
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
    }
    result = zenoh.Config()
    for key, value in values.items():
        result.insert_json5(key, json.dumps(value))
    return result


def open_session(
    settings: config.Zenoh, role: Role, stop: threading.Event | None = None
) -> zenoh.Session:
    """A session; the caller closes it (an unclosed one can hang the process's exit).

    Who connects waits here until there is somebody to connect to; a session that lost its peer
    finds it again by itself. Zenoh's own waiting cannot be interrupted, so it is done in short
    attempts, between which signals are heard.

    Args:
        stop: gives up waiting when it is set.

    Raises:
        BusError: the endpoint is taken or is no endpoint.
        Stopped: `stop` was set.
    """
    zenoh.try_init_log_from_env()
    stop = stop or threading.Event()
    told = False
    while True:
        try:
            return zenoh.open(session_config(settings, role))
        except zenoh.ZError as error:
            if _NOBODY not in str(error):
                raise BusError(_explain(settings.endpoint, role, str(error))) from None
        if not told:
            told = True
            log.info("waiting for somebody at %s", settings.endpoint)
        if stop.wait(_PAUSE_S):
            raise Stopped(f"zenoh.endpoint: stopped while nobody was at {settings.endpoint}")


def declare_publisher(session: zenoh.Session, topic: Topic, prefix: str) -> zenoh.Publisher:
    """A publisher with the congestion control, reliability and priority of the topic's QoS."""
    return session.declare_publisher(topic.under(prefix), **_QOS[topic.qos])


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
        self._subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(kept))

    def take(self) -> list[zenoh.Sample]:
        """What came since the last look, oldest first, `kept` at most; the rest can wait."""
        samples: list[zenoh.Sample] = []
        while len(samples) < self._kept:
            if (sample := self._subscriber.try_recv()) is None:
                break
            samples.append(sample)
        was_full, self._full = self._full, len(samples) == self._kept > 1
        if was_full and self._full:
            self._overrun()
        return samples

    def close(self) -> None:
        self._subscriber.undeclare()

    def _overrun(self) -> None:
        self.overruns += 1
        if self.overruns == 1:
            log.warning("%s: messages come faster than they are taken: %d a look, others are lost "
                        "(further such looks are only counted)", self._key, self._kept)  # fmt: skip


def _explain(endpoint: str, role: Role, reason: str) -> str:
    if "already in use" in reason:
        return (
            f"zenoh.endpoint: {endpoint} is in use: another service runs there; "
            "stop it, or give this one another port"
        )
    cause = reason.split(" at /")[0].strip("[ ")
    return f"zenoh.endpoint: cannot {role} to {endpoint}: {cause}"
