"""Process with the Zenoh router of `edge soak`.

Run `python -m edge.lab.eval.soak.router ENDPOINT PARENT`; PARENT is a process id.
"""

from __future__ import annotations

import json
import sys

import zenoh

from edge.host.signals import stop_on_signals


def main(endpoint: str, parent: str) -> None:
    """Run the router until the parent process ends."""
    stop = stop_on_signals(int(parent))
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "scouting/multicast/enabled": False,
        "listen/endpoints": [endpoint],
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        stop.wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
