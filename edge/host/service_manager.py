"""Notifications to systemd about this process (`sd_notify(3)`).

No library is used: those on the package index are not maintained, and a notification is one
datagram.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import MutableMapping

from edge.text import one_line

log = logging.getLogger("edge.host.service_manager")

_PINGS_PER_TIMEOUT = 4  # keep-alive pings per watchdog timeout
_STATUS_CHARS = 400


class SystemdNotifier:
    """Sender of notifications to `$NOTIFY_SOCKET`; without that variable it does nothing.

    Any thread may call any method. No method blocks: a notification is dropped if systemd's queue
    is full.

    Args:
        environ: the environment. The variables of systemd are removed from it, so that children do
            not send notifications.

    Attributes:
        ping_s: period of calls to `alive`; None: no watchdog.
    """

    def __init__(self, environ: MutableMapping[str, str] = os.environ) -> None:
        path = environ.pop("NOTIFY_SOCKET", "")
        watchdog_us, pid = environ.pop("WATCHDOG_USEC", ""), environ.pop("WATCHDOG_PID", "")
        is_for_us = pid in ("", str(os.getpid()))
        self.ping_s = (
            int(watchdog_us) * 1e-6 / _PINGS_PER_TIMEOUT
            if watchdog_us.isdecimal() and is_for_us
            else None
        )
        self._failure_logged = False
        self._socket: socket.socket | None = None
        if path[:1] in ("/", "@"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._address = f"\0{path[1:]}" if path[0] == "@" else path
        elif path:
            log.warning(
                "NOTIFY_SOCKET: %s: not a Unix socket, systemd gets no notifications",
                one_line(path),
            )

    def starting(self, what: str, patience_s: float) -> None:
        """Report a step of the start, which takes at most `patience_s`."""
        self._send(EXTEND_TIMEOUT_USEC=str(int(patience_s * 1e6)), STATUS=what)

    def ready(self) -> None:
        """Report the end of the start, or of a reload, also of a failed one."""
        self._send(READY="1")

    def reloading(self) -> None:
        """Report the start of a reload; call `ready` at its end."""
        self._send(RELOADING="1", MONOTONIC_USEC=str(time.monotonic_ns() // 1000))

    def stopping(self) -> None:
        """Report that the process is stopping."""
        self._send(STOPPING="1")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send(STATUS=text)

    def alive(self) -> None:
        """Ping the watchdog; without pings, systemd kills and restarts the process."""
        self._send(WATCHDOG="1")

    def _send(self, **fields: str) -> None:
        """Send one notification; log the first failure."""
        if self._socket is None:
            return
        lines = (f"{name}={one_line(text, _STATUS_CHARS)}" for name, text in fields.items())
        try:
            self._socket.sendto("\n".join(lines).encode(), socket.MSG_DONTWAIT, self._address)
        except OSError as error:
            if not self._failure_logged:
                self._failure_logged = True
                log.warning("NOTIFY_SOCKET: systemd was not notified (%s)", error.strerror)
