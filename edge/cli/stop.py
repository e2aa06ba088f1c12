"""`edge stop` and `edge release`: stop a robot until it is released.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
import json
import os

from edge.cli.options import config_argument, flag, lazy_handler
from edge.cli.service_request import connected
from edge.errors import FAILED


def add_stop(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge stop` and `edge release`."""
    stop = commands.add_parser(
        "stop", help="stop the robot of a running service until `edge release`, also over restarts"
    )
    config_argument(stop)
    stop.add_argument("--why", default="", metavar="TEXT", help="reason, for status and log")
    release = commands.add_parser("release", help="end a stop, so that the robot drives again")
    config_argument(release)
    for parser in (stop, release):
        flag(parser, "--json", "print the answer as JSON")
    stop.set_defaults(handler=lazy_handler("edge.cli.stop"))
    release.set_defaults(handler=lazy_handler("edge.cli.stop"), why=None)


def run(args: argparse.Namespace) -> int:
    """Handle `edge stop` and `edge release`; return 1 for a stop that a restart would forget.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
    """
    from edge.bus import topics

    stops = args.why is not None
    topic = topics.STOP_REQUEST if stops else topics.RELEASE_REQUEST
    with connected(args.config, what="stop" if stops else "release") as ask:
        answer = ask(topic, {"why": args.why} if args.why else {})
    print(json.dumps(answer, indent=2) if args.json else answer["text"])
    return FAILED if stops and not answer["kept"] else os.EX_OK
