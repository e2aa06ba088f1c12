"""`edge fleet`, and `edge mission --fleet`: several robots that share one Zenoh router.

A mission of a fleet has one or several parts; one robot carries out each part.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import sys
import time
from collections.abc import Iterable, Mapping
from typing import Any

from edge.bus.client import RequestError
from edge.bus.session import zenoh_session
from edge.bus.zenoh_file import protocol
from edge.cli.mission import PATIENCE_S, as_text
from edge.cli.service_request import ANSWER_S
from edge.config import Config, MissionConfig, ZenohConfig, load, parse
from edge.errors import FAILED, UserError
from edge.fleet.dispatch import POLL_S, Dispatcher, FleetPlan, plan
from edge.fleet.orders import PartOutcome
from edge.fleet.roster import Robot, open_roster
from edge.host.signals import stop_on_signals
from edge.mission.spec import prepare
from edge.text import format_table, one_line

log = logging.getLogger("edge")

ANY = "any"  # value of --to: the dispatcher chooses the robot
_PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws", "unixsock-stream")
_CELL_CHARS = 40
"""Longest text in a cell of a table."""


def fleet_settings(name: str) -> tuple[ZenohConfig, MissionConfig]:
    """Return the sections zenoh and mission of a configuration, or defaults for an endpoint.

    An endpoint is that of a router, such as `tcp/10.0.0.1:7447`.

    Raises:
        ConfigError: the configuration cannot be read, or the endpoint is not allowed.
    """
    if protocol(name) in _PROTOCOLS and not os.path.exists(name):
        config = _defaults_with(endpoint=name, mode="client", prefix="robots/any")
    else:
        config = load(name)
    return config.zenoh, config.mission


def _defaults_with(**zenoh: str | None) -> Config:
    """Return the defaults with these keys of the section zenoh, from the command line."""
    sections = {"perception": {"detector": {"kind": "sim"}}, "zenoh": zenoh}
    return parse(sections, "command line")


# -- the list of robots ------------------------------------------------------------------------


def show(args: argparse.Namespace) -> int:
    """Handle `edge fleet list`."""
    if args.watch:
        return _watch(args)
    with open_roster(fleet_settings(args.config)[0]) as roster:
        robots = roster.ask_status()
    if args.json:
        print(json.dumps([_as_dict(robot) for robot in robots.values()], indent=2))
    else:
        print(table(robots.values()) if robots else f"no robot found (Zenoh keys {roster.pattern})")
    return 0


def table(robots: Iterable[Robot]) -> str:
    """Return a table with a line for each robot."""
    rows = [["robot", "phase", "mission", "target", "pose", "health", "reason"]]
    rows += [_shorten(_cells(robot).values()) for robot in robots]
    return format_table(rows)


def _shorten(cells: Iterable[str]) -> list[str]:
    """Shorten the cells, except for health and reason, which are shown in full."""
    *others, health, reason = cells
    return [*(one_line(cell, _CELL_CHARS) for cell in others), one_line(health), one_line(reason)]


def _cells(robot: Robot) -> dict[str, str]:
    """Return the row of a robot in the table: heading → text."""
    status = robot.status_reply
    if status is None:
        return {"robot": robot.name, **dict.fromkeys(("phase", "mission", "target", "pose"), "?"),
                "health": robot.problem, "reason": "-"}  # fmt: skip
    robot_state, idle = status.robot, status.phase == "idle"
    problems = [
        *robot_state.problems,
        *(["controller silent"] if robot_state.controller == "silent" else []),
    ]
    pose = "?" if robot_state.pose is None else "{:.1f} {:.1f} m {:.0f}°".format(
        *robot_state.pose[:2], math.degrees(robot_state.pose[2])
    )  # fmt: skip
    return {
        "robot": robot.name,
        "phase": status.phase,
        "mission": "-" if idle else status.instruction,
        "target": "-" if idle else status.target or "-",
        "pose": pose,
        "health": "; ".join(problems) or "ok",
        "reason": status.reason if status.phase in ("reached", "failed") else "-",
    }


def _as_dict(robot: Robot) -> dict[str, Any]:
    return {"robot": robot.name, "problem": robot.problem, "answer": robot.reply}


def _watch(args: argparse.Namespace) -> int:
    """Print a line for each change, until a signal comes."""
    stop = stop_on_signals()
    with open_roster(fleet_settings(args.config)[0]) as roster:
        before: dict[str, dict[str, str]] = {}
        online = True
        while not stop.is_set():
            robots = roster.complete_list()
            if (robots is not None) != online:
                online = robots is not None
                _say(
                    "connected to the router again"
                    if online
                    else "no connection to the router; trying again"
                )
            if robots is not None:
                before = _print_changes(before, robots, args.json)
            roster.wait(POLL_S)
    return 0


def _print_changes(
    before: Mapping[str, dict[str, str]], robots: Mapping[str, Robot], as_json: bool
) -> dict[str, dict[str, str]]:
    """Print the robots that have changed; return their present state, without poses."""
    now = {name: _cells(robot) for name, robot in robots.items()}
    state = {name: {k: v for k, v in cells.items() if k != "pose"} for name, cells in now.items()}
    for name in sorted(before.keys() | state.keys()):
        if before.get(name) == state.get(name):
            continue
        if as_json:
            gone = {"robot": name, "problem": "gone", "answer": None}
            print(json.dumps(_as_dict(robots[name]) if name in robots else gone), flush=True)
        else:
            cells = _shorten(state[name].values()) if name in state else [one_line(name), "gone"]
            _say("  ".join(cells))
    return state


# -- requests to the robots --------------------------------------------------------------------


def ask(args: argparse.Namespace) -> int:
    """Handle `edge mission status | pause | resume | cancel --fleet`.

    The request goes to the named robots, or to all. If no robots were named, a robot that refuses
    is no error: it may have no mission.
    """
    with open_roster(fleet_settings(args.config)[0]) as roster:
        found = roster.names()
        chosen = args.robots or found
        _check_names(chosen, found)
        answers = roster.ask(chosen, {"do": args.do}, args.timeout or ANSWER_S)
    if args.json:
        print(json.dumps([_as_dict(robot) for robot in answers.values()], indent=2))
    else:
        for robot in answers.values():
            answer = robot.problem if robot.reply is None else as_text(dict(robot.reply))
            print(f"{one_line(robot.name)}:", answer.replace("\n", "\n  "), sep="\n  ")
    failed = [robot for robot in answers.values() if robot.status_reply is None]
    if not args.robots:
        failed = [robot for robot in failed if not robot.problem.startswith("refused: ")]
    return os.EX_UNAVAILABLE if failed or not found else 0


def _check_names(names: Iterable[str], found: Iterable[str]) -> None:
    if unknown := sorted(set(names) - set(found)):
        raise RequestError(
            f"fleet: no robot {one_line(unknown[0])!r} is online (choices: "
            f"{one_line(', '.join(found)) or 'none'})"
        )


def new(args: argparse.Namespace) -> int:
    """Handle `edge mission new --fleet`; return 0 if all parts were reached, 1 if one failed.

    Raises:
        UserError: the mission is not understood, or a named robot was not found.
    """
    zenoh, mission_config = fleet_settings(args.config)
    text = {"formula" if args.formula else "instruction": args.text}
    spec = prepare(mission_config, **text)
    if spec.translation.repeat is not None:
        raise UserError(
            "fleet: a fleet cannot repeat a mission; send the mission to one robot, without --fleet"
        )
    named = [] if args.to in (None, [ANY]) else list(dict.fromkeys(args.to))
    if ANY in named:
        raise UserError(f"fleet: --to: got {ANY} and names; give either {ANY} or names of robots")
    with open_roster(zenoh) as roster:
        _check_names(named, roster.names())
        mission = plan(spec, roster.ask_status(), named, args.share, args.restart)
        _say(f"mission {mission.id}: {spec.translation.understood}")
        if mission.unsplit_reason:
            _say(f"mission not divided: {mission.unsplit_reason}; one robot gets all of it")
        dispatcher = Dispatcher(roster, mission, _say, args.patience or PATIENCE_S)
        try:
            outcomes = dispatcher.run()
        except KeyboardInterrupt:
            _say("the robots continue the mission; run the same command again to follow it")
            raise
    print(_result_text(mission, outcomes, dispatcher.ended_ns, args.json))
    reached = all(o.phase == "reached" for o in outcomes.values())
    return 0 if reached and len(outcomes) == len(mission.parts) else FAILED


def _result_text(
    mission: FleetPlan,
    outcomes: Mapping[str, PartOutcome],
    ended_ns: Mapping[str, int],
    as_json: bool,
) -> str:
    """Return the result of the mission and of its parts, as text or JSON."""
    not_begun = PartOutcome("failed", "", "no robot started it")
    rows = [
        (part, outcomes.get(part.id, not_begun), ended_ns.get(part.id)) for part in mission.parts
    ]
    phase = "failed" if any(o.phase == "failed" for _, o, _ in rows) else "reached"
    if as_json:
        parts = [
            {"id": part.id, "formula": part.formula, "english": part.english, "phase": o.phase,
             "by": o.by, "reason": o.reason, "ended_ns": ns}
            for part, o, ns in rows
        ]  # fmt: skip
        return json.dumps({"id": mission.id, "phase": phase, "parts": parts}, indent=2)
    lines = [["part", "outcome", "by", "at", "reason"]]
    lines += [
        [part.english, o.phase, o.by or "-", _clock(ns) if ns else "-", o.reason]
        for part, o, ns in rows
    ]
    cells = [[one_line(cell, 2 * _CELL_CHARS) for cell in line] for line in lines]
    return f"{phase}: mission {mission.id}\n{format_table(cells)}"


def _say(text: str) -> None:
    """Print a line with the time to stderr."""
    print(f"{_clock(time.time_ns())} {text}", file=sys.stderr, flush=True)


def _clock(ns: int) -> str:
    return time.strftime("%H:%M:%S", time.localtime(ns * 1e-9))


# -- the router ----------------------------------------------------------------------------------


def route(args: argparse.Namespace) -> int:
    """Handle `edge fleet router`; route messages until a signal comes."""
    stop = stop_on_signals(args.with_parent)
    settings = _defaults_with(endpoint=args.endpoint, file=args.file).zenoh
    with zenoh_session(settings, "route", stop):
        log.info("router: ready on %s", settings.address)
        stop.wait()
    return 0
