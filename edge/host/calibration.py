"""The speed of this computer, relative to the reference computer of all budgets.

`edge bench --calibrate` times four small workloads, each on one core, and saves the result in the
cache. Code that shows or enforces budgets calls `load()`. Without a result, or with one of another
machine, the budgets of the reference computer apply.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from edge.errors import FileError, UserError
from edge.host import machine, resources
from edge.host.files import read_regular, write_atomically
from edge.jit import jit

REFERENCE = "AMD EPYC (Zen 5), 2 virtual cores"
"""The reference computer."""
REFERENCE_MS = {"kernels": 3.45, "arrays": 0.45, "memory": 1.85, "python": 2.55}
"""CPU time of each workload on the reference computer."""
# Advice for messages.
HINT = "measure this computer with `edge bench --calibrate`"
ROUNDS = 40  # of each workload; the fastest counts
AS_FAST = 1.05  # smaller differences count as equal
_MAX_SLOWDOWN = 1000.0
_MAX_BYTES = 1 << 16  # of the calibration file
_SIDE = 512  # cells of the workload `kernels`
_BYTES = 48 << 20  # of the workload `memory`


class CalibrationError(FileError):
    """A calibration that cannot be saved; the message is one line."""


@dataclass(frozen=True, slots=True)
class SpeedCalibration:
    """The speed of one computer.

    Attributes:
        machine: name of the computer (`edge.host.machine.identity`).
        slowdown: geometric mean of `parts`; 2.0: twice the time of the reference computer.
        parts: workload → slowdown.
    """

    machine: str
    slowdown: float
    parts: dict[str, float]

    def __str__(self) -> str:
        """Return the speed in words.

        >>> print(SpeedCalibration("Cortex-A78AE, 8 cores", 1.8, {}))
        1.8 times slower than the reference computer
        """
        if 1 / AS_FAST < self.slowdown < AS_FAST:
            return "as fast as the reference computer"
        if self.slowdown > 1.0:
            return f"{self.slowdown:.1f} times slower than the reference computer"
        return f"{1 / self.slowdown:.1f} times faster than the reference computer"


@jit
def flood_fill(free, seen, queue):
    """Mark all cells that are 4-connected to the middle cell, and return their number.

    Args:
        free: (n, n) bool.
        seen: (n, n) bool, output.
        queue: (n * n,) int32, scratch.
    """
    n = free.shape[0]
    seen[:] = False
    head, tail = 0, 1
    queue[0] = n // 2 * n + n // 2
    seen[n // 2, n // 2] = True
    while head < tail:
        y, x = queue[head] // n, queue[head] % n
        head += 1
        for dy, dx in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            v, u = y + dy, x + dx
            if 0 <= v < n and 0 <= u < n and free[v, u] and not seen[v, u]:
                seen[v, u] = True
                queue[tail] = v * n + u
                tail += 1
    return tail


def workloads() -> dict[str, Callable[[], object]]:
    """Return the workloads by name.

    They are a compiled kernel, NumPy arithmetic and indexing, a copy of memory larger than any
    cache, and Python code with tuples, sets and dictionaries.
    """
    rng = np.random.default_rng(0)
    free = rng.random((_SIDE, _SIDE)) < 0.8
    seen, queue = np.zeros_like(free), np.zeros(_SIDE * _SIDE, np.int32)
    values, order = rng.random(1 << 17, np.float32), rng.permutation(1 << 17)
    source, target = np.ones(_BYTES, np.uint8), np.zeros(_BYTES, np.uint8)

    def arrays() -> object:
        # No sorting, no matrices: their speed depends on the vector width of the processor.
        return np.floor(np.hypot(values, values[order]) * np.float32(20.0)).astype(np.int32)

    def python() -> object:
        found: dict[tuple[int, int], frozenset[int]] = {}
        for k in range(12_000):
            found[k % 97, k % 89] = frozenset((k, k % 7))
        return sum(len(members) for members in found.values())

    return {
        "kernels": lambda: flood_fill(free, seen, queue),
        "arrays": arrays,
        "memory": lambda: np.copyto(target, source),
        "python": python,
    }


def time_ms(work: Callable[[], object]) -> float:
    """Return the CPU time in milliseconds of the fastest of `ROUNDS`, without compilation."""
    work()
    best_ns = math.inf
    for _ in range(ROUNDS):
        began_ns = time.thread_time_ns()
        work()
        best_ns = min(best_ns, time.thread_time_ns() - began_ns)
    return best_ns * 1e-6


def measure() -> SpeedCalibration:
    """Measure this computer; takes about one second if the kernel is compiled."""
    parts = {name: time_ms(work) / REFERENCE_MS[name] for name, work in workloads().items()}
    slowdown = math.exp(sum(map(math.log, parts.values())) / len(parts))
    return SpeedCalibration(machine.identity(), slowdown, parts)


def path() -> Path:
    """Return the path of the calibration file.

    Raises:
        ConfigError: there is no folder for a cache.
    """
    return resources.cache_dir() / "calibration.json"


def save(calibration: SpeedCalibration) -> Path:
    """Save the calibration atomically, and return its path.

    Raises:
        CalibrationError: the file cannot be written.
    """
    file = path()
    try:
        write_atomically(file, json.dumps(asdict(calibration), indent=1).encode())
    except OSError as error:
        why = error.strerror or error
        raise CalibrationError(
            f"{file}: cannot be written: {why} (set EDGE_CACHE_DIR to another folder)"
        ) from None
    return file


def load() -> SpeedCalibration | None:
    """Return the calibration of this computer; None if there is no valid one."""
    try:
        saved = SpeedCalibration(**json.loads(read_regular(path(), _MAX_BYTES)))
        is_valid = 1 / _MAX_SLOWDOWN < saved.slowdown < _MAX_SLOWDOWN
    except (OSError, ValueError, TypeError, RecursionError, UserError):
        return None
    return saved if is_valid and saved.machine == machine.identity() else None
