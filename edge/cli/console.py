"""The status line of a run: rewritten in place on a terminal, printed every 5 s to a log."""

from __future__ import annotations

import os
import sys
import time
from typing import TextIO

from edge import names
from edge.logs import CLEAR_LINE
from edge.loop.result import TickResult
from edge.tasks.facts import TaskStatus, lengths_m
from edge.text import shorten

TERMINAL_PERIOD_S = 0.2
LOG_PERIOD_S = 5.0
_RECENT = 150  # number of ticks for the percentiles
_PART_CHARS = 60
"""Longest text of one part of the line, such as the later targets."""


class ConsoleSink:
    """Sink that writes the status line: at most 5 Hz to a terminal, else every 5 s.

    The period is in wall-clock time, since simulated time may be faster or slower. The stream is
    stderr if none is given.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._is_terminal = self._stream.isatty()
        self._period_ns = round(1e9 * (TERMINAL_PERIOD_S if self._is_terminal else LOG_PERIOD_S))
        self._last_written_ns: int | None = None

    def tick(self, result: TickResult) -> None:
        wall_ns = time.monotonic_ns()
        if self._last_written_ns is not None and wall_ns - self._last_written_ns < self._period_ns:
            return
        self._last_written_ns = wall_ns
        line = status_line(result)
        if self._is_terminal:
            self._stream.write(CLEAR_LINE + line[: self._columns() - 1])
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def close(self) -> None:
        """End the rewritten line, so that later output starts on a new line."""
        if self._is_terminal and self._last_written_ns is not None:
            self._stream.write("\n")
            self._stream.flush()
        self._last_written_ns = None

    def _columns(self) -> int:
        try:
            return os.get_terminal_size(self._stream.fileno()).columns or 80
        except (OSError, ValueError):
            return 80


def status_line(result: TickResult) -> str:
    """Return the status line, without control characters.

    In a search:
    `12.3s searching chair | frontier 2.5 m | 1 seen | map 40 m2 | tick p95 1.9 ms | detector 9 ms`

    During a task:
    `12.3s driving go past the sofa | step 1 of 2 | 3.1 of 7.4 m | map 40 m2 | tick p95 1.9 ms | …`

    Without an input:
    `0.0s waiting for sensors: no message yet on edge/camera/depth | looking for chair | …`
    """
    status, pose, task = result.status, result.pose, result.task()
    latency = result.latency(last=_RECENT)
    tick, detect = latency.tick, latency.stage("detect")
    phase = status.phase if pose is not None else "waiting for sensors, looking for"
    if task is None or pose is None:
        parts = [f"{phase} {_targets_text(result)}", *_search_parts(result)]
    else:
        parts = _task_parts(task, result)
    if missing := result.parts().get("inputs", {}).get("detail"):
        parts[0] = parts[0].removeprefix("waiting for sensors, ")
        # At the front, since a narrow terminal cuts the line.
        parts.insert(0, missing if pose is not None else f"waiting for sensors: {missing}")
    parts[0] = f"{status.elapsed_s:.1f}s {parts[0]}"
    parts.append(f"map {result.known_m2():.0f} m2")
    if tick.n:
        parts.append(f"tick p95 {tick.p95_ms:.1f} ms")
    if detect.n:
        parts.append(f"detector {detect.p50_ms:.0f} ms")
    return "".join(c for c in " | ".join(parts) if c.isprintable())


def _search_parts(result: TickResult) -> list[str]:
    """Return the present goal, and the number of objects that may be the target."""
    goal, pose, target = result.goal, result.pose, result.status.target
    label = result.targets.get(target, target)
    seen = sum(names.same_name(found.label, label) for found in result.instances())
    away_m = 0.0 if goal is None or pose is None else pose.distance_to(*goal.candidate_xy_m)
    return ["no goal" if goal is None else f"{goal.kind} {away_m:.1f} m", f"{seen} seen"]


def _task_parts(task: TaskStatus, result: TickResult) -> list[str]:
    """Return the parts of the line during a task: instruction, step and distance."""
    asked = shorten(task.instruction, _PART_CHARS)
    driven, n_steps = sum(step.state == "driven" for step in task.steps), len(task.steps)
    step = [f"step {driven + 1} of {n_steps}"] if driven < n_steps > 1 else []
    if task.phase == "looking":
        wanted = shorten(", ".join(task.missing), _PART_CHARS) or "what is around"
        return [f"looking for {wanted}, to {asked}", *step, *_search_parts(result)]
    if task.refined is None:
        answers = f", {len(task.rounds)} answers" if task.rounds else ""
        return [f"{task.phase} {asked}", *step, f"by {task.writer}{answers}"]
    length_m, driven_m = lengths_m(task.refined, task.index)
    return [f"{task.phase} {asked}", *step, f"{driven_m:.1f} of {length_m:.1f} m"]


def _targets_text(result: TickResult) -> str:
    """Return the present target, and the targets that the plan has after it."""
    status, steps = result.status, result.mission().plan.steps
    if status.phase == "idle":
        return f"({status.reason})"
    then = ", ".join(step or "nothing" for step in steps[1:])
    if then and not status.done:
        return f"{status.target} (then {shorten(then, _PART_CHARS)})"
    return status.target
