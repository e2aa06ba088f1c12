"""The limit of open files and connections of this process (`ulimit -n`)."""

from __future__ import annotations

import errno
import os
import resource

from edge.errors import UnavailableError

LEAST = 256
"""Lowest limit: a service with sensors, models and viewers has up to 100 files open."""
_WANTED = 4096
_SHORT = (errno.EMFILE, errno.ENFILE)


def raise_open_files_limit() -> None:
    """Raise the limit of this process, if that is permitted.

    Raises:
        UnavailableError: the limit is still below `LEAST`.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _WANTED if hard == resource.RLIM_INFINITY else min(hard, _WANTED)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        soft = most
    if soft != resource.RLIM_INFINITY and soft < LEAST:
        raise UnavailableError(
            f"this process may open {soft} files and connections, but needs {LEAST}: raise the "
            f"limit (`ulimit -n {_WANTED}`; LimitNOFILE={_WANTED} in a systemd unit; "
            f"--ulimit nofile={_WANTED} for a container)"
        )


def open_files_problem() -> str:
    """Return why no file can be opened now, in one line; "" if files can be opened."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    except OSError as error:
        if error.errno in _SHORT:
            return f"no file or connection can be opened ({error.strerror}; see `ulimit -n`)"
    return ""
