"""Logging: lines for people by default, JSON lines on request. Standard library only."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import textwrap
from collections.abc import Hashable
from datetime import datetime, timezone
from typing import Any, TextIO

from edge.text import one_line, printable_lines

LEVELS = ("debug", "info", "warning", "error")
CLEAR_LINE = "\r\x1b[2K"
MAX_MESSAGE = 2000  # characters of a line for people

_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
_seen: dict[Hashable, object] = {}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`--log-level` and `--log-json`."""
    parser.add_argument("--log-level", choices=LEVELS, default="info", help="default: info")
    parser.add_argument("--log-json", action="store_true", help="log JSON lines")


def setup(level: str = "info", as_json: bool = False, stream: TextIO | None = None) -> None:
    """Send what `edge` logs at `level` and above, and others' warnings, to `stream` (stderr).

    Called again, it replaces what it set up before.

    Raises:
        ValueError: unknown level; the message lists the choices.
    """
    if level not in LEVELS:
        raise ValueError(f"log level: unknown {level!r} (choices: {', '.join(LEVELS)})")
    stream = sys.stderr if stream is None else stream
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonFormatter() if as_json else HumanFormatter(stream.isatty()))
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("edge").setLevel(level.upper())


def once(key: Hashable) -> bool:
    """True the first time it is asked for `key` in this process.

    >>> once("readme example"), once("readme example")
    (True, False)
    """
    mine = object()
    return _seen.setdefault(key, mine) is mine  # setdefault is atomic between threads


class HumanFormatter(logging.Formatter):
    """`12:34:56.789 warning mapping: text`; wipes a progress line on a terminal first.

    Whatever a message quotes, it stays one line without control characters. Only the traceback of
    an exception has further lines, indented ones.
    """

    def __init__(self, terminal: bool = False) -> None:
        super().__init__()
        self._before = CLEAR_LINE if terminal else ""

    def format(self, record: logging.LogRecord) -> str:
        clock = datetime.fromtimestamp(record.created).strftime("%H:%M:%S.%f")[:-3]
        name = record.name.removeprefix("edge.")
        message = one_line(record.getMessage(), MAX_MESSAGE)
        text = f"{self._before}{clock} {record.levelname.lower():7} {name}: {message}"
        if record.exc_info:
            # Indented, so that no line of an exception's own words looks like one of the log's.
            trace = printable_lines(self.formatException(record.exc_info))
            text += "\n" + textwrap.indent(trace, "    ")
        return text


class JsonFormatter(logging.Formatter):
    """One object a line: time (UTC, ISO 8601), level, logger, message, `extra` fields."""

    def format(self, record: logging.LogRecord) -> str:
        fields: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, timezone.utc).isoformat(),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        extra = {key: value for key, value in vars(record).items() if key not in _STANDARD}
        if record.exc_info:
            fields["exception"] = self.formatException(record.exc_info)
        line = json.dumps({**extra, **fields}, default=str, ensure_ascii=False)
        return line if line.isprintable() else "".join(map(_escaped, line))


def _escaped(char: str) -> str:
    """JSON's escape of a character that does not print: some drive terminals, as U+009B does."""
    return char if char.isprintable() else json.dumps(char)[1:-1]
