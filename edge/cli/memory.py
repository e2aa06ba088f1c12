"""`edge memory`: what a running service has seen, and where.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
import base64
import json
from pathlib import Path

from edge.cli.options import flag
from edge.cli.service_request import add_action, connected


def add_memory(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge memory`."""
    memory = commands.add_parser(
        "memory", help="show which objects a running service has seen, and where"
    )
    actions = memory.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    for do, text in (
        ("find", "show where an object was seen"),
        ("list", "list all known objects"),
        ("export", "write all known objects as JSON, or the entire memory as GeoJSON"),
        ("crop", "write the picture of an object, as JPEG"),
    ):
        action = add_action(actions, do, text, "edge.cli.memory")
        if do == "crop":
            action.add_argument("id", type=int, help="number of the object, as `list` shows it")
        if do != "list":
            is_find = do == "find"
            meaning = "name of the object" if is_find else "file to write"
            action.add_argument("name" if is_find else "file", help=meaning)
        if do == "export":
            flag(action, "--geojson", "write objects, rooms, places and zones as GeoJSON (default: "
                 "objects as JSON)")  # fmt: skip
        if do in ("find", "list"):
            flag(action, "--json", "print the objects as JSON")
        if do != "crop":
            action.add_argument("--room", help="only objects in the room with this name (default: "
                                "all rooms)")  # fmt: skip
            action.add_argument("--since", type=float, metavar="S", help="only objects seen in the "
                                "last S seconds (default: all)")  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Handle `edge memory`; `find` returns 1 if nothing of that name was seen.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
        FileError: the file cannot be written.
    """
    from edge.bus import topics
    from edge.host.files import save
    from edge.memory import memory_geojson
    from edge.text import format_table, one_line

    with connected(args.config) as ask:
        answer = ask(topics.MEMORY_REQUEST, _request(args))
        objects = content = answer.get("objects")  # `content`: what `export` writes
        if args.do == "export" and args.geojson:
            site = ask(topics.SITE_REQUEST, {"do": "list"})["site"]
            rooms = ask(topics.MEMORY_REQUEST, {"do": "rooms"})["rooms"]
            content = memory_geojson(site, objects, rooms)
    if args.do == "crop":
        save(Path(args.file), base64.b64decode(answer["jpeg_base64"]))
        print(f"{args.file}: {answer['text']}")
        return 0
    if args.do == "export":
        save(Path(args.file), (json.dumps(content, indent=1) + "\n").encode())
        print(f"{args.file}: {answer['text']}")
    elif args.json:
        print(json.dumps(objects, indent=1))
    elif args.do == "find":
        print(one_line(answer["text"], 1000))
    elif objects:
        rows = [
            (
                one_line(item["name"]), str(item["id"]), one_line(item["room"]) or "-",
                f"{item['xyz'][0]:.2f}, {item['xyz'][1]:.2f}",
                f"{item['confidence']:.2f}", f"{item['age_s']:.0f}",
            )
            for item in objects
        ]  # fmt: skip
        print(format_table([("name", "id", "room", "x, y", "confidence", "age, s"), *rows], left=3))
    else:
        print("none")
    return 0 if objects or args.do != "find" else 1


def _request(args: argparse.Namespace) -> dict[str, object]:
    """Return the request of an action; `export` asks for the list."""
    if args.do == "crop":
        return {"do": "crop", "id": args.id}
    request: dict[str, object] = (
        {"do": "find", "name": args.name} if args.do == "find" else {"do": "list"}
    )
    if args.room is not None:
        request["room"] = args.room
    if args.since is not None:
        request["since_s"] = args.since
    return request
