"""What systemd is told of the process that it started, as in `sd_notify(3)`.

No library: those on the package index have not been kept up, and it takes one datagram.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import MutableMapping

from edge.text import one_line

log = logging.getLogger("edge.host.service_manager")

_SHARE = 4  # a sign of life is given so many times in the time that is allowed for one
_STATUS_CHARS = 400


class ServiceManager:
    """Speaks for this process to `$NOTIFY_SOCKET`; without one, nobody is told and nothing fails.

    Any thread may call any method, and none of them waits: what the manager has no room for is
    dropped.

    Args:
        environ: its variables for us are taken out, so that no child speaks in our name.

    Attributes:
        ping_s: how often `alive` is to be called; None where nobody watches.
    """

    def __init__(self, environ: MutableMapping[str, str] = os.environ) -> None:
        path = environ.pop("NOTIFY_SOCKET", "")
        watchdog_us, pid = environ.pop("WATCHDOG_USEC", ""), environ.pop("WATCHDOG_PID", "")
        meant = pid in ("", str(os.getpid()))
        self.ping_s = (
            int(watchdog_us) * 1e-6 / _SHARE if watchdog_us.isdecimal() and meant else None
        )
        self._told_of_failure = False
        self._socket: socket.socket | None = None
        if path[:1] in ("/", "@"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._address = f"\0{path[1:]}" if path[0] == "@" else path
        elif path:
            log.warning("NOTIFY_SOCKET: %s: no Unix socket, so nothing is told", one_line(path))

    def starting(self, what: str, patience_s: float) -> None:
        """It is not ready yet, and this takes `patience_s` at most."""
        self._tell(EXTEND_TIMEOUT_USEC=str(int(patience_s * 1e6)), STATUS=what)

    def ready(self) -> None:
        """The start is done, or a reload is, whatever came of it."""
        self._tell(READY="1")

    def reloading(self) -> None:
        """A reload has begun; it ends with `ready`."""
        self._tell(RELOADING="1", MONOTONIC_USEC=str(time.monotonic_ns() // 1000))

    def stopping(self) -> None:
        self._tell(STOPPING="1")

    def status(self, text: str) -> None:
        """The line that `systemctl status` shows."""
        self._tell(STATUS=text)

    def alive(self) -> None:
        """A sign of life: the process is killed and started again where these stay out."""
        self._tell(WATCHDOG="1")

    def _tell(self, **said: str) -> None:
        if self._socket is None:
            return
        lines = (f"{name}={one_line(text, _STATUS_CHARS)}" for name, text in said.items())
        try:
            self._socket.sendto("\n".join(lines).encode(), socket.MSG_DONTWAIT, self._address)
        except OSError as error:
            if not self._told_of_failure:
                self._told_of_failure = True
                log.warning("NOTIFY_SOCKET: not heard (%s)", error.strerror)
