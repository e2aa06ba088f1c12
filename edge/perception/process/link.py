"""Client of one model process: it starts the process, sends it requests, and ends it.

`edge.perception.process` describes the protocol.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from edge.host.children import python_module
from edge.logs import LEVELS, JsonFormatter
from edge.perception.process import wire
from edge.perception.process.wire import FrameFile, ModelProcessError, shared_dir
from edge.perception.runtime.health import ProgressCallback
from edge.text import read_json_object

log = logging.getLogger(__name__)

PROGRAM = python_module("edge.perception.serve_detector")

_POLL_S = 0.05  # receive timeout: longest delay to notice that the process has ended
_END_S = 0.2  # wait for the exit code after the process has closed its socket
_STOP_S = 2.0  # wait after SIGTERM, before SIGKILL
_KILL_S = 5.0  # wait after SIGKILL; a process stuck in the kernel (a GPU driver) survives it

T = TypeVar("T")


class ModelProcessClient:
    """Starts a model's process and talks to it; requests may be sent after `wait_ready` returned.

    If the thread that made this object ends, the kernel kills the process.

    Args:
        request: what the program reads at its start, without the fields that all programs get.
        program: command line; by default the one for detectors.

    Attributes:
        fault: why the process was killed, or how it ended; empty while it runs.

    Raises:
        ModelProcessError: the process cannot be started.
    """

    def __init__(
        self, request: dict[str, Any], name: str, frames: FrameFile, program: Sequence[str] = ()
    ) -> None:
        self.name, self.fault = name, ""
        self._frames = frames
        self._n_asked = self._n_checked = 0
        self._ended = threading.Event()
        # One request at a time on each socket.
        self._asking, self._checking = threading.Lock(), threading.Lock()
        with contextlib.ExitStack() as stack:
            try:
                # Our ends of the sockets, and those of the process.
                self._images, images = _channel(stack)
                self._control, control = _channel(stack)
                with images, control:
                    fds = images.fileno(), control.fileno(), frames.fd
                    self._process = _start(program or PROGRAM, fds, request)
            except OSError as error:
                raise ModelProcessError(
                    f"model {name}: its process cannot be started: {error}"
                ) from None
            self._channels = stack.pop_all()

    def wait_ready(
        self,
        timeout_s: float,
        cancelled: Callable[[], bool],
        progress: ProgressCallback,
        limit: str = "perception.process.start_timeout_s",
    ) -> dict[str, Any]:
        """Wait until the model is loaded and has run once.

        Args:
            timeout_s: longest time without a message.
            cancelled: polled; True aborts the start.
            progress: called with the health that the process sends while it loads.
            limit: configuration key or option of `timeout_s`, for messages.

        Returns:
            The header that the process sent when it was ready.

        Raises:
            ModelError, PromptError: the model cannot be loaded; the message is the same as without
                a process.
            ModelProcessError: the process ended, took too long, or the start was cancelled.
        """
        while "health" in (header := self._receive_next(timeout_s, cancelled, limit)):
            progress(self._decode(wire.decode_health, header))
        wire.raise_error(header, self.name)
        return header

    def _receive_next(
        self, timeout_s: float, cancelled: Callable[[], bool], limit: str
    ) -> dict[str, Any]:
        """Return the next message of a process that is not ready yet; see `wait_ready`."""
        deadline_s = time.monotonic() + timeout_s
        while (message := _receive(self._control)) is None:
            if cancelled():
                raise self.kill("was stopped during its start")
            if time.monotonic() >= deadline_s:
                raise self.kill(f"was not ready after {timeout_s:g} s ({limit}); it was killed")
        if not message:
            # If the process has not ended yet, the empty message is not JSON: `_decode` kills it.
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self._process.wait(_END_S)
                raise self.kill(f"{_end_reason(code)} before it was ready")
        return self._decode(read_json_object, message)

    def _decode(self, decode: Callable[[Any], T], message: Any) -> T:
        """Decode a message of a process that is not ready yet; kill the process if that fails."""
        try:
            return decode(message)
        except ValueError as error:
            raise self.kill(
                f"sent a damaged message before it was ready ({error}); it was killed"
            ) from None

    def detect(
        self, rgb: np.ndarray, prompts: Sequence[str], timeout_s: float
    ) -> wire.DetectorReply:
        """Detect the prompts in an image.

        Args:
            rgb: (h, w, 3) uint8, contiguous.
            prompts: names of the objects to look for.
            timeout_s: `perception.process.timeout_s`; see `ask`.

        Raises:
            PromptError: a prompt cannot be used.
            ModelProcessError: see `ask`.
        """
        return self.ask(
            {"prompts": prompts}, rgb, timeout_s, "perception.process.timeout_s", wire.decode_answer
        )

    def ask(
        self,
        request: dict[str, Any],
        rgb: np.ndarray | None,
        timeout_s: float,
        limit: str,
        decode: Callable[[int, dict[str, Any], bytes], T],
    ) -> T:
        """Send a request, with or without an image, and wait for the answer.

        Args:
            request: header fields.
            rgb: (h, w, 3) uint8, contiguous; None: no image.
            timeout_s: longest time for the answer. Time that the process waits for a CPU core is
                added, up to `timeout_s` again.
            limit: configuration key of `timeout_s`, for messages.
            decode: called with sequence number, header and block, returns the answer; raises
                ValueError if it is invalid.

        Raises:
            ModelError, PromptError: as the model raised them.
            ModelProcessError: the process ended, was killed after a late or invalid answer, or its
                model raised another error.
        """
        with self._asking:
            if self.fault:
                raise ModelProcessError(self.fault)
            seq = self._n_asked = self._n_asked + 1
            if rgb is not None:
                try:
                    self._frames.write(seq, rgb)
                except OSError as error:
                    raise ModelProcessError(
                        f"{shared_dir()}: no room for the images of model {self.name}: {error}"
                    ) from None
            hw = None if rgb is None else rgb.shape[:2]
            message = self._exchange(wire.encode(seq=seq, hw=hw, **request), timeout_s, limit)
        try:
            head, _, block = message.partition(wire.END_OF_HEADER)
            header = read_json_object(head)
            answer = None if "error" in header else decode(seq, header, block)
        except ValueError as error:
            raise self.kill(f"sent a damaged answer ({error}); it was killed") from None
        if header.get("error") == "MemoryError":
            raise self.kill("ran out of memory; it was killed")
        wire.raise_error(header, self.name)
        assert answer is not None
        return answer

    def _exchange(self, request: bytes, timeout_s: float, limit: str) -> bytes:
        """Send a request and return the answer, both encoded; see `ask`."""
        deadline_s = time.monotonic() + timeout_s
        sent, core_wait_before_s = _send(self._images, request), None
        while (message := _receive(self._images)) is None:
            if self._ended.is_set():
                raise ModelProcessError(self.fault)
            if core_wait_before_s is None:  # read only for slow answers
                core_wait_before_s = _core_wait_s(self._process.pid)
            # It may be late by the time that it waited for a core, but at most by `timeout_s`.
            elif time.monotonic() - deadline_s >= min(
                _core_wait_s(self._process.pid) - core_wait_before_s, timeout_s
            ):
                raise self.kill(f"gave no answer within {timeout_s:g} s ({limit}); it was killed")
        if not (sent and message):  # the other end is closed
            self._ended.wait(_END_S)
            raise self.kill("accepts no more requests; it was killed")
        return message

    def check(self, prompts: Sequence[str], timeout_s: float) -> bool:
        """Return True if the process confirmed within this time that it can use the prompts.

        Raises:
            PromptError: the process cannot use the prompts.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._checking:
            number = self._n_checked = self._n_checked + 1
            if self.fault or not _send(self._control, wire.encode(id=number, prompts=prompts)):
                return False
            header = {}
            while header.get("id") != number:
                if self._ended.is_set() or time.monotonic() >= deadline_s:
                    return False
                if (message := _receive(self._control)) == b"":  # the process ends
                    return False
                if message is not None:
                    try:
                        header = read_json_object(message)
                    except ValueError as error:  # not the fault of the prompts
                        self.kill(f"sent a damaged message ({error}); it was killed")
                        return False
        wire.raise_error(header, self.name)
        return True

    def kill(self, why: str) -> ModelProcessError:
        """Kill the process; return the error to raise. The first reason counts."""
        self.fault = self.fault or f"model {self.name}: its process: {why}"
        self._process.kill()
        return ModelProcessError(self.fault)

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the process to end; `fault` then holds the reason.

        Raises:
            subprocess.TimeoutExpired: the process has not ended within `timeout_s`.
        """
        code = self._process.wait(timeout_s)
        self.fault = self.fault or f"model {self.name}: its process: {_end_reason(code)}"
        self._ended.set()

    def stop(self) -> None:
        """End a process that another thread waits for in `join`."""
        self._process.terminate()
        if not self._ended.wait(_STOP_S):
            self._process.kill()

    def close(self) -> None:
        """Kill the process and release everything.

        A process that survives SIGKILL is left behind.
        """
        self._process.kill()
        try:
            self.join(_KILL_S)
        except subprocess.TimeoutExpired:
            self.abandon()
        with self._asking, self._checking:
            self._channels.close()

    def abandon(self) -> None:
        """Leave a process that survives SIGKILL, and wake up all callers that wait for it."""
        self.fault = self.fault or f"model {self.name}: its process: left behind"
        self._ended.set()
        log.error(
            "model %s: its process %d was killed, but does not end: left behind; if the process "
            "is still there later, restart the machine", self.name, self._process.pid,
        )  # fmt: skip


def _channel(stack: contextlib.ExitStack) -> tuple[socket.socket, socket.socket]:
    """Open a socket pair that keeps message boundaries.

    Returns:
        (our end, with a receive timeout, closed with the stack; the model process's end).
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.settimeout(_POLL_S)
    return stack.enter_context(ours), theirs


def _start(
    program: Sequence[str], descriptors: tuple[int, int, int], request: dict[str, Any]
) -> subprocess.Popen[bytes]:
    """Start the program and write its request to stdin; see `edge.perception.process`."""
    level, as_json = _log_settings()
    ours = {"fds": descriptors, "parent": os.getpid(), "log_level": level, "log_json": as_json}
    # A new session keeps the terminal's Ctrl-C away from the child: this process ends it in order.
    # The child's stdout goes to stderr, since stdout is for reports.
    process = subprocess.Popen(
        program, stdin=subprocess.PIPE, stdout=2, pass_fds=descriptors, start_new_session=True
    )
    with contextlib.suppress(BrokenPipeError), process.stdin:  # it ended: `wait_ready` reports it
        process.stdin.write(json.dumps({**request, **ours}).encode())
    return process


def _receive(channel: socket.socket) -> bytes | None:
    """Return the next message, b"" if the other end is closed, None after `_POLL_S` without one."""
    try:
        return channel.recv(wire.MAX_BYTES)
    except TimeoutError:
        return None
    except OSError:  # the other end closed with data unread
        return b""


def _send(channel: socket.socket, message: bytes) -> bool:
    """Send a message; return False if the other end is closed."""
    try:
        channel.send(message)
    except OSError:
        return False
    return True


def _core_wait_s(pid: int) -> float:
    """Return the time that a process's main thread has waited for a CPU core so far, in seconds.

    The main thread answers requests. If it waits for a core, the process does not hang: killing it
    would make a busy machine busier. The result is 0 if the kernel does not count the time.
    """
    try:
        schedstat = Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii")
        return int(schedstat.split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0


def _end_reason(code: int) -> str:
    """Return how a process ended, by its exit code."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:  # real-time signals have no name, except the first and the last
        name = f"signal {-code}"
    return f"ended by {name}" + (", out of memory?" if -code == signal.SIGKILL else "")


def _log_settings() -> tuple[str, bool]:
    """Return level and format of this process's log, for the other process."""
    level = logging.getLogger("edge").getEffectiveLevel()
    name = next((name for name in LEVELS if getattr(logging, name.upper()) >= level), LEVELS[-1])
    handlers = logging.getLogger().handlers
    return name, any(isinstance(handler.formatter, JsonFormatter) for handler in handlers)
