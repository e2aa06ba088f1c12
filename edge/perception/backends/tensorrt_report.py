"""What TensorRT says while it works: its log into ours, its progress in words."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from edge.text import one_line

log = logging.getLogger(__name__)


def make_logger(trt: Any) -> Any:
    """A TensorRT logger that writes to ours; `last` is the newest error, for one line of ours."""
    severity = trt.ILogger.Severity
    levels = {
        severity.INTERNAL_ERROR: logging.ERROR,
        severity.ERROR: logging.ERROR,
        severity.WARNING: logging.WARNING,
        severity.INFO: logging.DEBUG,
        severity.VERBOSE: logging.DEBUG,
    }

    class Logger(trt.ILogger):
        def __init__(self) -> None:
            trt.ILogger.__init__(self)
            self.last = "no reason given"

        def log(self, level: Any, message: str) -> None:
            if levels[level] == logging.ERROR:
                self.last = one_line(message)
            if level != severity.VERBOSE:
                log.log(levels[level], "%s", one_line(message, 1000))

    return Logger()


def make_monitor(trt: Any, note: Callable[[str], None]) -> Any:
    """A TensorRT progress monitor that notes lines such as `45 % of building engine`."""
    phases = Phases()

    class Monitor(trt.IProgressMonitor):
        def __init__(self) -> None:
            trt.IProgressMonitor.__init__(self)

        def phase_start(self, phase_name: str, parent_phase: str | None, num_steps: int) -> None:
            phases.start(phase_name, parent_phase, num_steps)
            note(phases.line())

        def step_complete(self, phase_name: str, step: int) -> bool:
            phases.step(phase_name, step)
            note(phases.line())
            return True  # go on

        def phase_finish(self, phase_name: str) -> None:
            phases.finish(phase_name)
            note(phases.line())

    return Monitor()


class Phases:
    """How far nested phases are; TensorRT tells of them from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[str, list[Any]] = {}  # name → [parent, steps, done], outermost first

    def start(self, name: str, parent: str | None, steps: int) -> None:
        with self._lock:
            self._open[name] = [parent, max(1, steps), 0]

    def step(self, name: str, step: int) -> None:
        """Step number `step`, counted from 0, of a phase is done."""
        with self._lock:
            if name in self._open:
                self._open[name][2] = step + 1

    def finish(self, name: str) -> None:
        with self._lock:
            self._open.pop(name, None)

    def line(self) -> str:
        """The outermost phase and its share done, inner phases counted in; empty at the end."""
        with self._lock:
            root = next((name for name, phase in self._open.items() if phase[0] is None), None)
            return "" if root is None else f"{self._share(root):.0%} of {root.lower()}"

    def _share(self, name: str) -> float:
        _, steps, done = self._open[name]
        inner = [self._share(child) for child, phase in self._open.items() if phase[0] == name]
        return min(1.0, (done + max(inner, default=0.0)) / steps)
