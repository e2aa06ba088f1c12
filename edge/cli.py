"""`edge`: run the service, simulate a robot for it, look after models, measure.

Thin: every command is a function of another module, and imports happen inside the handlers.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
import threading

from edge.errors import Stopped, UserError
from edge.logs import setup
from edge.parsers import make_parser
from edge.text import without_secrets

_PARENT_LOOK_S = 1.0


def main(argv: list[str] | None = None) -> int:
    """Entry point of the `edge` command; returns the exit code."""
    handlers = {"run": _run, "demo": _demo, "sim": _sim, "motion": _motion, "config": _config}
    args = make_parser(__doc__.splitlines()[0], handlers).parse_args(argv)
    setup(args.log_level, args.log_json)
    return _leave(_outcome(args))


def _outcome(args: argparse.Namespace) -> int:
    """The exit code of a command, its errors told."""
    try:
        return int(args.handler(args))
    except KeyboardInterrupt:
        return 130
    except Stopped:
        return 0
    except BrokenPipeError:  # whoever read the output has had enough, as `head` has
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except UserError as error:
        print(error, file=sys.stderr)
        return 2


def _leave(code: int) -> int:
    """The exit code; where a model is still being loaded, the process ends with it here and now.

    Its runtime would not survive the interpreter's end under its thread, and loading may take
    minutes (see `edge.perception.swap`).
    """
    if any(thread.name == "swap" for thread in threading.enumerate()):
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def stop_on_signals(parent: int | None = None) -> threading.Event:
    """An event that SIGINT and SIGTERM set.

    A second signal breaks off what is being done, children included; a third ends the process.

    Args:
        parent: set it too when this process is no longer the parent; one that was killed could
            not stop its children.
    """
    stop = threading.Event()

    def handle(signum: int, _frame: object) -> None:
        if stop.is_set():
            signal.signal(signum, signal.SIG_DFL)
            raise KeyboardInterrupt
        logging.getLogger("edge").info("%s: stopping", signal.Signals(signum).name)
        stop.set()

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
    if parent is not None:
        threading.Thread(target=_watch_parent, args=(parent, stop), daemon=True).start()
    return stop


def _watch_parent(parent: int, stop: threading.Event) -> None:
    while not stop.wait(_PARENT_LOOK_S):
        if os.getppid() != parent:
            logging.getLogger("edge").info("parent process is gone: stopping")
            stop.set()


def load_config(args: argparse.Namespace):  # type: ignore[no-untyped-def]
    """The configuration that a command names, with `--target` or `--mission` put in.

    A formula is no part of it: the configured translator is still there for later orders.
    """
    from edge.config import load

    environ = dict(os.environ)
    if (target := getattr(args, "target", None)) is not None:
        environ["EDGE__MISSION__TARGET"] = json.dumps(target)
        environ["EDGE__MISSION__INSTRUCTION"] = "null"
    elif (instruction := getattr(args, "mission", None)) is not None:
        environ["EDGE__MISSION__INSTRUCTION"] = json.dumps(instruction)
    return load(args.config, environ)


def _run(args: argparse.Namespace) -> int:
    from edge.commands import run_service

    config, stop, asked = load_config(args), stop_on_signals(), args.target or args.mission
    return run_service(config, stop, args.once, args.report, asked, args.formula)


def _demo(args: argparse.Namespace) -> int:
    from edge.commands import run_demo

    config, stop, asked = load_config(args), stop_on_signals(), args.target or args.mission
    return run_demo(config, stop, args.report, asked, args.formula)


def _sim(args: argparse.Namespace) -> int:
    from edge.commands import run_simulator

    stop = stop_on_signals(args.with_parent)
    return run_simulator(load_config(args), stop, motion=not args.no_motion)


def _motion(args: argparse.Namespace) -> int:
    from edge.motion.process import main as run_motion

    return run_motion(load_config(args), stop_on_signals(args.with_parent))


def _config(args: argparse.Namespace) -> int:
    from edge.config import Config

    if args.schema:
        print(json.dumps(Config.model_json_schema(), indent=2))
    else:
        shown = without_secrets(load_config(args).model_dump(mode="json"))
        print(json.dumps(shown, indent=2, ensure_ascii=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
