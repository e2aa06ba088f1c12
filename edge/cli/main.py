"""The entry point of the command `edge`.

Every command is a function of another module, which its handler here imports.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import json
import logging
import os
import signal
import sys
from functools import partial

from edge.cli.parsers import make_parser
from edge.errors import Stopped, UserError
from edge.host.interruptible import any_detached_thread
from edge.host.kernel_cache import kernel_cache
from edge.host.nonblocking_stream import nonblocking_stderr
from edge.host.open_files import raise_open_files_limit
from edge.host.signals import (
    interrupt_on_signals,
    reload_on_sighup,
    show_stacks_on_signals,
    stop_on_signals,
)
from edge.logs import setup
from edge.text import printable_lines, redact

log = logging.getLogger("edge")


def main(argv: list[str] | None = None) -> int:
    """Run the command `edge` with these arguments, or the process's own; return its exit code."""
    args = make_parser().parse_args(argv)
    setup(args.log_level, args.log_json)
    # Python's last garbage collection at exit takes 0.3 s in a service.
    atexit.register(gc.freeze)
    if args.trust_cache:  # set in the environment, so that model processes inherit it
        from edge.perception.runtime.model_file import TRUST_CACHE

        os.environ[TRUST_CACHE] = "1"
    show_stacks_on_signals()
    interrupt_on_signals()
    return _exit_now_if_needed(_run_handler(args))


def _run_handler(args: argparse.Namespace) -> int:
    """Run the handler, print its error, and return the exit code (`edge.errors.EXIT_CODES`)."""
    try:
        with kernel_cache():
            return int(args.handler(args))
    except KeyboardInterrupt as interrupt:
        return 128 + (interrupt.args or (signal.SIGINT,))[0]
    except BrokenPipeError:  # the reader of the output has closed it, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except UserError as error:
        if not isinstance(error, Stopped):
            print(printable_lines(error), file=sys.stderr)
        return error.exit_code
    except OSError as error:
        where = error.filename or "unnamed file, device or connection"
        reason = error.strerror or error
        log.error(
            "%s: input or output failed: %s; check the path, its permissions and the free disk "
            "space", where, reason,
        )  # fmt: skip
        log.debug("the traceback of this error", exc_info=True)
        return os.EX_IOERR
    except Exception:
        log.exception("internal error of edge; please report it with this traceback")
        return os.EX_SOFTWARE


def _exit_now_if_needed(code: int) -> int:
    """Return the exit code, or exit here if a thread runs that must not be waited for.

    See `edge.host.interruptible`.
    """
    if any_detached_thread():
        try:
            logging.shutdown()
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # also after a signal or a full disk
            os._exit(code)
    return code


_DEMO_SCORERS = {
    "directional": ("EDGE__PERCEPTION__CHOICE", {"kind": "onnx", "card": "mini-house-choice"}),
    "vlfm": ("EDGE__PERCEPTION__SIMILARITY", "mini-house-similarity"),
}
"""Policy → the variable and value that set the scorer it needs in the demo house."""


def load_config(args: argparse.Namespace):  # type: ignore[no-untyped-def]
    """Return the configuration of a command, with its options of mission and policy applied.

    `--formula` is not applied, so that the configured translator can serve later requests.
    """
    from edge.config import load

    environ, options = dict(os.environ), dict[str, str]()  # options: variable → its option

    def set_variable(option: str, variable: str, value: object) -> None:
        environ[variable], options[variable] = json.dumps(value), option

    if (target := getattr(args, "target", None)) is not None:
        set_variable("--target", "EDGE__MISSION__TARGET", target)
        set_variable("--target", "EDGE__MISSION__INSTRUCTION", None)
    elif (instruction := getattr(args, "mission", None)) is not None:
        set_variable("--mission", "EDGE__MISSION__INSTRUCTION", instruction)
        # Otherwise the file's `reading` would apply to this instruction.
        set_variable("--mission", "EDGE__MISSION__READING", args.reading)
    elif (reading := getattr(args, "reading", None)) is not None:
        set_variable("--reading", "EDGE__MISSION__READING", reading)
    if (policy := getattr(args, "policy", None)) is not None:
        set_variable("--policy", "EDGE__POLICY", {"kind": policy})
        if args.config == "demo" and policy in _DEMO_SCORERS:
            key, scorer = _DEMO_SCORERS[policy]
            if key not in environ:
                set_variable("--policy", key, scorer)
    return load(args.config, environ, options)


def run(args: argparse.Namespace) -> int:
    """Handle `edge run`."""
    if args.warm_up:
        from edge.loop.warmup import warm_up

        print(f"kernels ready after {warm_up(load_config(args)):.0f} s")
        return 0
    raise_open_files_limit()
    # First of all, since the imports below take seconds.
    stop = stop_on_signals(args.with_parent)
    hung_up = reload_on_sighup()
    from edge.cli.commands import ReloadRequest, run_service

    with nonblocking_stderr():  # the loop writes to it and must not wait
        setup(args.log_level, args.log_json)
        reload = ReloadRequest(partial(load_config, args), hung_up)
        return run_service(
            load_config(args), stop, args.once, args.report, _mission_arguments(args), reload
        )


def _mission_arguments(args: argparse.Namespace) -> tuple[str | None, str | None, str | None]:
    """Return the mission of the command line; see `edge.cli.commands.MissionArguments`."""
    return args.target or args.mission, args.formula, args.task


def demo(args: argparse.Namespace) -> int:
    """Handle `edge demo`."""
    raise_open_files_limit()
    stop = stop_on_signals()
    from edge.cli.commands import run_demo

    return run_demo(load_config(args), stop, args.report, _mission_arguments(args), args.live)


def play(args: argparse.Namespace) -> int:
    """Handle `edge play`."""
    stop = stop_on_signals()
    from edge.cli.commands import run_play

    rate = None if args.fast else args.rate
    config = load_config(args)
    return run_play(config, args.file, stop, rate, args.report, args.live, _mission_arguments(args))


def sim(args: argparse.Namespace) -> int:
    """Handle `edge sim`."""
    raise_open_files_limit()
    stop = stop_on_signals(args.with_parent)
    if args.motion_only:
        from edge.lab.motion.process import main as run_motion

        return run_motion(load_config(args), stop)
    from edge.cli.commands import run_simulator

    return run_simulator(load_config(args), stop, motion=not args.no_motion)


def config(args: argparse.Namespace) -> int:
    """Handle `edge config`."""
    from edge.config import Config

    if args.schema:
        print(json.dumps(Config.model_json_schema(), indent=2))
        return 0
    config = load_config(args)
    shown = redact(config.model_dump(mode="json"))
    print(json.dumps(shown, indent=2, ensure_ascii=False))
    from edge.cli.preflight import check, check_mission

    check(config)
    check_mission(config)
    return 0
