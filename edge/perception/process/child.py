"""Start of a model process: code that the programs of all model processes share."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edge import logs
from edge.host.signals import show_stacks_on_signals
from edge.perception.process import wire
from edge.perception.process.wire import FrameView
from edge.perception.runtime.health import is_out_of_memory
from edge.text import read_json_object

log = logging.getLogger(__name__)

Answer = Callable[[dict[str, Any], FrameView], bytes]
"""(request, shared images) → the answer to send."""
Load = Callable[[dict[str, Any], socket.socket], Answer]
"""(request on stdin, the socket `control`) → the function that answers each later request."""

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
# If memory runs out, the kernel kills this process first, because the robot can go on without it.
_OOM_SCORE_ADJ = "1000"


def run_child(load: Load) -> int:
    """Load a model, and answer each request with the result or the error, until the service ends.

    Returns:
        The exit status, once the service has ended this process or the model cannot be loaded.
    """
    request, images, control, frames = set_up_child()
    try:
        answer = load(request, control)
    except Exception as error:
        control.send(wire.encode_error(error))
        return 1
    control.send(wire.encode())
    try:
        while message := images.recv(wire.MAX_BYTES):
            request = read_json_object(message)
            try:
                reply = answer(request, frames)
            except Exception as error:
                reply = wire.encode_error(as_memory_error(error), seq=request["seq"])
            images.send(reply)
    except BaseException:
        log.exception("the model's process ends after an error")
        os._exit(1)  # other threads may block in recv for ever
    return 0


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
    return MemoryError(str(error)) if is_out_of_memory(error) else error
