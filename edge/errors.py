"""The base of errors that a user can cause, and what `edge` exits with.

The codes from 64 on are those of BSD's sysexits.h, which systemd knows by name.
"""

import os
from collections.abc import Mapping

FAILED = 1
EXIT_CODES = {
    os.EX_OK: "done, or told to stop",
    FAILED: "the mission failed, or what was checked did not pass",
    os.EX_USAGE: "the command line is wrong",
    os.EX_DATAERR: "what was given cannot be used: an instruction, a world, a file",
    os.EX_UNAVAILABLE: "something is not there: a model, a runtime, a port, a service",
    os.EX_SOFTWARE: "a fault of edge itself; what it logged tells where",
    os.EX_IOERR: "a file or disk cannot be read or written",
    os.EX_CONFIG: "the configuration or the environment is wrong",
}
"""What each code means. Besides these 128 + N: broken off by signal N before it could stop."""
WILL_NOT_MEND = (os.EX_USAGE, os.EX_DATAERR, os.EX_CONFIG)
"""Of these, those that the same command would end with again: a service is not restarted."""


class UserError(Exception):
    """Its message is one line: what is wrong, where, and what to do.

    Attributes:
        exit_code: of the command that it ends.
        details: what a program is told beside the message, by name; JSON-ready.
    """

    exit_code = os.EX_DATAERR
    details: Mapping[str, object] = {}


class ConfigError(UserError):
    """A configuration that cannot be used; the message names file, key and choices."""

    exit_code = os.EX_CONFIG


class UnavailableError(UserError):
    """Something that is needed is not there."""

    exit_code = os.EX_UNAVAILABLE


class FileError(UserError):
    """A file cannot be read or written."""

    exit_code = os.EX_IOERR


class Stopped(UserError):
    """Told to stop while waiting for something: no failure."""

    exit_code = os.EX_OK
