"""Detection of a second service with the same prefix, by liveliness tokens.

Every service holds the token `alive/<session>` below its prefix. Zenoh removes the token when the
service's connection is lost: at once if its process ended, after ten seconds if its computer or
network failed.

Two services with one prefix would both drive the robot. The second one is refused. It informs the
first with another token, `alive/<session>/refused`.
"""

from __future__ import annotations

import logging
import time
from typing import NoReturn

import zenoh

from edge.bus import topics
from edge.bus.session import BusError
from edge.config import ZenohConfig

log = logging.getLogger("edge.bus.presence")

ANSWER_S = 5.0
"""Time in seconds in which the router must list the services."""
_REFUSED = "refused"  # last part of the token of a service that was refused
_WARN_PERIOD_S = 60.0
_YIELD_S = 3.0  # longest wait for the other of two services to leave
_POLL_S = 0.1
_SETTLE_S = 0.25  # until all sessions see a new token


def online_sessions(session: zenoh.Session, pattern: str) -> dict[str, set[str]]:
    """Return the session ids of the services that are online, by prefix.

    Args:
        session: an open session.
        pattern: key expression of prefixes, such as `robots/*`.

    Raises:
        BusError: the router did not answer in time, so services may be missing.
    """
    found: dict[str, set[str]] = {}
    for reply in session.liveliness().get(f"{pattern}/{topics.ALIVE}/*", timeout=ANSWER_S):
        if reply.ok is None:
            raise BusError(
                f"{pattern}: the router did not list the services within {ANSWER_S:g} s; try again"
            )
        prefix, _, session_id = str(reply.ok.key_expr).rpartition(f"/{topics.ALIVE}/")
        found.setdefault(prefix, set()).add(session_id)
    return found


class Presence:
    """The liveliness token of one service, and a watch for others with the same prefix.

    Raises:
        BusError: another service with this prefix is online already.
    """

    def __init__(self, session: zenoh.Session, settings: ZenohConfig) -> None:
        self._session, self._settings = session, settings
        self._own = str(session.zid())
        self._key = f"{settings.prefix}/{topics.ALIVE}/{self._own}"
        self._token: zenoh.LivelinessToken | None = None
        self._warned_s = -_WARN_PERIOD_S
        self._subscriber: zenoh.Subscriber | None = None
        if self._others():
            self._refuse()

    def announce(self) -> None:
        """Declare the token: from now on the service accepts requests.

        Raises:
            BusError: another service with this prefix was faster.
        """
        self._token = self._session.liveliness().declare_token(self._key)
        # If two services start at the same moment, each sees the other. The one with the lower
        # session id waits until the other has left. If the other looked too early to see this
        # token, it stays; then this one leaves after `_YIELD_S`.
        until_s = time.monotonic() + _YIELD_S
        time.sleep(_SETTLE_S)
        while others := self._others():
            if min(others) < self._own or time.monotonic() >= until_s:
                self._token.undeclare()
                self._refuse()
            time.sleep(_POLL_S)
        # Subscribe only now: a session that has this subscription while it queries the tokens can
        # miss one of them.
        self._subscriber = self._session.liveliness().declare_subscriber(
            f"{self._settings.prefix}/{topics.ALIVE}/**", self._on_token, history=True
        )

    def close(self) -> None:
        """Remove the token and end the watch."""
        for declared in (self._subscriber, self._token):
            if declared is not None:
                declared.undeclare()

    def _others(self) -> set[str]:
        """Return the session ids of other services with this prefix."""
        found = online_sessions(self._session, self._settings.prefix)
        return found.get(self._settings.prefix, set()) - {self._own}

    def _refuse(self) -> NoReturn:
        """Inform the other service by a token, which vanishes with this session, and raise."""
        self._token = self._session.liveliness().declare_token(f"{self._key}/{_REFUSED}")
        raise BusError(
            f"zenoh.prefix: another service at {self._settings.address} has the prefix "
            f"{self._settings.prefix}: stop that service, or set another zenoh.prefix for this one"
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Log that there is another service, at most once a minute. Zenoh calls this method."""
        if sample.kind != zenoh.SampleKind.PUT or self._own in str(sample.key_expr):
            return
        if time.monotonic() - self._warned_s >= _WARN_PERIOD_S:
            self._warned_s = time.monotonic()
            refused = str(sample.key_expr).endswith(f"/{_REFUSED}")
            log.warning("zenoh.prefix: another service was started with the prefix %s: %s",
                        self._settings.prefix,
                        "that service ended" if refused else "stop one of the two")  # fmt: skip
