"""Child processes of `edge soak`."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from typing import IO, Any

from edge.host.children import python_module

STOP_S = 30.0
"""Longest wait for the end of a process."""


class ChildProcesses:
    """Processes by name, which end with this one."""

    def __init__(self, environ: dict[str, str], output: IO[bytes]) -> None:
        self._environ, self._output = environ, output
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(
        self, name: str, command: str, path: str, *options: str, out: Any = None
    ) -> subprocess.Popen[bytes]:
        """Start a command of `edge` with a configuration file."""
        level = "info" if name == "service" else "warning"
        arguments = ["--log-level", level, command, path, "--with-parent", str(os.getpid())]
        return self._spawn(name, ["edge.cli", *arguments, *options], out)

    def start_module(self, name: str, module: str, *arguments: str) -> None:
        """Start a module, with this process's id as its last argument."""
        self._spawn(name, [module, *arguments, str(os.getpid())])

    def _spawn(
        self, name: str, arguments: Sequence[str], out: Any = None
    ) -> subprocess.Popen[bytes]:
        module, *rest = arguments
        out = self._output if out is None else out
        # With its own session, a child gets neither the terminal's Ctrl-C nor its hangup: this
        # process stops all children in order.
        child = subprocess.Popen(
            [*python_module(module), *rest], env=self._environ, stdout=out,
            stderr=out, stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        self._running[name] = child
        return child

    def kill(self, name: str, signal_number: int = signal.SIGKILL) -> None:
        """End a child with a signal and wait for its end."""
        child = self._running.pop(name, None)
        if child is None:
            return
        with suppress(ProcessLookupError):
            child.send_signal(signal_number)
        try:
            child.wait(STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()

    def send_signal(self, name: str, signal_number: int) -> None:
        """Send a signal to a child."""
        self._running[name].send_signal(signal_number)

    def ended(self) -> list[str]:
        """Return the children that have ended by themselves."""
        return [name for name, child in self._running.items() if child.poll() is not None]

    def kill_all(self, but: str) -> None:
        """End all children except one, the newest first."""
        for name in reversed(list(self._running)):
            if name != but:
                self.kill(name)
