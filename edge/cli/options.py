"""Types of options, and handlers that import their module when they are called."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module

from edge.errors import UnavailableError

Handler = Callable[[argparse.Namespace], int]

CONFIG = "YAML file, or the name of a ready configuration"


LAB_PACKAGES = ("matplotlib", "networkx", "scipy")
"""What `edge.lab` imports and the service does not: the extra `lab`."""


def lazy(module: str, function: str) -> Handler:
    """Return a handler that imports its module when it is called."""

    def handler(args: argparse.Namespace) -> int:
        with needs_lab():
            return getattr(import_module(module), function)(args)

    return handler


@contextmanager
def needs_lab() -> Iterator[None]:
    """Say in one line how to install the packages of `edge.lab` if one is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        name = (missing.name or "").partition(".")[0]
        if name not in LAB_PACKAGES:
            raise
        raise UnavailableError(
            f"{name} is not installed; it comes with: pip install 'edge-vln[lab]'"
        ) from missing


def positive(text: str) -> float:
    """An option's positive number."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be positive, got {text}")
    return value


def count(text: str) -> int:
    """An option's whole number, at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {text}")
    return value


def port(text: str) -> int:
    """An option's TCP port."""
    number = int(text)
    if not 1 <= number <= 65535:
        raise argparse.ArgumentTypeError(f"must be a port, 1 to 65535, got {text}")
    return number


def shares(text: str) -> tuple[float, ...]:
    """An option's probabilities above 0, each once."""
    try:
        values = tuple(dict.fromkeys(round(float(part), 6) for part in text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers such as 0.5,1, got {text!r}") from None
    for value in values:
        if not 0 < value <= 1:
            raise argparse.ArgumentTypeError(f"must be above 0 and at most 1, got {value:g}")
    return values


def seed(text: str) -> int:
    """An option's seed of random numbers."""
    value = int(text)
    if not 0 <= value < 1 << 63:
        raise argparse.ArgumentTypeError(f"must be between 0 and 2**63 - 1, got {text}")
    return value


def unit_name(text: str) -> str:
    """A name that a systemd unit and its folders may have."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", text):
        raise argparse.ArgumentTypeError(f"expected letters, digits, - and _, got {text!r}")
    return text


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
