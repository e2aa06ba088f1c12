"""A viewer of everything for the tests: `python viewer_peer.py ENDPOINT`.

It says `ready` when the service knows of it, and asks for the mission's status once for every
line that comes in.
"""

from __future__ import annotations

import sys

import zenoh

from edge.bus.session import open_session
from edge.config import ZenohConfig

KEY = "edge/mission/request"


def main(endpoint: str) -> None:
    # As on another machine: no large message goes through shared memory.
    session = open_session(ZenohConfig(endpoint=endpoint, shared_memory=False), "connect")
    ends = [session.declare_subscriber("edge/**", zenoh.handlers.RingChannel(8))]
    list(session.get(KEY))  # refused: it had no payload, and came after the declarations
    print("ready", flush=True)
    for _ in sys.stdin:
        ends.append(session.get(KEY, payload=b'{"do": "status"}'))


if __name__ == "__main__":
    main(*sys.argv[1:])
