"""Loopback addresses and free TCP ports of this machine."""

from __future__ import annotations

import ipaddress
import random
import socket
from pathlib import Path

EPHEMERAL = Path("/proc/sys/net/ipv4/ip_local_port_range")
"""File with the range of ports for outgoing connections."""
FIRST = 20_000
"""Lowest port that `free_port` chooses."""
MOST_PORT = 65_535
"""Highest TCP port."""

_USUAL_EPHEMERAL = 32_768
_TRIES = 100  # ports


def is_loopback(host: str) -> bool:
    """Return True if only this machine can reach a server at this address or name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_free(host: str, port: int) -> bool:
    """Return True if a server could listen at this address now."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            # As servers do, so that a connection that was just closed does not block the port.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()  # with SO_REUSEADDR several sockets can bind, but only one can listen
    except (OSError, UnicodeError):  # UnicodeError: an invalid label in the host name
        return False
    return True


def free_port() -> int:
    """Return a free TCP port of 127.0.0.1.

    If possible, the port is below those of outgoing connections. So no connection takes it before
    the caller binds it.

    Raises:
        OSError: no port can be bound.
    """
    choices = range(FIRST, _ephemeral_from())
    # Not a seeded generator, which would give the same ports to many processes.
    rng = random.SystemRandom()
    for port in rng.sample(choices, min(_TRIES, len(choices))):
        try:
            return _bind_once(port)
        except OSError:
            continue
    return _bind_once(0)


def _ephemeral_from() -> int:
    """Return the first port that the kernel uses for outgoing connections."""
    try:
        return int(EPHEMERAL.read_text(encoding="ascii").split()[0])
    except (OSError, ValueError, IndexError):
        return _USUAL_EPHEMERAL


def _bind_once(port: int) -> int:
    """Bind a port (0: any), close it, and return its number."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", port))
        return int(probe.getsockname()[1])
