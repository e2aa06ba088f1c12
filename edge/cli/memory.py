"""`edge memory`: what a running service has seen, and where.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from edge.cli.options import CONFIG, lazy_handler

ANSWER_S = 5.0


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge memory`."""
    memory = commands.add_parser("memory", help="where a running service has seen what")
    actions = memory.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    for do, text in (
        ("find", "where is it?"),
        ("list", "list all known objects"),
        ("export", "write all known objects as JSON, or the whole memory as GeoJSON"),
    ):
        action = actions.add_parser(do, help=text)
        action.add_argument("config", help=CONFIG)
        if do != "list":
            action.add_argument("name" if do == "find" else "file")
        if do == "export":
            action.add_argument(
                "--geojson",
                action="store_true",
                help="write objects, rooms, places and zones as GeoJSON",
            )
        else:
            action.add_argument("--json", action="store_true", help="print JSON")
        action.set_defaults(handler=lazy_handler("edge.cli.memory", "run"))


def run(args: argparse.Namespace) -> int:
    """Handle `edge memory`; `find` returns 1 if nothing of that name was seen.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
    """
    from edge.bus import client, topics
    from edge.config import load
    from edge.host.files import write_atomically
    from edge.memory import memory_geojson
    from edge.text import format_table, one_line

    settings = load(args.config).zenoh
    request = {"do": "find", "name": args.name} if args.do == "find" else {"do": "list"}
    with client.connect(settings, ANSWER_S, "service") as session:

        def ask(key: str, asked: dict) -> dict:
            return client.send_request(session, key, asked, ANSWER_S, "service")

        answer = ask(settings.key(topics.MEMORY_REQUEST), request)
        objects = written = answer["objects"]
        if args.do == "export" and args.geojson:
            site = ask(settings.key(topics.SITE_REQUEST), {"do": "list"})["site"]
            rooms = ask(settings.key(topics.MEMORY_REQUEST), {"do": "rooms"})["rooms"]
            written = memory_geojson(site, objects, rooms)
    if args.do == "export":
        write_atomically(Path(args.file), (json.dumps(written, indent=1) + "\n").encode())
        print(f"{args.file}: {answer['text']}")
    elif args.json:
        print(json.dumps(objects, indent=1))
    elif args.do == "find":
        print(one_line(answer["text"], 1000))
    elif objects:
        rows = [
            (
                one_line(one["name"]), f"{one['xyz'][0]:.2f}, {one['xyz'][1]:.2f}",
                f"{one['confidence']:.2f}", f"{one['age_s']:.0f}",
            )
            for one in objects
        ]  # fmt: skip
        print(format_table([("name", "x, y", "confidence", "age, s"), *rows], left=2))
    else:
        print("none")
    return 0 if objects or args.do != "find" else 1
