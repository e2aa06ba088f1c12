"""What `edge fleet` takes; see `edge.cli.fleet`."""

from __future__ import annotations

from edge.cli.options import lazy, positive

_WHERE = (
    "a configuration of one of the robots, or your own: its section zenoh counts; or an endpoint "
    "such as tcp/10.0.0.1:7447, where the robots' prefixes are robots/NAME"
)
_ROBOTS = "names; default: all that are there"
PATIENCE_S = 10.0


def add(commands) -> None:  # type: ignore[no-untyped-def]
    """`edge fleet` and its actions."""
    fleet = commands.add_parser("fleet", help="several robots over one router")
    actions = fleet.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    show = _action(actions, "list", "who is there, and how each stands", "show")
    show.add_argument("--watch", action="store_true", help="go on, with a line for each change")
    for verb, text in {
        "status": "how the robots' missions stand",
        "pause": "stop robots where they are",
        "resume": "go on after a pause",
        "cancel": "end robots' missions",
    }.items():
        action = _action(actions, verb, text, "ask")
        action.add_argument("robots", nargs="*", metavar="ROBOT", help=_ROBOTS)
    _new(actions)
    router = actions.add_parser("router", help="what the robots meet at, where no zenohd runs")
    router.add_argument("endpoint", nargs="?", default="tcp/127.0.0.1:7447",
                        help="to listen at (default: %(default)s)")  # fmt: skip
    router.add_argument("--file", metavar="FILE", help="Zenoh's own configuration (JSON5), such as "
                        "config/secure/fleet-router.json5")  # fmt: skip
    router.set_defaults(handler=lazy("edge.cli.fleet", "route"))


def _action(actions, name: str, text: str, function: str):  # type: ignore[no-untyped-def]
    action = actions.add_parser(name, help=text)
    action.add_argument("where", metavar="CONFIG|ENDPOINT", help=_WHERE)
    action.add_argument("--json", action="store_true", help="print JSON")
    action.set_defaults(handler=lazy("edge.cli.fleet", function))
    return action


def _new(actions) -> None:  # type: ignore[no-untyped-def]
    new = _action(actions, "new", "hand a mission out, and tell what becomes of it", "new")
    new.add_argument("text", help="an instruction for mission.translator of CONFIG")
    new.add_argument("--formula", action="store_true", help="TEXT is a formula (LTL)")
    whom = new.add_mutually_exclusive_group()
    whom.add_argument(
        "--to", nargs="+", metavar="ROBOT", help="all of it to each of these; `any`, the default: "
        "to the one free robot that knows most of what is asked for, and is nearest to it",
    )  # fmt: skip
    whom.add_argument(
        "--share", action="store_true", help="parts that do not depend on each other to several"
    )
    new.add_argument(
        "--anew", action="store_true", help="do not take up such a mission that is not over"
    )
    new.add_argument(
        "--patience", type=positive, default=PATIENCE_S, metavar="S", help="how long a robot that "
        "is gone is waited for before another gets its part (default: %(default)g)",
    )  # fmt: skip
