"""One model process, as the service sees it: started, asked, watched, ended."""

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
from edge.perception.runtime.health import Tell
from edge.text import read_json_object

log = logging.getLogger(__name__)

PROGRAM = python_module("edge.perception.serve_detector")

_LOOK_S = 0.05  # how long an end may go unnoticed while an answer is awaited
_END_S = 0.2
_STOP_S = 2.0
_KILL_S = 5.0  # one that is deep in the kernel, such as in a GPU's driver, does not even die

T = TypeVar("T")


class Link:
    """A process that was started; ready once `wait_ready` has returned.

    The kernel ends the process with the thread that makes this object.

    Attributes:
        name: of the model.
        fault: why it was given up, or how it ended; empty while all is well.
    """

    def __init__(
        self, told: dict[str, Any], name: str, frames: FrameFile, program: Sequence[str] = ()
    ) -> None:
        """
        Args:
            told: what the program is to do, beside what all are told.
            program: other than the one for detectors.

        Raises:
            ModelProcessError: it cannot be started.
        """
        self.name, self.fault = name, ""
        self._frames = frames
        self._asked = self._checked = 0
        self._ended = threading.Event()
        self._asking, self._checking = threading.Lock(), threading.Lock()
        with contextlib.ExitStack() as stack:
            try:
                self._images, images = _channel(stack)
                self._control, control = _channel(stack)
                with images, control:
                    fds = images.fileno(), control.fileno(), frames.fd
                    self._process = _start(program or PROGRAM, fds, told)
            except OSError as error:
                raise ModelProcessError(
                    f"model {name}: its process cannot be started: {error}"
                ) from None
            self._channels = stack.pop_all()

    def wait_ready(
        self,
        timeout_s: float,
        told_to_end: Callable[[], bool],
        progress: Tell,
        limit: str = "perception.process.start_timeout_s",
    ) -> dict[str, Any]:
        """Wait until the model is loaded and has run once. Return what it said then.

        Args:
            timeout_s: how long it may say nothing.
            limit: the key or option that says so.
            told_to_end: asked every now and then.
            progress: told what it says of the loading.

        Raises:
            ModelError, PromptError: what kept the model from loading, in the same words as where
                it is loaded in this process.
            ModelProcessError: it ended, took too long, or is no longer wanted.
        """
        while "health" in (header := self._hear(timeout_s, told_to_end, limit)):
            progress(self._decode(wire.decode_health, header))
        wire.raise_error(header, self.name)
        return header

    def _hear(
        self, timeout_s: float, told_to_end: Callable[[], bool], limit: str
    ) -> dict[str, Any]:
        """What a process says that is not yet ready; see `wait_ready`."""
        deadline_s = time.monotonic() + timeout_s
        while (said := _receive(self._control)) is None:
            if told_to_end():
                raise self.give_up("told to end while it was started")
            if time.monotonic() >= deadline_s:
                raise self.give_up(f"not ready after {timeout_s:g} s ({limit}): killed")
        if not said:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self._process.wait(_END_S)
                raise self.give_up(f"{_how(code)} before it was ready")
        return self._decode(read_json_object, said)

    def _decode(self, decode: Callable[[Any], T], said: Any) -> T:
        """What a process says that is not yet ready; nonsense is its end."""
        try:
            return decode(said)
        except ValueError as error:
            raise self.give_up(f"damaged message ({error}): killed") from None

    def detect(self, rgb: np.ndarray, prompts: Sequence[str], timeout_s: float) -> wire.Answer:
        """Have it look for the prompts in an image.

        Args:
            timeout_s: see `ask`; of `perception.process.timeout_s`.

        Raises:
            PromptError: a prompt cannot be looked for.
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
        """Put a request about an image, or about none.

        Args:
            timeout_s: how long it may take; what it waits for a core in that time is added, at
                most `timeout_s` again.
            limit: the key that says so.
            decode: (sequence number, header, block) → the answer; a ValueError where it is none.

        Raises:
            ModelError, PromptError: as the model raised them.
            ModelProcessError: it ended; it was given up since it answered too late or nonsense;
                or its model raised something else.
        """
        with self._asking:
            if self.fault:
                raise ModelProcessError(self.fault)
            seq = self._asked = self._asked + 1
            if rgb is not None:
                try:
                    self._frames.write(seq, rgb)
                except OSError as error:
                    raise ModelProcessError(
                        f"{shared_dir()}: no room for images: {error}"
                    ) from None
            hw = None if rgb is None else rgb.shape[:2]
            said = self._exchange(wire.encode(seq=seq, hw=hw, **request), timeout_s, limit)
        try:
            head, _, block = said.partition(wire.END_OF_HEADER)
            header = read_json_object(head)
            answer = None if "error" in header else decode(seq, header, block)
        except ValueError as error:
            raise self.give_up(f"damaged answer ({error}): killed") from None
        if header.get("error") == "MemoryError":
            raise self.give_up("out of memory: killed")
        wire.raise_error(header, self.name)
        assert answer is not None
        return answer

    def _exchange(self, request: bytes, timeout_s: float, limit: str) -> bytes:
        deadline_s = time.monotonic() + timeout_s
        sent, before_s = _send(self._images, request), None
        while (said := _receive(self._images)) is None:
            if self._ended.is_set():
                raise ModelProcessError(self.fault)
            if before_s is None:
                before_s = _queued_s(self._process.pid)
            elif time.monotonic() - deadline_s >= min(
                _queued_s(self._process.pid) - before_s, timeout_s
            ):
                raise self.give_up(f"no answer within {timeout_s:g} s ({limit}): killed")
        if not (sent and said):  # there is nobody at the other end
            self._ended.wait(_END_S)
            raise self.give_up("takes no images: killed")
        return said

    def check(self, prompts: Sequence[str], timeout_s: float) -> bool:
        """Whether it has said in this time that it can look for the prompts.

        Raises:
            PromptError: it cannot.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._checking:
            number = self._checked = self._checked + 1
            if self.fault or not _send(self._control, wire.encode(id=number, prompts=prompts)):
                return False
            header = {}
            while header.get("id") != number:
                if self._ended.is_set() or time.monotonic() >= deadline_s:
                    return False
                if said := _receive(self._control):
                    try:
                        header = read_json_object(said)
                    except ValueError as error:  # not what the prompts are to blame for
                        self.give_up(f"damaged message ({error}): killed")
                        return False
        wire.raise_error(header, self.name)
        return True

    def give_up(self, why: str) -> ModelProcessError:
        """Kill the process; the first reason counts, and is returned to be raised."""
        self.fault = self.fault or f"model {self.name}: its process: {why}"
        self._process.kill()
        return ModelProcessError(self.fault)

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for the process to end; `fault` says how.

        Raises:
            subprocess.TimeoutExpired: it has not.
        """
        code = self._process.wait(timeout_s)
        self.fault = self.fault or f"model {self.name}: its process: {_how(code)}"
        self._ended.set()

    def stop(self) -> None:
        """End a process that another thread has joined."""
        self._process.terminate()
        if not self._ended.wait(_STOP_S):
            self._process.kill()

    def close(self) -> None:
        """Let go of everything; a process that does not end though it was killed is left behind."""
        self._process.kill()
        try:
            self.join(_KILL_S)
        except subprocess.TimeoutExpired:
            self.leave()
        with self._asking, self._checking:
            self._channels.close()

    def leave(self) -> None:
        """Say that the process is left behind, and have nobody wait for its answer."""
        self.fault = self.fault or f"model {self.name}: its process: left behind"
        self._ended.set()
        log.error(
            "model %s: its process %d does not end, though it was killed: left behind; if it is "
            "still there later, restart the machine", self.name, self._process.pid,
        )  # fmt: skip


def _channel(stack: contextlib.ExitStack) -> tuple[socket.socket, socket.socket]:
    """Two ends that keep messages apart: this process's, which waits for a moment and is closed
    with the stack, and the other's."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.settimeout(_LOOK_S)
    return stack.enter_context(ours), theirs


def _start(
    program: Sequence[str], descriptors: tuple[int, int, int], told: dict[str, Any]
) -> subprocess.Popen[bytes]:
    """Start the program, and tell it what it is to do; see `edge.perception.process`."""
    level, as_json = _logging()
    ours = {"fds": descriptors, "parent": os.getpid(), "log_level": level, "log_json": as_json}
    # A session of its own keeps the terminal's Ctrl-C for this process, which ends it in order;
    # what libraries print goes to stderr, as stdout is for reports.
    process = subprocess.Popen(
        program, stdin=subprocess.PIPE, stdout=2, pass_fds=descriptors, start_new_session=True
    )
    with contextlib.suppress(BrokenPipeError), process.stdin:  # it ended: `wait_ready` says how
        process.stdin.write(json.dumps({**told, **ours}).encode())
    return process


def _receive(channel: socket.socket) -> bytes | None:
    """The next message, empty once the other end is closed; None when none came for a moment."""
    try:
        return channel.recv(wire.MAX_BYTES)
    except TimeoutError:
        return None
    except OSError:  # it was closed with something unread
        return b""


def _send(channel: socket.socket, message: bytes) -> bool:
    """Whether there was somebody to send it to."""
    try:
        channel.send(message)
    except OSError:
        return False
    return True


def _queued_s(pid: int) -> float:
    """How long a process's main thread, which answers, has waited for a core so far, in seconds.

    Who waits for a core does not hang: killing it would make a busy machine busier. 0 where the
    kernel does not count it.
    """
    try:
        schedstat = Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii")
        return int(schedstat.split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0


def _how(code: int) -> str:
    """How a process ended, by its exit code."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:  # real-time signals but the first and the last have no name
        name = f"signal {-code}"
    return f"ended by {name}" + (", out of memory?" if -code == signal.SIGKILL else "")


def _logging() -> tuple[str, bool]:
    """Level and form of what is logged here, for the other process."""
    level = logging.getLogger("edge").getEffectiveLevel()
    name = next((name for name in LEVELS if getattr(logging, name.upper()) >= level), LEVELS[-1])
    handlers = logging.getLogger().handlers
    return name, any(isinstance(handler.formatter, JsonFormatter) for handler in handlers)
