"""Logging: plain lines by default, JSON lines on request. Standard library only."""

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
CLEAR_LINE = "\r\x1b[2K"  # terminal control: go to the start of the line and erase it
MAX_MESSAGE = 2000  # characters of a plain line

# Attributes that every log record has; all others are `extra` fields of the caller.
_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}
_seen: dict[Hashable, object] = {}  # key → marker of the first call of `first_time` with it


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options `--log-level` and `--log-json`."""
    parser.add_argument(
        "--log-level",
        choices=LEVELS,
        default="info",
        help="log messages of this level and of more severe levels",
    )
    parser.add_argument(
        "--log-json",
        action="store_true",
        help="write the log as JSON, one object a line (default: as text)",
    )


def setup(level: str = "info", as_json: bool = False, stream: TextIO | None = None) -> None:
    """Log to `stream` (default: stderr): `edge` at `level` and above, other libraries' warnings.

    A second call replaces the first.

    Raises:
        ValueError: The level is unknown. The message lists the choices.
    """
    if level not in LEVELS:
        raise ValueError(f"log level: unknown {level!r} (choices: {', '.join(LEVELS)})")
    stream = sys.stderr if stream is None else stream
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonFormatter() if as_json else HumanFormatter(stream.isatty()))
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("edge").setLevel(level.upper())


def first_time(key: Hashable) -> bool:
    """Return True for the first call with `key` in this process.

    >>> first_time("readme example"), first_time("readme example")
    (True, False)
    """
    marker = object()
    return _seen.setdefault(key, marker) is marker  # setdefault is atomic between threads


class HumanFormatter(logging.Formatter):
    """A formatter of plain lines: `12:34:56.789 warning mapping: text`.

    A record is one line without control characters. Only the traceback of an exception adds lines,
    which are indented.

    Args:
        terminal: Clear a progress line on the terminal before each record.
    """

    def __init__(self, terminal: bool = False) -> None:
        super().__init__()
        self._prefix = CLEAR_LINE if terminal else ""

    def format(self, record: logging.LogRecord) -> str:
        clock = datetime.fromtimestamp(record.created).strftime("%H:%M:%S.%f")[:-3]
        name = record.name.removeprefix("edge.")
        message = one_line(record.getMessage(), MAX_MESSAGE)
        text = f"{self._prefix}{clock} {record.levelname.lower():7} {name}: {message}"
        if record.exc_info:
            # Indented, so that no line of the exception's text looks like a log record.
            trace = printable_lines(self.formatException(record.exc_info))
            text += "\n" + textwrap.indent(trace, "    ")
        return text


class JsonFormatter(logging.Formatter):
    """A formatter of JSON lines: time (UTC, ISO 8601), level, logger, message, `extra` fields."""

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
        return line if line.isprintable() else "".join(map(_escape, line))


def _escape(char: str) -> str:
    """Return a character, escaped for JSON if it is not printable.

    Some non-printable characters, such as U+009B, control terminals.
    """
    return char if char.isprintable() else json.dumps(char)[1:-1]
