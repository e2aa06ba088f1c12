"""`edge mission`: start, pause, resume, cancel and query missions of a service or a fleet.

The command line takes the arguments from here, so nothing expensive is imported.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from typing import Any

from edge.cli.options import CONFIG, WHERE, count, dispatch_on_option, flag, lazy_handler, positive
from edge.cli.service_request import ANSWER_S, connected
from edge.cli.site import pose
from edge.text import one_line

_ROW_CHARS = 1000
"""Longest line of the answer."""
NEW_S = 120.0
"""Time for the answer to `new`: a language model may be asked twice, and the mission compiled."""
PATIENCE_S = 10.0
"""Default time to wait for a lost robot of a fleet."""
_VERBS = {
    "new": "start a mission; it replaces the running one",
    "pause": "stop the robot, and keep the mission for `resume`",
    "resume": "continue the paused mission",
    "confirm": "confirm that the object the robot asks about is the target",
    "cancel": "end the running mission",
    "status": "show the state of the mission",
}


def add_arguments(parser: argparse.ArgumentParser):  # type: ignore[no-untyped-def]
    """Add a subcommand for each verb; return the subparsers, so that others can be added."""
    actions = parser.add_subparsers(dest="do", required=True, metavar="ACTION", title="actions")
    for verb, text in _VERBS.items():
        is_new = verb == "new"
        action = actions.add_parser(verb, help=text)
        option = action.add_argument
        option("config", help=f"{CONFIG}; with --fleet: {WHERE}")
        if is_new:
            option("text", help="instruction in words, such as 'find the sofa, then the bed'")
        else:
            option("robots", nargs="*", metavar="ROBOT",
                   help="with --fleet: names of the robots (default: all)")  # fmt: skip
        option("--timeout", type=_seconds, metavar="S", help="how long to wait for the answer, in "
               f"s (default: {NEW_S if is_new else ANSWER_S:g})")  # fmt: skip
        flag(action, "--json", "print the answer as JSON")
        flag(action, "--fleet", "send the request to the robots of a fleet (default: to one "
             "service)")  # fmt: skip
        only_service, only_fleet = _add_new(action) if is_new else ((), ("--robots",))
        handle_fleet = lazy_handler("edge.cli.fleet", "new" if is_new else "ask")
        dispatch_on_option(
            action, "--fleet", on=handle_fleet, on_only=only_fleet, off=run, off_only=only_service
        )
    return actions


# fmt: off
def _add_new(action: argparse.ArgumentParser) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Add the options of `new`; return those only without `--fleet`, and those only with it."""
    kind = action.add_mutually_exclusive_group()
    add_formula(kind)
    flag(kind, "--task", "read the text as a description of a path to drive")
    add_reading(kind)
    option = action.add_argument
    option("--rounds", type=count, metavar="N", help="do the mission N times (default: once)")
    option("--for", dest="for_s", type=positive, metavar="S",
           help="repeat the mission for S seconds (default: once)")
    option("--from-pose", type=pose, metavar="X,Y,DEG", help="position of the person for "
           "instructions such as `come here`: x and y in the map frame in m, heading in degrees")
    fleet = action.add_argument_group("with --fleet")
    whom = fleet.add_mutually_exclusive_group()
    whom.add_argument("--to", nargs="+", metavar="ROBOT", help="send the entire mission to each of "
                      "these robots (default: `any`, the free robot that knows most of the objects "
                      "and is nearest to them)")
    flag(whom, "--share",
         "divide the mission among several robots, if its parts are independent")
    flag(fleet, "--restart", "start the mission again, although it still runs (default: follow the "
         "running one)")
    fleet.add_argument("--patience", type=positive, metavar="S", help="give the part of a lost "
                       f"robot to another one after S seconds (default: {PATIENCE_S:g})")
    only_service = "--task", "--reading", "--from-pose", "--rounds", "--for", "--timeout"
    return only_service, ("--to", "--share", "--restart", "--patience")


def add_formula(parser: Any) -> None:
    """Add the option that makes the text a formula."""
    flag(parser, "--formula", "read the text as an LTL formula (default: as an instruction)")


def add_reading(parser: Any) -> None:
    """Add the option that chooses a reading of an ambiguous instruction."""
    parser.add_argument("--reading", type=count, metavar="N", help="for an ambiguous instruction: "
                        "number of the reading to use, as `edge mission explain` lists them "
                        "(default: refuse the instruction)")
# fmt: on


def run(args: argparse.Namespace) -> int:
    """Handle `edge mission new | pause | resume | cancel | status`.

    Raises:
        RequestError: no service is running, it does not answer, or it refuses.
        ConfigError: the configuration cannot be read.
    """
    from edge.bus import topics

    request = {"do": args.do}
    if args.do == "new":
        kind = "formula" if args.formula else "task" if args.task else "instruction"
        request[kind] = args.text
        if args.reading is not None:
            request["reading"] = args.reading
        repeat = {"rounds": args.rounds, "for_s": args.for_s}
        request |= {name: value for name, value in repeat.items() if value is not None}
        if args.from_pose is not None:
            x_m, y_m, heading_deg = args.from_pose
            request["from_pose"] = [x_m, y_m, math.radians(heading_deg)]
    timeout_s = args.timeout or (NEW_S if args.do == "new" else ANSWER_S)
    with connected(args.config, timeout_s, "mission") as ask:
        answer = ask(topics.MISSION_REQUEST, request)
    print(json.dumps(answer, indent=2) if args.json else as_text(answer))
    return 0


def as_text(answer: dict) -> str:
    """Return the answer as text: its `text`, or one line for each field of `_ROWS` that it has."""
    if isinstance(text := answer.get("text"), str):
        return one_line(text, _ROW_CHARS)
    rows = [(name, one_line(format_row(answer), _ROW_CHARS)) for name, format_row in _ROWS.items()]
    width = max(map(len, _ROWS)) + 2
    return "\n".join(f"{name + ':':{width}}{text}" for name, text in rows if text) or "done"


def _format_key(key: str, between: str = ", ") -> Callable[[dict], str]:
    """Return a function that formats the value of a key; a list is joined, None is empty.

    An empty entry is a step of a plan in which no object needs to be reached.
    """

    def format_value(answer: dict) -> str:
        value = answer.get(key)
        if isinstance(value, list):
            return between.join(str(entry) or "nothing for a step" for entry in value)
        return "" if value is None else str(value)

    return format_value


def _format_state(answer: dict) -> str:
    state, states = answer.get("state"), answer.get("states")
    known = isinstance(state, int) and isinstance(states, int)
    return f"{state} (of 0 … {states - 1})" if known else _format_key("state")(answer)


def _format_phase(answer: dict) -> str:
    paused = "paused (continue with `edge mission resume`)" if answer.get("paused") else ""
    return "; ".join(
        filter(None, [paused, _format_key("phase")(answer), _format_key("reason")(answer)])
    )


def _format_problems(answer: dict) -> str:
    """Return the reasons why the robot is not ready, as in `/readyz`."""
    robot = answer.get("robot")
    return _format_key("problems", "; ")(robot) if isinstance(robot, dict) else ""


def _format_reading(answer: dict) -> str:
    """Return the number of the reading that was chosen, such as `1 of 2`."""
    reading, readings = answer.get("reading"), answer.get("readings")
    return f"{reading} of {len(readings)}" if reading and isinstance(readings, list) else ""


def _format_overtaken(answer: dict) -> str:
    """Return the number (`overtaken`) of missions that the request cancelled before they began."""
    number = answer.get("overtaken")
    return f"{number} missions that were waiting to start" if number else ""


def _format_task(format_part: Callable[[dict], str]) -> Callable[[dict], str]:
    """Return a function that formats the task of an answer, if it has one."""

    def format_answer(answer: dict) -> str:
        task = answer.get("task")
        return format_part(task) if isinstance(task, dict) else ""

    return format_answer


def _format_formula(answer: dict) -> str:
    return "" if answer.get("task") else _format_key("formula")(answer)  # a task has none


def _format_trajectory(task: dict) -> str:
    length_m, driven_m, refinements = (
        task.get(key) for key in ("length_m", "driven_m", "refinements")
    )
    if not task.get("trajectory") or not _are_numbers(length_m, driven_m):
        return ""
    more = refinements - 1 if _are_numbers(refinements) else 0
    changed = f", refined again {more:g} times because the map changed" if more > 0 else ""
    return f"{driven_m:.1f} of {length_m:.1f} m driven{changed}"


def _format_steps(task: dict) -> str:
    """Return the state of each step, if there are several."""
    steps = task.get("steps")
    if not isinstance(steps, list) or len(steps) < 2:
        return ""
    valid = (step for step in steps if isinstance(step, dict))
    return "; ".join(f"{step.get('state')}: {step.get('said')}" for step in valid)


def _format_answers(task: dict) -> str:
    """Return the number of a model's answers, and the error of the newest one."""
    answers, rounds = task.get("answers"), task.get("rounds")
    if not _are_numbers(answers) or not answers:
        return ""
    newest = rounds[-1] if isinstance(rounds, list) and rounds else None
    error = newest.get("error") if isinstance(newest, dict) else None
    return f"{answers:g}" + (f", the newest: {error}" if error else "")


def _are_numbers(*values: object) -> bool:
    return all(type(value) in (int, float) for value in values)


# Name of a line → function that formats it from the answer; "" if the answer has no such data.
_ROWS: dict[str, Callable[[dict], str]] = {
    "stopped": _format_overtaken,
    "instruction": _format_key("instruction"),
    "understood": _format_key("english"),
    "reading": _format_reading,
    "formula": _format_formula,
    "warning": _format_key("warnings"),
    "state": _format_state,
    "phase": _format_phase,
    "not ready": _format_problems,
    "target": _format_key("target"),
    "why": _format_key("why"),
    "plan": _format_key("plan", ", then "),
    "known": _format_key("detected"),
    "reached": _format_key("reached"),
    "failed": _format_key("failed"),
    "forbidden": _format_key("forbidden"),
    "task": _format_task(_format_key("phase")),
    "steps": _format_task(_format_steps),
    "written by": _format_task(_format_key("writer")),
    "read as": _format_task(_format_key("understood")),
    "missing": _format_task(_format_key("missing")),
    "answers": _format_task(_format_answers),
    "trajectory": _format_task(_format_trajectory),
    "notes": _format_task(_format_key("notes", "; ")),
}


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 < value <= 3600:
        raise argparse.ArgumentTypeError(f"expected seconds, above 0 and at most 3600, got {text}")
    return value
