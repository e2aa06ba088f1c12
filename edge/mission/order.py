"""`edge mission`: give the running service a new mission, pause it, ask how it stands.

Light to import, so that the command line can take its arguments from here.
"""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from edge import asking

if TYPE_CHECKING:
    import zenoh

ANSWER_S = 5.0
NEW_S = 120.0  # a language model may be asked twice, and the mission compiled

_VERBS = {
    "new": "replace the mission that runs",
    "pause": "stop the robot where it is",
    "resume": "go on after a pause",
    "cancel": "end the mission that runs",
    "status": "how the mission stands",
}


def add_arguments(parser: argparse.ArgumentParser):  # type: ignore[no-untyped-def]
    """A subcommand for each verb of the desk; returns the subcommands, for others to add to."""
    actions = parser.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    for verb, text in _VERBS.items():
        action = actions.add_parser(verb, help=text)
        action.add_argument("config", help="YAML file, or the name of a ready configuration")
        if verb == "new":
            action.add_argument("text", help="an instruction for mission.translator")
            action.add_argument("--formula", action="store_true", help="TEXT is a formula (LTL)")
        action.add_argument(
            "--timeout", type=_seconds, metavar="S", default=NEW_S if verb == "new" else ANSWER_S,
            help="how long to wait for the answer; default: %(default)g",
        )  # fmt: skip
        action.add_argument("--json", action="store_true", help="print the answer as it came")
        action.set_defaults(handler=run)
    return actions


def run(args: argparse.Namespace) -> int:
    """Handle `edge mission new | pause | resume | cancel | status`.

    Raises:
        OrderError: no service is there, it does not answer, or it refuses (`edge.asking`).
        ConfigError: the configuration cannot be read.
    """
    from edge.config import load

    settings = load(args.config).zenoh
    request = {"do": args.do}
    if args.do == "new":
        request["formula" if args.formula else "instruction"] = args.text
    with asking.connect(settings, args.timeout, "mission") as session:
        answer = ask(session, settings.prefix, request, args.timeout)
    print(json.dumps(answer, indent=2) if args.json else as_text(answer))
    return 0


def ask(session: zenoh.Session, prefix: str, request: dict, timeout_s: float) -> dict:
    """Give an order to the service under `prefix`; its answer. See `edge.asking.ask` for errors."""
    from edge import topics

    return asking.ask(session, f"{prefix}/{topics.MISSION_REQUEST}", request, timeout_s, "mission")


def as_text(answer: dict) -> str:
    """A line for each thing that people ask for, of those that the answer tells."""
    rows = [(name, _phrase(tell(answer))) for name, tell in _ROWS.items()]
    width = max(map(len, _ROWS)) + 2
    return "\n".join(f"{name + ':':{width}}{text}" for name, text in rows if text) or "done"


def _phrase(value: object) -> str:
    if value is None:
        return ""
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _state(answer: dict) -> str | None:
    state, states = answer.get("state"), answer.get("states")
    return None if state is None else f"{state} (of 0 … {states - 1})" if states else str(state)


def _phase(answer: dict) -> str:
    paused = ["paused, `edge mission resume` goes on"] if answer.get("paused") else []
    return "; ".join(filter(None, [*paused, answer.get("phase"), answer.get("reason")]))


def _plan(answer: dict) -> str:
    return ", then ".join(step or "nothing for a step" for step in answer.get("plan") or ())


_ROWS = {
    "instruction": lambda answer: answer.get("instruction"),
    "understood": lambda answer: answer.get("english"),
    "formula": lambda answer: answer.get("formula"),
    "warning": lambda answer: answer.get("warnings"),
    "state": _state,
    "phase": _phase,
    "target": lambda answer: answer.get("target"),
    "why": lambda answer: answer.get("why"),
    "plan": _plan,
    "seen": lambda answer: answer.get("detected"),
    "reached": lambda answer: answer.get("reached"),
    "failed": lambda answer: answer.get("failed"),
    "forbidden": lambda answer: answer.get("forbidden"),
}


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 < value <= 3600:
        raise argparse.ArgumentTypeError(f"must be in (0, 3600], got {text}")
    return value
