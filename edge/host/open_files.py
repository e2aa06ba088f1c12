"""How many files and connections this process may have open (`ulimit -n`)."""

from __future__ import annotations

import errno
import os
import resource

from edge.errors import UnavailableError

LEAST = 256
"""A service, its sensors, models and viewers have up to a hundred open."""
_WANTED = 4096
_SHORT = (errno.EMFILE, errno.ENFILE)


def claim() -> None:
    """Raise this process's limit where it may be raised.

    Raises:
        UnavailableError: the limit stays below `LEAST`.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = _WANTED if hard == resource.RLIM_INFINITY else min(hard, _WANTED)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        soft = most
    if soft != resource.RLIM_INFINITY and soft < LEAST:
        raise UnavailableError(
            f"this process may open {soft} files and connections, and needs {LEAST}: raise the "
            f"limit (`ulimit -n {_WANTED}`; LimitNOFILE={_WANTED} in a systemd unit; "
            f"--ulimit nofile={_WANTED} for a container)"
        )


def shortage() -> str:
    """Return why no file can be opened now, in one line; empty while one can."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
    except OSError as error:
        if error.errno in _SHORT:
            return f"no file or connection can be opened ({error.strerror}; see `ulimit -n`)"
    return ""
