"""`edge fleet`; see `edge.cli.fleet`. What robots are told to do is `edge mission --fleet`."""

from __future__ import annotations

from edge.cli.options import WHERE, lazy


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """Add `edge fleet` and its actions."""
    fleet = commands.add_parser("fleet", help="several robots over one router")
    actions = fleet.add_subparsers(required=True, metavar="ACTION", title="actions")
    show = actions.add_parser("list", help="who is there, and how each stands")
    show.add_argument("config", metavar="CONFIG|ENDPOINT", help=WHERE)
    show.add_argument("--json", action="store_true", help="print JSON")
    show.add_argument("--watch", action="store_true", help="go on, with a line for each change")
    show.set_defaults(handler=lazy("edge.cli.fleet", "show"))
    router = actions.add_parser("router", help="what the robots meet at, where no zenohd runs")
    router.add_argument("endpoint", nargs="?", default="tcp/127.0.0.1:7447",
                        help="to listen at (default: %(default)s)")  # fmt: skip
    router.add_argument("--file", metavar="FILE", help="Zenoh's own configuration (JSON5), such as "
                        "config/secure/fleet-router.json5")  # fmt: skip
    router.set_defaults(handler=lazy("edge.cli.fleet", "route"))
