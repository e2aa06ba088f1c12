"""Checks of `edge doctor` for the bus: Zenoh, its endpoint, and who can connect."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from importlib import metadata

from edge.cli.findings import Finding, fail, ok, warn
from edge.config import Config
from edge.host import resources

LOOPBACK_S = 5.0
"""Time for a message from Zenoh to Zenoh on this machine."""


def check_zenoh(config: Config) -> Iterator[Finding]:
    """Check that Zenoh can send a message on this machine."""
    version = metadata.version("eclipse-zenoh")
    took_ms = loopback_ms(LOOPBACK_S)
    if took_ms is not None:
        yield ok(f"Zenoh {version}: a test message over TCP on 127.0.0.1 took {took_ms:.0f} ms")
    else:
        todo = "allow TCP on 127.0.0.1: check sandbox and firewall, run `ip link set lo up`"
        yield fail(
            f"Zenoh {version}: no test message over TCP on 127.0.0.1 came within {LOOPBACK_S:g} s",
            todo,
        )


def loopback_ms(limit_s: float) -> float | None:
    """Send one message from a connecting to a listening Zenoh session over TCP on 127.0.0.1.

    Returns:
        The time from opening the sessions to the message, in ms; None: no message came.
    """
    import zenoh

    from edge.bus.session import open_session
    from edge.config import ZenohConfig
    from edge.host.ports import free_port

    before = time.perf_counter()
    settings = ZenohConfig(endpoint=f"tcp/127.0.0.1:{free_port()}")
    key = f"edge-doctor/{os.getpid()}"
    with open_session(settings, "listen") as receiver, open_session(settings, "connect") as sender:
        subscriber = receiver.declare_subscriber(key, zenoh.handlers.RingChannel(4))
        while time.perf_counter() - before < limit_s:
            sender.put(key, b"hello")  # repeated, until the subscription has reached the sender
            if subscriber.try_recv() is not None:
                return 1e3 * (time.perf_counter() - before)
            time.sleep(0.01)
    return None


def check_endpoint(config: Config) -> Iterator[Finding]:
    """Check that the service can listen at `zenoh.endpoint`."""
    from edge.bus.session import BusError, open_session

    address = config.zenoh.address
    if config.zenoh.mode == "client":
        yield ok(f"the service will connect to a Zenoh router at {address} (not tried)")
        return
    try:
        open_session(config.zenoh, "listen").close()
    except BusError as error:
        yield warn(f"the service cannot listen at {address} (zenoh.endpoint)", str(error))
    else:
        yield ok(f"the service can listen at {address}")


def check_access(config: Config) -> Iterator[Finding]:
    """Check who can connect to the service, and who can read the files with secrets."""
    from edge.bus.session import DENIED_WARNING, OPEN_WARNING, session_config, zenoh_file_of
    from edge.bus.zenoh_file import denies_prefix, exposed_secrets, open_addresses
    from edge.host.credentials import is_open_to_others, read_token

    settings, http = config.zenoh, config.http
    served = session_config(settings, "listen")
    for address in open_addresses(served):
        todo = "listen on 127.0.0.1, or require certificates (docs/security.md)"
        yield warn(OPEN_WARNING.format(address), todo)
    if denies_prefix(served, settings.prefix):
        todo = "correct the keys under access_control in zenoh.file (docs/security.md)"
        yield warn(DENIED_WARNING.format(settings.prefix), todo)
    paths = [
        path
        for role in ("listen", "connect")
        for path in exposed_secrets(session_config(settings, role), *zenoh_file_of(settings, role))
    ]
    if http.token_file is not None:
        read_token("http.token_file", http.token_file)
        if is_open_to_others(resources.expand(http.token_file)):
            paths.append(http.token_file)
    for path in dict.fromkeys(paths):
        what = f"{path} holds a secret, but every user of this machine can read or write it"
        yield warn(what, f"chmod o= {path}")
