"""Conditions that `edge soak` checks on the service from outside, during a fault and after it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from edge.errors import UserError

if TYPE_CHECKING:
    from edge.lab.eval.soak.harness import SoakHarness
    from edge.lab.eval.soak.monitor import SoakMonitor


class FaultWindow(NamedTuple):
    """Begin and end of a fault (`time.monotonic` [s]). While it lasts, the end equals the begin."""

    began_s: float
    ended_s: float


Invariant = Callable[["SoakHarness", "SoakMonitor", FaultWindow], str]
"""Returns the reason why a condition does not hold; "" if it holds."""

LIVE_PAGES = ("/live/now", "/live/mission", "/live/map", "/live/camera", "/live/layers/0")
"""Requests of an open live page."""
# Smallest allowed share of the usual tick rate; the machine may have other work.
_MIN_RATE_SHARE = 0.5


def check_recovered(harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow) -> str:
    """Check that `/readyz` is 200 and that ticks come at least half as often as before."""
    if monitor.sampled_s <= window.ended_s or not monitor.is_ready:
        problems = "; ".join(monitor.ready_problems) or "/readyz was not asked yet"
        return f"the service is not ready: {problems}"
    ticks_hz, usual_hz = monitor.ticks_hz(window.ended_s), monitor.usual_hz
    if ticks_hz < _MIN_RATE_SHARE * usual_hz:
        return f"only {ticks_hz:.1f} ticks per second, {usual_hz:.1f} before the fault"
    return ""


def check_no_view_reported(harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow) -> str:
    """Check that `/readyz` reports that the service sees nothing."""
    if monitor.sampled_s > window.began_s and any(
        "no usable observations" in why for why in monitor.ready_problems
    ):
        return ""
    problems = "; ".join(monitor.ready_problems) or "ready"
    return f"/readyz reports no lack of sensor data, only: {problems}"


def log_check(pattern: str) -> Invariant:
    """Return a check that a line of the log matches the pattern."""

    def check(harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow) -> str:
        if any(re.search(pattern, line) for line in harness.log.since(window.began_s)):
            return ""
        return f"no line of the log matches {pattern!r}"

    check.__doc__ = f"Check that a line of the log matches `{pattern}`."
    return check


def check_checkpoint_failure(
    harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow
) -> str:
    """Check that the status reports that the checkpoint cannot be written."""
    checkpoint = monitor.status.get("checkpoint") or {}
    if monitor.status_s > window.began_s and checkpoint.get("problem"):
        return ""
    return "the status does not report that the checkpoint cannot be written"


def check_checkpoint_written(
    harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow
) -> str:
    """Check that the checkpoint is written again."""
    checkpoint = monitor.status.get("checkpoint") or {}
    if monitor.status_s > window.ended_s and not checkpoint.get("problem"):
        return ""
    return f"the checkpoint is not written: {checkpoint.get('problem')}"


def check_recording_failure(harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow) -> str:
    """Check that the status reports that the recording cannot be written."""
    if all(sink["problem"] for sink in _recorders(monitor)) and monitor.status_s > window.began_s:
        return ""
    return "the status does not report that the recording cannot be written"


def check_recording_continues(
    harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow
) -> str:
    """Check that the recording continues."""
    if monitor.status_s <= window.ended_s:
        return "no status message since the end of the fault"
    stopped = [sink for sink in _recorders(monitor) if sink["problem"] or not sink["file"]]
    return f"nothing is recorded: {stopped[0]['problem']}" if stopped else ""


def _recorders(monitor: SoakMonitor) -> list[dict[str, Any]]:
    """Return the status of each sink that writes files."""
    return [sink for sink in (monitor.status.get("sinks") or {}).values() if "file" in sink]


def check_page(harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow) -> str:
    """Check that the live page is served."""
    silent = [path for path in LIVE_PAGES if not harness.text(path)]
    return f"{silent[0]}: no answer" if silent else ""


def check_requests(harness: SoakHarness, monitor: SoakMonitor, window: FaultWindow) -> str:
    """Check that a request is answered."""
    try:
        harness.request_mission(do="status")
    except UserError as error:
        return str(error)
    return ""
