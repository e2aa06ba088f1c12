"""The limit of open files and connections of this process (`ulimit -n`)."""

from __future__ import annotations

import errno
import os
import resource

from edge.errors import UnavailableError

LEAST = 256
"""Lowest limit: a service with sensors, models and viewers has up to 100 files open."""
_TARGET = 4096  # the limit that is set
_NO_DESCRIPTOR = (errno.EMFILE, errno.ENFILE)


def raise_open_files_limit() -> None:
    """Raise the limit of this process, if that is permitted.

    Raises:
        UnavailableError: the limit is still below `LEAST`.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    target = _TARGET if hard == resource.RLIM_INFINITY else min(hard, _TARGET)
    if soft != resource.RLIM_INFINITY and soft < target:
        resource.setrlimit(resource.RLIMIT_NOFILE, (target, hard))
        soft = target
    if soft != resource.RLIM_INFINITY and soft < LEAST:
        raise UnavailableError(
            f"this process may open {soft} files and connections, but needs {LEAST}: raise the "
            f"limit (`ulimit -n {_TARGET}`; LimitNOFILE={_TARGET} in a systemd unit; "
            f"--ulimit nofile={_TARGET} for a container)"
        )


def open_files_problem() -> str:
    """Return why no file can be opened now, in one line; "" if files can be opened."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    except OSError as error:
        if error.errno in _NO_DESCRIPTOR:
            return f"no file or connection can be opened ({error.strerror}; see `ulimit -n`)"
    return ""
