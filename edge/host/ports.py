"""This machine's own addresses, and its free TCP ports."""

from __future__ import annotations

import ipaddress
import random
import socket
from pathlib import Path

EPHEMERAL = Path("/proc/sys/net/ipv4/ip_local_port_range")
FIRST = 20_000
MOST_PORT = 65_535

_USUAL_EPHEMERAL = 32_768
_TRIES = 100


def is_loopback(host: str) -> bool:
    """Whether what listens at this address, or name, can be reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_free(host: str, port: int) -> bool:
    """Return whether a server could listen at this address now."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            # As servers do: a connection that was just closed keeps no port.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()  # two sockets may be bound so, one may listen
    except (OSError, UnicodeError):  # UnicodeError: a label that no host name may have
        return False
    return True


def free_port() -> int:
    """A TCP port of 127.0.0.1 that nobody listens on now.

    It lies below those that the kernel gives to outgoing connections, where there is room, so
    that none of them takes it before the caller binds it.

    Raises:
        OSError: no port can be bound.
    """
    choices = range(FIRST, _ephemeral_from())
    # The system's chance, since a seeded one would give the same ports to many processes.
    chance = random.SystemRandom()
    for port in chance.sample(choices, min(_TRIES, len(choices))):
        try:
            return _bound(port)
        except OSError:
            continue
    return _bound(0)


def _ephemeral_from() -> int:
    """The first port that the kernel gives to an outgoing connection."""
    try:
        return int(EPHEMERAL.read_text(encoding="ascii").split()[0])
    except (OSError, ValueError, IndexError):
        return _USUAL_EPHEMERAL


def _bound(port: int) -> int:
    """The port that could be bound; 0 takes any."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", port))
        return int(probe.getsockname()[1])
