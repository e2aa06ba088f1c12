"""`edge place` and `edge zone`: places and zones of a running service.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

from edge.cli.options import flag
from edge.cli.service_request import add_action, connected


def add_places(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge place`."""
    place = commands.add_parser(
        "place", help="name, list, remove, export or import places of a running service"
    )
    actions = place.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    add = _action(actions, "set", "give a name to the robot's pose, or to the pose of --at")
    add.add_argument("name", help="name of the place")
    add.add_argument(
        "--at", type=pose, metavar="X,Y,DEG",
        help="pose: x and y in the map frame in m, heading in degrees; write --at=X,Y,DEG if X is "
        "negative (default: the robot's pose)",
    )  # fmt: skip
    _add_common_actions(actions)


def add_zones(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge zone`."""
    zone = commands.add_parser("zone", help="keep the robot out of an area, or inside an area")
    actions = zone.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    for kind, text in (
        ("keep-out", "keep the robot out of a polygon"),
        ("stay-inside", "keep the robot inside a polygon"),
    ):
        add = _action(actions, kind, text)
        add.add_argument("name", help="name of the zone; replaces a zone with the same name")
        add.add_argument(
            "corners", nargs="+", type=_corner, metavar="X,Y",
            help="at least three corners, x and y in the map frame in m; if an X is negative, "
            "write -- before the first corner",
        )  # fmt: skip
    _add_common_actions(actions)


def _action(actions, name: str, text: str):  # type: ignore[no-untyped-def]
    action = add_action(actions, name, text, "edge.cli.site")
    flag(action, "--json", "print the answer as GeoJSON")
    return action


def _add_common_actions(actions) -> None:  # type: ignore[no-untyped-def]
    """Add the actions that places and zones share."""
    _action(actions, "list", "list places and zones")
    remove = _action(actions, "remove", "remove a place or zone")
    remove.add_argument("name", help="name of the place or zone, as `list` shows it")
    export = _action(actions, "export", "write places and zones as GeoJSON")
    export.add_argument("file", help="GeoJSON file to write")
    load = _action(actions, "import", "read places and zones from GeoJSON")
    load.add_argument("file", help="GeoJSON file to read")
    flag(load, "--replace", "first remove all places and zones of the service")


def _numbers(text: str, count: int) -> tuple[float, ...]:
    """Parse numbers with commas between."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count or not all(map(math.isfinite, found)):
        raise argparse.ArgumentTypeError(
            f"expected {count} numbers with commas between, got {text!r}"
        )
    return found


def _corner(text: str) -> tuple[float, ...]:
    return _numbers(text, 2)


def pose(text: str) -> tuple[float, ...]:
    """Return x and y in metres and the heading in degrees from an option `X,Y,DEG`."""
    return _numbers(text, 3)


def run(args: argparse.Namespace) -> int:
    """Handle `edge place` and `edge zone`.

    Raises:
        RequestError: no service is there, it does not answer, or it refuses.
        SiteError: a file cannot be used.
        FileError: a file cannot be written.
        ConfigError: the configuration cannot be read.
    """
    from edge.bus import topics
    from edge.host.files import save
    from edge.memory import SiteError, read_site, site_of

    request = _request(args)
    if args.do == "import":
        path = Path(args.file)
        if not path.exists():
            raise SiteError(f"{path}: no such file; give a GeoJSON file, as `export` writes it")
        request["site"] = read_site(path, imported=True).geojson()
    with connected(args.config) as ask:
        answer = ask(topics.SITE_REQUEST, request)
    site = site_of(answer["site"], "the service's answer")
    if args.do == "export":
        save(Path(args.file), (json.dumps(site.geojson(), indent=1) + "\n").encode())
        print(f"{args.file}: {len(site.items)} places and zones")
    elif args.json:
        print(json.dumps(answer["site"], indent=1))
    elif args.do == "list":
        from edge.loop.requests.site_requests import describe_item

        print("\n".join(map(describe_item, site.items)) or "none")
    else:
        print(answer["text"])
    return 0


def _request(args: argparse.Namespace) -> dict:
    """Return the request of a command, without the site of a file."""
    if args.do in ("keep-out", "stay-inside"):
        ring = [list(corner) for corner in (*args.corners, args.corners[0])]
        feature = _feature(args, args.do.replace("-", "_"), "Polygon", [ring])
        return {"do": "set", "feature": feature}
    if args.do == "set" and args.at is not None:
        x_m, y_m, heading_deg = args.at
        feature = _feature(args, "place", "Point", [x_m, y_m])
        feature["properties"]["heading_deg"] = heading_deg
        return {"do": "set", "feature": feature}
    if args.do in ("set", "remove"):
        return {"do": args.do, "name": args.name}
    if args.do == "import":
        return {"do": "import", "replace": args.replace}
    return {"do": "list"}


def _feature(args: argparse.Namespace, kind: str, shape: str, coordinates: list) -> dict:
    geometry = {"type": shape, "coordinates": coordinates}
    properties = {"kind": kind, "name": args.name}
    return {"type": "Feature", "properties": properties, "geometry": geometry}
