"""`edge room`: rooms that a running service knows, their names and zones.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
import json

from edge.cli.options import flag
from edge.cli.service_request import add_action, connected


def add_room(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge room`."""
    room = commands.add_parser("room", help="list, name or close the rooms of a running service")
    actions = room.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    for do, text in (
        ("list", "list the known rooms"),
        ("name", "name the room that the robot is in"),
        ("forget", "remove the name of a room"),
        ("keep-out", "forbid the robot to enter a room"),
        ("stay-inside", "forbid the robot to leave a room"),
    ):
        action = add_action(actions, do, text, "edge.cli.room")
        if do != "list":
            action.add_argument("name", help="name of the room")
        flag(action, "--json", "print the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Handle `edge room`.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
    """
    from edge.bus import topics

    with connected(args.config) as ask:
        topic = topics.MEMORY_REQUEST if args.do == "list" else topics.SITE_REQUEST
        answer = ask(topic, _request(args))
    if args.json:
        print(json.dumps(answer["rooms" if args.do == "list" else "site"], indent=1))
    elif args.do == "list":
        print(_table(answer["rooms"]) or "none")
    else:
        print(answer["text"])
    return 0


def _request(args: argparse.Namespace) -> dict:
    """Return the request of an action: `list` asks the memory, all others change the site."""
    if args.do == "list":
        return {"do": "rooms"}
    if args.do == "name":
        return {"do": "set", "kind": "room", "name": args.name}
    if args.do == "forget":
        return {"do": "remove", "name": args.name}
    return {"do": "set", "kind": args.do.replace("-", "_"), "room": args.name}


def _table(rooms: list[dict]) -> str:
    """Return the rooms as a table; "" for none."""
    from edge.text import format_table, one_line

    rows = [
        (
            str(room["id"]), one_line(room["name"]), " and ".join(room["kinds"]),
            f"{room['area_m2']:.1f}", f"{room['xy'][0]:.1f}, {room['xy'][1]:.1f}",
            " ".join(str(door["room"]) for door in room["doors"]), one_line(room["reason"]),
        )
        for room in rooms
    ]  # fmt: skip
    heading = ("room", "name", "kind", "m²", "x, y", "doors to", "because")
    return format_table([heading, *rows], left=7) if rows else ""
