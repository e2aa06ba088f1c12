"""Errors that a user can cause, and the exit codes of `edge`.

The codes from 64 on are those of BSD's sysexits.h. systemd knows them by name.
"""

import os
from collections.abc import Mapping

FAILED = 1
"""Exit code of a failed mission or check."""
EXIT_CODES = {
    os.EX_OK: "done, or stopped by request",
    FAILED: "the mission failed, or a check did not pass",
    os.EX_USAGE: "the command line is wrong",
    os.EX_DATAERR: "an input cannot be used: an instruction, a world, a file",
    os.EX_UNAVAILABLE: "something is missing or in use: a model, a runtime, a port, a service",
    os.EX_SOFTWARE: "a bug in edge; the log shows where",
    os.EX_IOERR: "a file or disk cannot be read or written",
    os.EX_CONFIG: "the configuration or the environment is wrong",
}
"""Meaning of each code. In addition, 128 + N: signal N killed the process before it stopped."""
PERMANENT = (os.EX_USAGE, os.EX_DATAERR, os.EX_CONFIG)
"""Codes that the same command would return again. The service is not restarted after these."""


class UserError(Exception):
    """Base of the errors that a user can cause.

    The message is one line: what is wrong, where, and what to do.

    Attributes:
        exit_code: Exit code of the command that the error ends.
        details: More facts for programs, by name; JSON-ready.
    """

    exit_code = os.EX_DATAERR
    details: Mapping[str, object] = {}


class ConfigError(UserError):
    """An unusable configuration. The message names the file, the key and the choices."""

    exit_code = os.EX_CONFIG


class UnavailableError(UserError):
    """A missing model, runtime, port or service."""

    exit_code = os.EX_UNAVAILABLE


class FileError(UserError):
    """A file that cannot be read or written."""

    exit_code = os.EX_IOERR


class Stopped(UserError):  # noqa: N818 - a signal, no error
    """A request to stop that came during a wait. It is not a failure."""

    exit_code = os.EX_OK
