"""The parsers of all commands: their arguments, and the functions that handle them.

Nothing expensive is imported here, so that `--help` and wrong options are answered at once. The
module of a command is imported when the command runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from edge import __version__
from edge.cli import eval_parsers, lab_parsers, memory, mission, model_parsers, room, site, stop
from edge.cli.options import (
    CONFIG,
    WHERE,
    Parser,
    config_argument,
    dispatch_on_option,
    flag,
    lazy_handler,
    port,
    positive,
    trust_option,
    unit_name,
)
from edge.errors import EXIT_CODES
from edge.logs import add_arguments


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `edge`."""
    parser = Parser(
        prog="edge", epilog=_exit_codes(),
        description="Run the navigation service or a simulated robot, manage models, measure.",
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"edge {__version__}")
    parser.set_defaults(trust_cache=False)
    add_arguments(parser)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in (
        _add_run, _add_demo, _add_sim, _add_config, _add_play, _add_mission, stop.add_stop,
        _add_fleet, site.add_places, site.add_zones, memory.add_memory, room.add_room,
        model_parsers.add_models, _add_record, _add_replay, _add_ros2_adapter, _add_mcp,
        lab_parsers.add_trajectory, lab_parsers.add_worlds, lab_parsers.add_bench,
        eval_parsers.add_eval, lab_parsers.add_soak, _add_doctor,
    ):  # fmt: skip
        add(commands)
    return parser


def _exit_codes() -> str:
    lines = [f"  {code:<4}{meaning}" for code, meaning in EXIT_CODES.items()]
    return "\n".join(["exit codes:", *lines, "  128+N interrupted by signal N"])


# fmt: off
def _add_run(commands) -> None:  # type: ignore[no-untyped-def]
    run = commands.add_parser(
        "run", help="run the service for a robot or simulator that is already running"
    )
    config_argument(run)
    _add_mission_options(run)
    flag(run, "--once", "exit when the mission has ended (default: keep running)")
    _add_report_option(run)
    flag(run, "--warm-up", "compile the kernels of the configuration for the first start, and exit")
    trust_option(run)
    _add_parent_option(run)
    group = run.add_argument_group("install as a systemd service that starts at boot")
    option = group.add_argument
    flag(group, "--install", "write the systemd unit; do not start the service")
    option("--name", type=unit_name, help="name of the unit (default: edge)")
    option("--user", help="user that runs the service (default: one that systemd creates, which "
           "cannot read home folders)")
    option("--out", metavar="FILE", help="file to write the unit to; `-` prints it (default: "
           "/etc/systemd/system/NAME.service, which needs root)")
    dispatch_on_option(
        run, "--install", on=lazy_handler("edge.cli.install_service"),
        on_only=("--name", "--user", "--out"), off=lazy_handler("edge.cli.main"),
        off_only=("--target", "--mission", "--formula", "--task", "--once", "--report",
                  "--warm-up"),
    )


def _add_report_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("--report", metavar="DIR", help="at the end, write a report (web page and "
                         "picture) to this folder (default: no report)")


def _add_demo(commands) -> None:  # type: ignore[no-untyped-def]
    demo = commands.add_parser(
        "demo", help="run the service with a simulated robot in a built-in house"
    )
    config_argument(demo, "demo")
    _add_mission_options(demo)
    demo.add_argument("--policy", metavar="KIND", help="use this policy (policy.kind); with the "
                      "configuration demo, also the scorer that it needs")
    demo.add_argument("--report", metavar="DIR", default="report",
                      help="folder for the report (default: ./%(default)s)")
    _add_live_option(demo)
    demo.set_defaults(handler=lazy_handler("edge.cli.main", "demo"))


def _add_mission_options(command: argparse.ArgumentParser) -> None:
    """Add the options that choose the mission.

    Without such an option, the checkpoint or the configuration has the mission.
    """
    option = command.add_mutually_exclusive_group().add_argument
    option("--target", metavar="NAME", help="mission: find this object, instead of mission.target "
           "of the configuration")
    option("--mission", metavar="TEXT", help="mission: this instruction in words")
    option("--formula", metavar="LTL",
           help="mission: this formula of linear temporal logic (LTL)")
    option("--task", metavar="TEXT", help="mission: a path in words: 'go around the left of the "
           "sofa, then stop at the desk'")
    mission.add_reading(command)


def _add_live_option(command: argparse.ArgumentParser) -> None:
    command.add_argument("--live", metavar="PORT", nargs="?", type=port, const=0, help="serve a "
                         "live view on this port until Ctrl-C (default port: http.port, else 7480, "
                         "else a free one; default: no live view)")
    trust_option(command)


def _add_sim(commands) -> None:  # type: ignore[no-untyped-def]
    sim = commands.add_parser("sim", help="run a simulated robot and the reference controller")
    config_argument(sim)
    kind = sim.add_mutually_exclusive_group()
    flag(kind, "--no-motion", "run only the simulated robot, for a controller of your own")
    flag(kind, "--motion-only", "run only the reference controller")
    _add_parent_option(sim)
    sim.set_defaults(handler=lazy_handler("edge.cli.main", "sim"))


def _add_parent_option(command: argparse.ArgumentParser) -> None:
    """Add the option for child processes: exit when the parent is gone, even if it was killed."""
    command.add_argument("--with-parent", type=int, metavar="PID", help=argparse.SUPPRESS)


def _add_config(commands) -> None:  # type: ignore[no-untyped-def]
    config = commands.add_parser(
        "config", help="print a configuration with its defaults, and check it"
    )
    config_argument(config, "demo")
    flag(config, "--schema", "print the JSON Schema of all keys; check nothing")
    config.set_defaults(handler=lazy_handler("edge.cli.main", "config"))


def _add_mission(commands) -> None:  # type: ignore[no-untyped-def]
    parser = commands.add_parser(
        "mission", help="start, pause, end or show a mission of a running service, or explain one"
    )
    explain = mission.add_arguments(parser).add_parser(
        "explain", help="show how a mission is understood and planned"
    )
    explain.add_argument("text", help="instruction in words, or a formula with --formula")
    kind = explain.add_mutually_exclusive_group()
    mission.add_formula(kind)
    mission.add_reading(kind)
    explain.add_argument("--config", default="demo", help=CONFIG)
    explain.add_argument("--draw", metavar="FILE",
                         help="draw the mission's automaton to this file (.svg or .png)")
    explain.set_defaults(handler=lazy_handler("edge.cli.explain"))


def _add_fleet(commands) -> None:  # type: ignore[no-untyped-def]
    fleet = commands.add_parser("fleet", help="list the robots of a fleet, or run its router")
    actions = fleet.add_subparsers(required=True, metavar="ACTION", title="actions")
    show = actions.add_parser("list", help="list all robots and their state")
    show.add_argument("config", metavar="CONFIG|ENDPOINT", help=WHERE)
    flag(show, "--json", "print the robots as JSON")
    flag(show, "--watch", "keep running, and print a line for each change")
    show.set_defaults(handler=lazy_handler("edge.cli.fleet", "show"))
    router = actions.add_parser(
        "router", help="run a Zenoh router for the robots, in place of zenohd"
    )
    router.add_argument("endpoint", nargs="?", default="tcp/127.0.0.1:7447",
                        help="Zenoh endpoint to listen on")
    router.add_argument("--file", metavar="FILE", help="Zenoh's own configuration file (JSON5), "
                        "such as config/secure/fleet-router.json5")
    _add_parent_option(router)
    router.set_defaults(handler=lazy_handler("edge.cli.fleet", "route"))


def _add_record(commands) -> None:  # type: ignore[no-untyped-def]
    record = commands.add_parser("record", help="record the sensors' messages to an MCAP file")
    config_argument(record)
    record.add_argument("--out", required=True, metavar="FILE",
                        help="MCAP file to write (required)")
    record.add_argument("--seconds", type=positive, default=60, metavar="N",
                        help="how long to record, in s")
    record.set_defaults(handler=lazy_handler("edge.sources.recording"))


def _add_play(commands) -> None:  # type: ignore[no-untyped-def]
    play = commands.add_parser("play", help="run the service on a recording of any robot (MCAP, "
                               "rosbag2), and print the results")
    play.add_argument("file", type=Path, metavar="FILE",
                      help="MCAP file, .db3 file, or folder of a rosbag2")
    config_argument(play)
    _add_mission_options(play)
    pace = play.add_mutually_exclusive_group()
    pace.add_argument("--rate", type=positive, default=1, metavar="N", help="speed of the "
                      "recording: 2 means twice real time; late frames are dropped, as on a robot")
    flag(pace, "--fast", "play as fast as possible, and drop no frame")
    _add_report_option(play)
    _add_live_option(play)
    play.set_defaults(handler=lazy_handler("edge.cli.main", "play"))


def _add_replay(commands) -> None:  # type: ignore[no-untyped-def]
    replay = commands.add_parser(
        "replay", help="run the service again on the inputs of a recorded run; compare the results"
    )
    replay.add_argument("file", metavar="FILE", help="first file of the recorded run; --trace also "
                        "takes the configuration of a running service, and reads the times from "
                        "its http.port")
    replay.add_argument("--config", help="replay with this configuration (default: the recorded "
                        f"one): {CONFIG}")
    flag(replay, "--detect", "run the detector on the recorded images (default: take the recorded "
         "detections)")
    flag(replay, "--trust", "load the plugins and files that the recorded configuration names; "
         "plugins can do all that you can, so use --trust only for recordings that you trust "
         "(default: refuse to load them)")
    instead = replay.add_argument_group("write a file instead")
    kind = instead.add_mutually_exclusive_group()
    flag(kind, "--trace",
         "write the times of all stages in all ticks to a file for ui.perfetto.dev")
    flag(kind, "--recover",
         "write a readable recording from a .partial file, which a crash left")
    instead.add_argument("--out", type=Path, metavar="FILE", help="file to write (default with "
                         "--trace: trace.json; with --recover: the recording's name without "
                         ".partial)")
    run, recover, trace = (
        lazy_handler("edge.recording.commands", name) for name in ("replay", "recover", "trace")
    )
    # Without --trace and --recover: `run`. Otherwise `write`, which chooses one of these two.
    write = dispatch_on_option(replay, "--trace", on=trace, on_only=(), off=recover, off_only=())
    dispatch_on_option(
        replay, "--trace or --recover", on=write, on_only=("--out",), off=run,
        off_only=("--config", "--detect", "--trust"),
    )


def _add_ros2_adapter(commands) -> None:  # type: ignore[no-untyped-def]
    adapter = commands.add_parser(
        "ros2-adapter", help="run the node that connects the robot's ROS 2 with the service"
    )
    config_argument(adapter, "ros2-adapter")
    flag(adapter, "--launch-file",
         "print the path of a launch file for `ros2 launch`; run nothing")
    adapter.set_defaults(handler=lazy_handler("edge.ros2_adapter.process"))


def _add_mcp(commands) -> None:  # type: ignore[no-untyped-def]
    mcp = commands.add_parser("mcp", help="serve an agent on standard input and output, or over "
                              "HTTP (Model Context Protocol)")
    config_argument(mcp)
    option = mcp.add_argument
    option("--http", type=port, metavar="PORT",
           help="serve agents over HTTP at this port; needs --token-file")
    option("--host", metavar="ADDRESS",
           help="with --http: address to listen on (default: 127.0.0.1)")
    option("--token-file", type=Path, metavar="FILE",
           help="with --http: file with the token that agents must send")
    option("--audit", type=Path, metavar="FILE", help="log of all calls, JSON lines (default: "
           "mcp-PREFIX.jsonl in the folder of the user's state)")
    option("--timeout", type=positive, default=30, metavar="S",
           help="how long to wait for each answer of the service, in s")
    mcp.set_defaults(handler=lazy_handler("edge.mcp_server.run"))


def _add_doctor(commands) -> None:  # type: ignore[no-untyped-def]
    doctor = commands.add_parser(
        "doctor", help="check that this machine has all that the service needs"
    )
    config_argument(doctor, "demo")
    flag(doctor, "--json", "print the findings as JSON")
    flag(doctor, "--live",
         "listen to the robot's sensors instead, and check their data; stop the service first")
    doctor.add_argument("--seconds", type=positive, default=10, metavar="N",
                        help="with --live: how long to listen, in s")
    doctor.set_defaults(handler=lazy_handler("edge.cli.doctor"))
# fmt: on
