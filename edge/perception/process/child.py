"""The parts that the programs of all model processes share."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import os
import signal
import socket
import sys
from pathlib import Path
from typing import Any

from edge import logs
from edge.host.signals import show_stacks_on_signals
from edge.perception.process.wire import FrameView

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_FIRST_TO_GO = "1000"  # for the kernel when memory runs out: the robot can do without this process
_NO_MEMORY = ("failed to allocate memory", "bad_alloc", "bad allocation", "out of memory")


def begin() -> tuple[dict[str, Any], socket.socket, socket.socket, FrameView]:
    """Return what stdin told, the sockets `images` and `control`, and the shared images."""
    told = json.loads(sys.stdin.buffer.read())
    _end_with(told["parent"])
    faulthandler.enable()
    show_stacks_on_signals()
    logs.setup(told["log_level"], told["log_json"])
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_FIRST_TO_GO, encoding="ascii")
    images, control, frames = told["fds"]
    return told, socket.socket(fileno=images), socket.socket(fileno=control), FrameView(frames)


def _end_with(parent: int) -> None:
    """Have the kernel end this process with the thread that started it."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it had ended before
        sys.exit(1)


def by_kind(error: Exception) -> Exception:
    """Return MemoryError for a lack of memory: onnxruntime and CUDA have types of their own."""
    text = str(error).lower()
    return MemoryError(str(error)) if any(sign in text for sign in _NO_MEMORY) else error
