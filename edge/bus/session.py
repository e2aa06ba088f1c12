"""Opening a Zenoh session as this project's processes want it.

The service listens, everything else connects to it as a client: a listening peer passes messages
on between its clients, never between peers, so the simulator hears the controller only this way.
Multicast discovery is off: it is not to be relied on in containers and closed networks. A
connector that finds nobody, or is refused, keeps trying, for ever. It gives up after `HOST_S` if no
address is known for the endpoint's host.
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
from edge.bus.refusal import UnknownHostError, why_refused
from edge.bus.topics import Qos, Topic
from edge.bus.zenoh_file import (
    fault_of,
    get,
    lay_over,
    open_to,
    read_zenoh_file,
    shuts_all_out,
    unreadable,
)
from edge.errors import ConfigError, Stopped, UnavailableError
from edge.host.interruptible import start_unjoined
from edge.text import one_line, without_secrets

log = logging.getLogger("edge.bus.session")

CLOSE_S = 2.0
HOST_S = 30.0
"""A computer that is just starting may have no name service yet."""
OPEN = "{} is open: whoever reaches it may command the robot; see docs/security.md"
SHUT = "access_control allows nothing below {}/ (zenoh.prefix): nobody is heard or told anything"
ENVELOPE_BYTES = 65536
"""More than Zenoh puts around a message: its key, an attachment, what it was sent with."""

_PAUSE_S = 0.2
_NO_CONFIGURATION = ",zenoh::api::session=info,zenoh::net::runtime::orchestrator=info"
_NOBODY = "Unable to connect to any of"

Role = Literal["listen", "connect", "route"]

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


class BusError(UnavailableError):
    """No session: one line that says which endpoint, why, and what to do."""


class NotTakenIn(Stopped):
    """Told to stop while there was no session yet.

    Attributes:
        refused: why whoever is at the endpoint takes no session; None: nobody was there.
        unknown: why no address is known for the endpoint's host; None: one is known.
    """

    def __init__(self, address: str, refused: str | None, unknown: str | None = None) -> None:
        while_what = f"nobody was at {address}" if refused is None else f"refused at {address}"
        super().__init__(f"zenoh.endpoint: stopped while {while_what}")
        self.refused, self.unknown = refused, unknown


def session_config(
    settings: config.Zenoh, role: Role, exact: bool = False, most_bytes: int | None = None
) -> zenoh.Config:
    """The Zenoh configuration of a process that plays `role`: Zenoh's own file, and our settings
    over it (see `edge.bus.zenoh_file`).

    With `mode: client` nobody listens: all connect to a router that runs elsewhere, or in a process
    that plays `route`.

    Whoever takes nothing for a second, while something waits for it that must not be dropped
    (an answer to a request, or what another's peer publishes so), is let go; a client comes back by
    itself. Where it must be `exact`, Zenoh's 5 s are left.

    Args:
        most_bytes: see `edge.bus.zenoh_file.lay_over`.

    Raises:
        ConfigError: the file cannot be read, or says another mode.
        BusError: the endpoint is none.
    """
    if (fault := fault_of(settings.endpoint)) is not None:
        raise BusError(_explain(settings.address, role, fault))
    key, name = zenoh_file_of(settings, role)
    listens = role == "route" or (role == "listen" and settings.mode == "peer")
    mode = "router" if role == "route" else "peer" if listens else "client"
    found = read_zenoh_file(key, name)
    try:
        return lay_over(
            found, mode, settings.endpoint, listens, settings.shared_memory, exact, most_bytes
        )
    except ConfigError as error:
        raise ConfigError(f"{key}: {name}: {error}") from None
    except zenoh.ZError as error:
        raise BusError(_explain(settings.address, role, str(error))) from None


def check_settings(settings: config.Zenoh, role: Role) -> None:
    """Refuse settings that no session could be opened with, whoever is at the endpoint.

    Raises:
        ConfigError, BusError: see `session_config`; a file with a certificate or a password cannot
            be read.
    """
    found = session_config(settings, role)
    if (lacks := unreadable(found, listens=bool(get(found, "listen/endpoints")))) is not None:
        raise BusError(_explain(settings.address, role, lacks))


def zenoh_file_of(settings: config.Zenoh, role: Role) -> tuple[str, str | None]:
    """The key that names the Zenoh configuration file of a role, and the file, if there is one."""
    if role != "connect" or settings.client_file is None:
        return "zenoh.file", settings.file
    return "zenoh.client_file", settings.client_file


@contextmanager
def zenoh_session(
    settings: config.Zenoh,
    role: Role,
    stop: threading.Event | None = None,
    exact: bool = False,
    most_bytes: int | None = None,
    tell: Callable[[str], None] = lambda what: None,
) -> Iterator[zenoh.Session]:
    """A session as from `open_session`, closed at exit however its peers do.

    For a peer that takes nothing, Zenoh's closing waits up to 12 s (it flushes, then lingers).
    After `CLOSE_S` it goes on in a thread, which nobody waits for (`edge.host.interruptible`).
    """
    opened = open_session(settings, role, stop, exact, most_bytes, tell)
    try:
        yield opened
    finally:
        if sys.is_finalizing():  # whoever opened it never left: no thread would begin any more
            _close(opened)
        else:
            closing = start_unjoined("zenoh-close", _close, opened)
            closing.join(CLOSE_S)
            if closing.is_alive():
                log.warning("a peer at %s takes nothing: not waited for", settings.address)


def _close(opened: zenoh.Session) -> None:
    with suppress(zenoh.ZError):  # it took longer than Zenoh's own limit
        opened.close()


def open_session(
    settings: config.Zenoh,
    role: Role,
    stop: threading.Event | None = None,
    exact: bool = False,
    most_bytes: int | None = None,
    tell: Callable[[str], None] = lambda what: None,
) -> zenoh.Session:
    """A session; the caller closes it (an unclosed one can hang the process's exit).

    Who connects waits here until there is somebody to connect to; a session that lost its peer
    finds it again by itself. Zenoh's own waiting cannot be interrupted, so it is done in short
    attempts, between which signals are heard.

    Args:
        stop: gives up waiting when it is set.
        exact, most_bytes: see `session_config`.
        tell: is told again and again what is waited for.

    Raises:
        ConfigError: Zenoh's own file cannot be used.
        BusError: the endpoint is taken or is no endpoint, or no address is known for its host.
        NotTakenIn: `stop` was set.
    """
    _init_zenoh_log()
    stop = stop or threading.Event()
    found = session_config(settings, role, exact, most_bytes)
    key, name = zenoh_file_of(settings, role)
    for address in open_to(found):
        log.warning("zenoh.endpoint: %s", OPEN.format(address))
    if role != "route" and shuts_all_out(found, settings.prefix):
        log.warning("%s: %s", key, SHUT.format(settings.prefix))
    told: set[str | None] = set()
    before: str | None = None
    known_s = time.monotonic()  # when the host's name was last known
    while True:
        try:
            return zenoh.open(found)
        except zenoh.ZError as error:
            if _NOBODY not in str(error):
                lacks = unreadable(found, listens=bool(get(found, "listen/endpoints")))
                cause = str(error) if lacks is None else lacks
                raise BusError(_explain(settings.address, role, cause)) from None
        refused = unknown = None
        try:
            refused = why_refused(settings.endpoint, found, name or key)
            known_s = time.monotonic()
        except UnknownHostError as error:
            unknown = str(error)
        level, what = logging.WARNING, f"refused at {settings.address}: {refused}; trying on"
        if unknown is not None:
            what = f"zenoh.endpoint: {settings.address}: {unknown}"
            if time.monotonic() - known_s >= HOST_S:
                raise BusError(f"{what}; correct it, or give an address")
            what += f"; trying for {HOST_S:g} s"
        elif refused is None:
            level, what = logging.INFO, f"waiting for somebody at {settings.address}"
        tell(what)
        # Who is just starting, or busy, refuses once.
        why = unknown or refused
        if why not in told and why == before:
            told.add(why)
            log.log(level, what)
        before = why
        if stop.wait(_PAUSE_S):
            raise NotTakenIn(settings.address, refused, unknown)


def declare_publisher(
    session: zenoh.Session, topic: Topic, settings: config.Zenoh
) -> zenoh.Publisher:
    """A publisher with the congestion control, reliability and priority of the topic's QoS."""
    return session.declare_publisher(settings.key(topic.key), **_QOS[topic.qos])


def _init_zenoh_log() -> None:
    """Let Zenoh log as `RUST_LOG` says, but not its configuration: that may hold a password."""
    if (asked := os.environ.get("RUST_LOG")) and not asked.endswith(_NO_CONFIGURATION):
        os.environ["RUST_LOG"] = asked + _NO_CONFIGURATION
    zenoh.try_init_log_from_env()


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


def _explain(address: str, role: Role, reason: str) -> str:
    if "already in use" in reason:
        return (
            f"zenoh.endpoint: {address} is in use: another service runs there; "
            "stop it, or give this one another port"
        )
    cause = reason.split('msg: "')[-1].split(" at /")[0].strip("[ ")
    return f"zenoh.endpoint: cannot {role} to {address}: {one_line(without_secrets(cause))}"
