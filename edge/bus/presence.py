"""Who is there: every service holds a liveliness token below its prefix, `alive/<session>`.

Zenoh takes it back as soon as the service's connection is gone, however it went: at once where its
process ended, after ten seconds where its computer or its network did.

Two services of one prefix would both drive the robot. The one that comes second is refused, and
lets the first know by another token, `alive/<session>/refused`.
"""

from __future__ import annotations

import logging
import time
from typing import NoReturn

import zenoh

from edge.bus import topics
from edge.bus.session import BusError
from edge.config import Zenoh

log = logging.getLogger("edge.bus.presence")

ANSWER_S = 5.0
_REFUSED = "refused"
_TELL_S = 60.0
_YIELD_S = 3.0
_LOOK_S = 0.1
_SETTLE_S = 0.25  # a token takes a moment to be seen by all


def prefixes(session: zenoh.Session, pattern: str) -> dict[str, set[str]]:
    """The services that are there, as their sessions, by prefix.

    Args:
        pattern: of prefixes, a key expression such as `robots/*`.

    Raises:
        BusError: the router did not say it in time: some may be missing.
    """
    found: dict[str, set[str]] = {}
    for reply in session.liveliness().get(f"{pattern}/{topics.ALIVE}/*", timeout=ANSWER_S):
        if reply.ok is None:
            raise BusError(f"{pattern}: the router did not say within {ANSWER_S:g} s who is there")
        prefix, _, who = str(reply.ok.key_expr).rpartition(f"/{topics.ALIVE}/")
        found.setdefault(prefix, set()).add(who)
    return found


class Presence:
    """A service's own.

    Raises:
        BusError: another service of this prefix is there already.
    """

    def __init__(self, session: zenoh.Session, settings: Zenoh) -> None:
        self._session, self._settings = session, settings
        self._own = str(session.zid())
        self._key = f"{settings.prefix}/{topics.ALIVE}/{self._own}"
        self._token: zenoh.LivelinessToken | None = None
        self._told_s = -_TELL_S
        self._heard: zenoh.Subscriber | None = None
        if self._others():
            self._refuse()

    def announce(self) -> None:
        """From now on the service takes requests.

        Raises:
            BusError: another one got there first.
        """
        self._token = self._session.liveliness().declare_token(self._key)
        # Of two that came at the same moment, and see each other, the lower session stays, once the
        # other has gone; one that looked before it could see us does not go.
        until_s = time.monotonic() + _YIELD_S
        time.sleep(_SETTLE_S)
        while others := self._others():
            if min(others) < self._own or time.monotonic() >= until_s:
                self._token.undeclare()
                self._refuse()
            time.sleep(_LOOK_S)
        # Not before: a session that listens now and then misses one when it looks.
        self._heard = self._session.liveliness().declare_subscriber(
            f"{self._settings.prefix}/{topics.ALIVE}/**", self._hear, history=True
        )

    def close(self) -> None:
        for declared in (self._heard, self._token):
            if declared is not None:
                declared.undeclare()

    def _others(self) -> set[str]:
        there = prefixes(self._session, self._settings.prefix)
        return there.get(self._settings.prefix, set()) - {self._own}

    def _refuse(self) -> NoReturn:
        """Let the other know, by a token that is gone with the session, and so with our start."""
        self._token = self._session.liveliness().declare_token(f"{self._key}/{_REFUSED}")
        raise BusError(
            f"zenoh.prefix: another service is {self._settings.prefix} at "
            f"{self._settings.address}: stop it, or give this one a prefix of its own"
        )

    def _hear(self, sample: zenoh.Sample) -> None:
        """Called by Zenoh; says once a minute at most that there is another one."""
        if sample.kind != zenoh.SampleKind.PUT or self._own in str(sample.key_expr):
            return
        if time.monotonic() - self._told_s >= _TELL_S:
            self._told_s = time.monotonic()
            refused = str(sample.key_expr).endswith(f"/{_REFUSED}")
            log.warning("zenoh.prefix: another service wants to be %s: %s", self._settings.prefix,
                        "it was refused" if refused else "stop one of the two")  # fmt: skip
