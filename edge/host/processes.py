"""Child processes and their resources, from Linux's /proc."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_PROC = Path("/proc")
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_MB_PER_KIB = 1.024e-3
# /proc/PID/stat: the end of the command's name, and indices of fields after it: state, parent, CPU
# time in user and system mode, start time.
_COMMAND_END = b")"
_STATE, _PARENT, _USER, _SYSTEM, _STARTED = 0, 1, 11, 12, 19


@dataclass(frozen=True, slots=True)
class Process:
    """A process. Its start time distinguishes it from a later process with the same pid.

    Attributes:
        started: start time in clock ticks of the kernel since the boot.
    """

    pid: int
    parent: int
    started: int
    command: str

    def is_running(self) -> bool:
        """Return True if the process is running; a zombie is not."""
        current = _read_process(self.pid)
        return current is not None and current.started == self.started


@dataclass(frozen=True, slots=True)
class Usage:
    """Present resources of a process.

    Attributes:
        memory_mb: resident memory without mapped files, including `shared_mb`.
        shared_mb: resident shared memory.
        descriptors: number of open descriptors.
        cpu_s: CPU time of all threads since the start.
    """

    memory_mb: float
    shared_mb: float
    threads: int
    descriptors: int
    cpu_s: float


def usage(pid: int) -> Usage | None:
    """Return the resources of a process; None if it has ended or is another user's."""
    folder = _PROC / str(pid)
    try:
        lines = (folder / "status").read_text(encoding="utf-8", errors="replace").splitlines()
        status = dict(line.split(":", 1) for line in lines)
        own_mb, shared_mb = (
            int(status[key].split()[0]) * _MB_PER_KIB for key in ("RssAnon", "RssShmem")
        )
        fields = _read_stat(pid)
        cpu_s = (int(fields[_USER]) + int(fields[_SYSTEM])) / _TICKS_PER_S
        descriptors = len(os.listdir(folder / "fd"))
    except (OSError, KeyError):  # KeyError: it has ended and has no memory
        return None
    return Usage(own_mb + shared_mb, shared_mb, int(status["Threads"]), descriptors, cpu_s)


def descendants(pid: int) -> list[Process]:
    """Return the running children, their children, and so on; parents come first."""
    children: dict[int, list[Process]] = {}
    for process in _running():
        children.setdefault(process.parent, []).append(process)
    found, new = [], list(children.get(pid, ()))
    while new:
        found += new
        new = [child for parent in new for child in children.get(parent.pid, ())]
    return found


def _running() -> Iterator[Process]:
    for name in os.listdir(_PROC):
        if name.isdecimal() and (process := _read_process(int(name))) is not None:
            yield process


def _read_process(pid: int) -> Process | None:
    """Return a process; None if it has ended."""
    try:
        fields = _read_stat(pid)
        command = (_PROC / str(pid) / "cmdline").read_bytes()
    except OSError:
        return None
    if fields[_STATE] in (b"Z", b"X"):  # a zombie, or dead
        return None
    words = command.replace(b"\0", b" ").decode("utf-8", "replace").strip()
    return Process(pid, int(fields[_PARENT]), int(fields[_STARTED]), words)


def _read_stat(pid: int) -> list[bytes]:
    """Return the fields after the command's name, which may contain any character."""
    content = (_PROC / str(pid) / "stat").read_bytes()
    return content.rpartition(_COMMAND_END)[2].split()
