"""Process that subscribes to all topics; `edge soak` stops it as a fault.

Run `python -m edge.lab.eval.soak.viewer ENDPOINT PREFIX PARENT`; PARENT is a process id.
"""

from __future__ import annotations

import sys

import zenoh

from edge.bus.session import zenoh_session
from edge.config import ZenohConfig
from edge.host.signals import stop_on_signals


def main(endpoint: str, prefix: str, parent: str) -> None:
    """Subscribe until the parent process ends."""
    stop = stop_on_signals(int(parent))
    # As on another machine, which large messages do not reach by shared memory.
    settings = ZenohConfig(endpoint=endpoint, prefix=prefix, shared_memory=False)
    with zenoh_session(settings, "connect", stop) as session:
        session.declare_subscriber(f"{prefix}/**", zenoh.handlers.RingChannel(8))
        stop.wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
