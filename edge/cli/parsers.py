"""The command line as data: what each command takes, and which function does it.

Nothing heavy is imported here, so that `--help` and mistyped options are answered at once; a
command's module is imported when the command runs.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import NoReturn

from edge import __version__
from edge.cli import eval_parsers, memory, model_parsers, requests, site
from edge.cli.options import (
    CONFIG,
    WHERE,
    count,
    lazy,
    port,
    positive,
    seed,
    switched,
    unit_name,
)
from edge.errors import EXIT_CODES
from edge.logs import add_arguments

_TARGET = "what to find, in place of mission.target"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `edge`."""
    parser = _Parser(
        prog="edge", epilog=_exit_codes(), formatter_class=argparse.RawDescriptionHelpFormatter,
        description="run the service, simulate a robot for it, look after models, measure",
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"edge {__version__}")
    parser.set_defaults(trust_cache=False)
    add_arguments(parser)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in (
        _run,
        _demo,
        _sim,
        _config,
        _play,
        _mission,
        _fleet,
        site.add_places,
        site.add_zones,
        memory.add,
        model_parsers.add,
        _record,
        _replay,
        _ros2_adapter,
        _trajectory,
        _bench,
        eval_parsers.add,
        _soak,
        _doctor,
    ):
        add(commands)
    return parser


class _Parser(argparse.ArgumentParser):
    """Ends as `edge.errors.EXIT_CODES` says; so do the parsers of its commands."""

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        super().exit(os.EX_USAGE if status else os.EX_OK, message)


def _exit_codes() -> str:
    lines = [f"  {code:<4}{meaning}" for code, meaning in EXIT_CODES.items()]
    return "\n".join(["exit codes:", *lines, "  128+N broken off by signal N"])


def _run(commands) -> None:  # type: ignore[no-untyped-def]
    run = commands.add_parser("run", help="run the service on a robot's (or simulator's) sensors")
    run.add_argument("config", help=CONFIG)
    _what(run)
    run.add_argument("--once", action="store_true", help="exit when the mission is over")
    run.add_argument("--report", metavar="DIR", help="write a picture and a page there at the end")
    _trust(run)
    _with_parent(run)
    install = run.add_argument_group("write a systemd unit that runs it at boot")
    install.add_argument("--install", action="store_true", help="write it, and run nothing now")
    install.add_argument("--name", type=unit_name, help="of the unit (default: edge)")
    install.add_argument(
        "--user", help="run as this user; default: one that systemd makes up, and who can read "
        "no one's home folder"
    )  # fmt: skip
    install.add_argument(
        "--out", metavar="FILE", help="write it there; `-` prints it (default: "
        "/etc/systemd/system/NAME.service, which takes root)"
    )  # fmt: skip
    of_run = ("--target", "--mission", "--formula", "--task", "--once", "--report")
    at_boot, now = lazy("edge.cli.install_service", "run"), lazy("edge.cli.main", "run")
    switched(run, "--install", at_boot, ("--name", "--user", "--out"), now, of_run)


def _demo(commands) -> None:  # type: ignore[no-untyped-def]
    text = "simulator, controller and service in the built-in house"
    demo = commands.add_parser("demo", help=text)
    demo.add_argument("config", nargs="?", default="demo", help=f"{CONFIG} (default: demo)")
    _what(demo)
    text = "policy.kind; the configuration demo brings along what it goes by"
    demo.add_argument("--policy", metavar="KIND", help=text)
    demo.add_argument("--report", metavar="DIR", default="report", help="default: ./report")
    _live(demo)
    demo.set_defaults(handler=lazy("edge.cli.main", "demo"))


def _what(command: argparse.ArgumentParser) -> None:
    """What the mission is; nothing: as the configuration (or its checkpoint) says."""
    what = command.add_mutually_exclusive_group()
    what.add_argument("--target", metavar="NAME", help=_TARGET)
    what.add_argument("--mission", metavar="TEXT", help="an instruction in words")
    what.add_argument("--formula", metavar="LTL", help="a formula of linear temporal logic")
    text = "a way in words, as 'go around the left of the sofa, then stop at the desk'"
    what.add_argument("--task", metavar="TEXT", help=text)
    requests.add_reading(command)


def _live(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--live", metavar="PORT", nargs="?", type=port, const=0, help="show a page of what happens "
        "until Ctrl-C, on this port (default: http.port, else 7480, or a free one if it is taken)",
    )  # fmt: skip
    _trust(command)


def _trust(command: argparse.ArgumentParser) -> None:
    text = "do not hash model files again that were sound and have not been written since"
    command.add_argument("--trust-cache", action="store_true", help=text)


def _sim(commands) -> None:  # type: ignore[no-untyped-def]
    sim = commands.add_parser("sim", help="run the simulated robot (and the reference controller)")
    sim.add_argument("config", help=CONFIG)
    which = sim.add_mutually_exclusive_group()
    which.add_argument("--no-motion", action="store_true", help="bring another motion controller")
    which.add_argument("--motion-only", action="store_true", help="run the controller alone")
    _with_parent(sim)
    sim.set_defaults(handler=lazy("edge.cli.main", "sim"))


def _with_parent(command: argparse.ArgumentParser) -> None:
    """For children of another `edge`: end when it is gone, however it went."""
    command.add_argument("--with-parent", type=int, metavar="PID", help=argparse.SUPPRESS)


def _config(commands) -> None:  # type: ignore[no-untyped-def]
    config = commands.add_parser("config", help="check a configuration; print it or its schema")
    config.add_argument("config", nargs="?", default="demo", help=f"{CONFIG} (default: demo)")
    config.add_argument("--schema", action="store_true", help="print the JSON Schema")
    config.set_defaults(handler=lazy("edge.cli.main", "config"))


def _mission(commands) -> None:  # type: ignore[no-untyped-def]
    mission = commands.add_parser("mission", help="explain a mission; tell a running service")
    actions = requests.add_arguments(mission)
    explain = actions.add_parser("explain", help="what is understood, and how it is planned")
    explain.add_argument("text", help="an instruction in words")
    kind = explain.add_mutually_exclusive_group()
    kind.add_argument("--formula", action="store_true", help="TEXT is a formula (LTL)")
    requests.add_reading(kind)
    explain.add_argument("--config", default="demo", help=f"{CONFIG} (default: demo)")
    explain.add_argument("--draw", metavar="FILE", help="the automaton as .svg, .png or .dot")
    explain.set_defaults(handler=lazy("edge.cli.explain", "run"))


def _fleet(commands) -> None:  # type: ignore[no-untyped-def]
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


def _record(commands) -> None:  # type: ignore[no-untyped-def]
    record = commands.add_parser("record", help="write what the sensors send to an MCAP file")
    record.add_argument("config", help=CONFIG)
    record.add_argument("--out", required=True, metavar="FILE", help="the MCAP file to write")
    record.add_argument(
        "--seconds", type=positive, default=60.0, metavar="N", help="default: %(default)g"
    )
    record.set_defaults(handler=lazy("edge.sources.recording", "run"))


def _play(commands) -> None:  # type: ignore[no-untyped-def]
    text = "play a recording of any robot (MCAP, rosbag2) into the service; what comes of it"
    play = commands.add_parser("play", help=text)
    play.add_argument("file", type=Path, metavar="FILE", help="an MCAP file, a .db3, or the folder "
                      "of a rosbag2")  # fmt: skip
    play.add_argument("config", help=CONFIG)
    _what(play)
    pace = play.add_mutually_exclusive_group()
    pace.add_argument(
        "--rate", type=positive, default=1.0, metavar="N", help="times as fast as it was recorded; "
        "what is late is dropped, as on a robot (default: %(default)g)"
    )  # fmt: skip
    pace.add_argument(
        "--fast", action="store_true", help="as fast as it goes, and nothing is dropped for being "
        "late"
    )  # fmt: skip
    play.add_argument("--report", metavar="DIR", help="write a picture and a page there at the end")
    _live(play)
    play.set_defaults(handler=lazy("edge.cli.main", "play"))


def _replay(commands) -> None:  # type: ignore[no-untyped-def]
    replay = commands.add_parser(
        "replay", help="feed a recorded run through the service again, and compare what it says"
    )
    replay.add_argument(
        "file", metavar="FILE", help="the first file of the run; with --trace also the "
        "configuration of a running service, whose http.port is asked",
    )  # fmt: skip
    replay.add_argument("--config", help=f"another configuration than was recorded: {CONFIG}")
    replay.add_argument(
        "--detect", action="store_true", help="run the detector again on the recorded pictures"
    )
    replay.add_argument(
        "--trust",
        action="store_true",
        help="run the classes and read the files that the recorded configuration names: they run "
        "as your own programs do",
    )
    instead = replay.add_argument_group("write a file instead")
    kind = instead.add_mutually_exclusive_group()
    kind.add_argument(
        "--trace", action="store_true", help="every stage of every tick, for ui.perfetto.dev"
    )
    kind.add_argument(
        "--recover", action="store_true", help="a complete recording of one that was cut off"
    )
    instead.add_argument(
        "--out", type=Path, metavar="FILE",
        help="default: trace.json, or the recording's name without `.partial`",
    )  # fmt: skip
    mine = ("--config", "--detect", "--trust")
    of = {name: lazy("edge.recording.commands", name) for name in ("replay", "recover", "trace")}
    write = switched(replay, "--trace", of["trace"], (), of["recover"], ())
    switched(replay, "--trace or --recover", write, ("--out",), of["replay"], mine)


def _ros2_adapter(commands) -> None:  # type: ignore[no-untyped-def]
    adapter = commands.add_parser(
        "ros2-adapter", help="pass topics and goals between the robot's ROS 2 and the service"
    )
    adapter.add_argument("config", nargs="?", default="ros2-adapter", help=f"{CONFIG} "
                         "(default: %(default)s)")  # fmt: skip
    adapter.add_argument(
        "--launch-file", action="store_true", help="only print where the file for ros2 launch is"
    )
    adapter.set_defaults(handler=lazy("edge.ros2_adapter.process", "run"))


def _trajectory(commands) -> None:  # type: ignore[no-untyped-def]
    trajectory = commands.add_parser(
        "trajectory", help="from what a camera and a LiDAR show, and a sentence, to a trajectory"
    )
    option = trajectory.add_argument
    option(
        "place", metavar="PLACE", help="the folder of a SemanticKITTI sequence, or street:N, a "
        "built-in street of any number"
    )  # fmt: skip
    option("instruction", metavar="WORDS", help="such as 'go past the left of the van, then stop "
           "at the bench'")  # fmt: skip
    option(
        "--frames", type=int, nargs="+", default=[], metavar="N",
        help="of the sequence; the robot stands at the last (default: the first there is)",
    )  # fmt: skip
    option(
        "--objects", choices=("labels", "detector"), default="labels", help="who tells what is "
        "there: the labels of the data, or the configured detector (default: %(default)s)"
    )  # fmt: skip
    option("--config", default="street", help=f"{CONFIG} (default: %(default)s)")
    option("--url", help="a model writes it, on an OpenAI-compatible server: http://HOST:PORT/v1")
    option("--model", metavar="NAME", help="its name on that server")
    option(
        "--out", default="trajectory", metavar="DIR",
        help="for pictures, page and trajectory (default: ./%(default)s)",
    )  # fmt: skip
    trajectory.set_defaults(handler=lazy("edge.lab.eval.trial.command", "run", lab=True))


def _bench(commands) -> None:  # type: ignore[no-untyped-def]
    bench = commands.add_parser("bench", help="play a recorded run, print the latency table")
    bench.add_argument("config", nargs="?", default="cpu", help=f"{CONFIG} (default: cpu)")
    bench.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    service = bench.add_argument_group("the service")
    service.add_argument(
        "--seconds", type=positive, default=60.0, metavar="N", help="default: %(default)g"
    )
    service.add_argument(
        "--enforce", action="store_true", help="exit with 1 when a figure is over its budget"
    )
    service.add_argument(
        "--calibrate", action="store_true", help="only measure this computer, once, so that it is "
        "held to budgets of its own"
    )  # fmt: skip
    service.add_argument(
        "--recording", metavar="FILE", help="an MCAP file of your own; default: one that the "
        "seeded simulator makes on first use"
    )  # fmt: skip
    service.add_argument(
        "--swap", metavar="NAME", help="change to this model halfway: what that costs the loop"
    )
    _trust(bench)
    models = bench.add_argument_group("models, on the same frames").add_argument
    models(
        "--models", nargs="?", const="", metavar="FAMILY",
        help="compare the variants of a family; default: the configured detector's",
    )  # fmt: skip
    models("--images", type=Path, metavar="DIR", help="pictures; default: frames of a house")
    models("--frames", type=count, default=50, metavar="N", help="default: %(default)s")
    models("--providers", metavar="LIST", help="comma-separated; default: all that are here")
    models("--threads", type=count, metavar="N", help="default: as configured")
    models("--update-cards", action="store_true", help="write the figures into the cards")
    of_models = ("--images", "--providers", "--threads", "--update-cards")
    of_service = ("--enforce", "--calibrate", "--recording", "--swap", "--trust-cache")
    compare, service_ = lazy("edge.lab.bench.compare", "run"), lazy("edge.lab.bench.service", "run")
    switched(bench, "--models", compare, of_models, service_, of_service)


def _soak(commands) -> None:  # type: ignore[no-untyped-def]
    soak = commands.add_parser(
        "soak", help="run service and simulated robot for hours, through faults; what must hold"
    )
    soak.add_argument("config", nargs="?", default="soak", help=f"{CONFIG} (default: %(default)s)")
    option = soak.add_argument
    option(
        "--minutes", type=positive, default=120.0, metavar="N", help="how long (default: 120)"
    )  # fmt: skip
    option("--seed", type=seed, default=0, help="of faults and missions (default: %(default)s)")
    option(
        "--faults", metavar="NAME,NAME,…", help="only these (default: all of docs/soak.md that the "
        "configuration has a place for)"
    )  # fmt: skip
    option(
        "--out", type=Path, default=Path("soak"), metavar="FOLDER",
        help="for the record, the logs and the page (default: ./%(default)s)",
    )  # fmt: skip
    soak.set_defaults(handler=lazy("edge.lab.eval.soak.run", "run", lab=True))


def _doctor(commands) -> None:  # type: ignore[no-untyped-def]
    doctor = commands.add_parser("doctor", help="what this machine has, and what it lacks")
    doctor.add_argument(
        "config", nargs="?", default="demo", help="the configuration to run (default: demo)"
    )
    doctor.add_argument("--json", action="store_true", help="print findings as JSON")
    doctor.add_argument(
        "--live", action="store_true",
        help="listen to the robot's sensors, and say what is wrong with their data",
    )  # fmt: skip
    doctor.add_argument(
        "--seconds", type=positive, default=10.0, metavar="N",
        help="listen for so long (default: %(default)g)",
    )  # fmt: skip
    doctor.set_defaults(handler=lazy("edge.cli.doctor", "run"))
