"""Types of options, and handlers that import their module when they are called."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NoReturn

from edge.errors import UnavailableError

Handler = Callable[[argparse.Namespace], int]

CONFIG = "YAML file, or the name of a built-in configuration, such as demo or turtlebot4"
"""Help of the argument that names a configuration."""
WHERE = (
    "a configuration whose zenoh.endpoint is the fleet's router, or that endpoint itself, such as "
    "tcp/10.0.0.1:7447 (for robots with zenoh.prefix robots/NAME)"
)
"""Help of the argument that names the router of a fleet."""


EXTRAS = {"lab": ("matplotlib", "networkx", "scipy"), "worlds": ("PIL", "collada", "trimesh")}
"""Extra → packages that it installs, and that commands of `edge.lab` import."""


class Parser(argparse.ArgumentParser):
    """A parser whose help shows defaults, and which exits with the codes of `edge.errors`."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, formatter_class=_HelpFormatter, **options)

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        super().exit(os.EX_USAGE if status else os.EX_OK, message)


class _HelpFormatter(argparse.RawDescriptionHelpFormatter, argparse.ArgumentDefaultsHelpFormatter):
    """Formatter that adds the default of an option, if it has one and its help does not name it."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        named = action.help is None or "(default" in action.help
        is_set = action.default not in (None, "", []) and action.default is not False
        return super()._get_help_string(action) if is_set and not named else action.help


def flag(command: Any, name: str, text: str) -> None:
    """Add an option without a value to a parser or a group of one."""
    command.add_argument(name, action="store_true", help=text)


def config_argument(command: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add the argument that names a configuration; without a default it is required."""
    nargs = None if default is None else "?"
    command.add_argument("config", nargs=nargs, default=default, help=CONFIG)


def lazy_handler(module: str, function: str = "run", extra: str = "") -> Handler:
    """Return a handler that imports its module when it is called.

    It raises UnavailableError if a package of `extra`, one of `EXTRAS`, is missing.
    """

    def handler(args: argparse.Namespace) -> int:
        require_extra(extra)
        return getattr(import_module(module), function)(args)

    return handler


def dispatch_on_option(
    parser: argparse.ArgumentParser,
    option: str, on: Handler, on_only: tuple[str, ...], off: Handler, off_only: tuple[str, ...],
) -> Handler:  # fmt: skip
    """Set the handler of a command, and return it: `on` if an option is given, else `off`.

    `option` may name several: "--trace or --recover". `on_only` are the options and arguments that
    are valid only with it, and `off_only` those that are valid only without it.
    """

    def handler(args: argparse.Namespace) -> int:
        # What was given, as options: `from_pose` is --from-pose, the argument `robots` is --robots.
        given = {f"--{name.replace('_', '-')}" for name, value in vars(args).items()
                 if value not in (None, False, [])}  # fmt: skip
        is_on = not given.isdisjoint(option.split(" or "))
        if wrong := given.intersection(off_only if is_on else on_only):
            parser.error(
                f"{min(wrong)}: {'not allowed' if is_on else 'allowed only'} with {option}"
            )
        return (on if is_on else off)(args)

    parser.set_defaults(handler=handler)
    return handler


def trust_option(command: argparse.ArgumentParser) -> None:
    """Add `--trust-cache`."""
    text = "start faster: skip the hash check of model files unchanged since their last check"
    flag(command, "--trust-cache", text)


def require_extra(extra: str) -> None:
    """Raise UnavailableError if a package of an extra is missing; "" needs none."""
    missing = [name for name in EXTRAS.get(extra, ()) if find_spec(name) is None]
    if missing:
        raise UnavailableError(
            f"{', '.join(missing)}: not installed, but needed by this command; run: pip install "
            f"'edge-vln[{extra}]'"
        )


def positive(text: str) -> float:
    """Parse a positive number."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"expected a number above 0, got {text}")
    return value


def count(text: str) -> int:
    """Parse an integer of at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected an integer from 1, got {text}")
    return value


def port(text: str) -> int:
    """Parse a TCP port."""
    number = int(text)
    if not 1 <= number <= 65535:
        raise argparse.ArgumentTypeError(f"expected a port from 1 to 65535, got {text}")
    return number


def probabilities(text: str) -> tuple[float, ...]:
    """Parse probabilities in (0, 1], separated by commas; duplicates are dropped."""
    try:
        values = tuple(dict.fromkeys(round(float(part), 6) for part in text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"expected probabilities such as 0.5,1, got {text!r}"
        ) from None
    for value in values:
        if not 0 < value <= 1:
            raise argparse.ArgumentTypeError(
                f"expected probabilities above 0 and at most 1, got {value:g}"
            )
    return values


def share(text: str) -> float:
    """Parse a share from 0 to 1."""
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"expected a number from 0 to 1, got {text}")
    return value


def seed(text: str) -> int:
    """Parse the seed of a random number generator."""
    value = int(text)
    if not 0 <= value < 1 << 63:
        raise argparse.ArgumentTypeError(f"expected an integer from 0 to 2**63 - 1, got {text}")
    return value


def unit_name(text: str) -> str:
    """Parse a name that is valid for a systemd unit and its folders."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", text):
        raise argparse.ArgumentTypeError(
            f"expected 1 to 64 letters, digits, - and _ (first a letter or digit), got {text!r}"
        )
    return text


def cores() -> int:
    """Return the number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
