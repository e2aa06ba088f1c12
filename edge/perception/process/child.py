"""Start of a model process: code that the programs of all model processes share."""

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
# If memory runs out, the kernel kills this process first, because the robot can go on without it.
_OOM_SCORE_ADJ = "1000"
# Parts of messages by which onnxruntime and CUDA report a lack of memory.
_NO_MEMORY = ("failed to allocate memory", "bad_alloc", "bad allocation", "out of memory")


def set_up_child() -> tuple[dict[str, Any], socket.socket, socket.socket, FrameView]:
    """Set up this process from the request on stdin.

    Returns:
        The request, the sockets `images` and `control`, and the shared images.
    """
    request = json.loads(sys.stdin.buffer.read())
    _end_with_parent(request["parent"])
    faulthandler.enable()
    show_stacks_on_signals()
    logs.setup(request["log_level"], request["log_json"])
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE_ADJ, encoding="ascii")
    images, control, frames = request["fds"]
    return request, socket.socket(fileno=images), socket.socket(fileno=control), FrameView(frames)


def _end_with_parent(parent: int) -> None:
    """Have the kernel kill this process when the thread that started it ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # the parent ended before prctl
        sys.exit(1)


def as_memory_error(error: Exception) -> Exception:
    """Return a MemoryError in place of an out-of-memory error of onnxruntime or CUDA.

    Other errors are returned as they are.
    """
    text = str(error).lower()
    return MemoryError(str(error)) if any(sign in text for sign in _NO_MEMORY) else error
