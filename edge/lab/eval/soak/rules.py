"""Rules that must hold all the time, and limits for the whole run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from edge.lab.eval.soak.growth import Slope, slope_of

if TYPE_CHECKING:
    from edge.lab.eval.soak.harness import SoakHarness
    from edge.lab.eval.soak.monitor import SoakMonitor

SILENT_S = 10.0  # longest time without an answer of the service or a message of the loop
OLD_S = 10.0  # largest age of the map's checkpoint
LOG_A_MINUTE = 120  # most lines
_SPARE_S = 30.0  # added to a mission's limit
_WARM_UP_S = 120.0  # a model fills its memory arenas in some thousand images
_SETTLED_AFTER = 0.1  # share of the run after which caches are filled
_SOME_REACHED_S = 1200.0  # in a longer run, at least one mission must reach its target

Sample = dict[str, Any]


@dataclass(frozen=True)
class Rule:
    """A condition that must hold at every sample.

    Attributes:
        name: for the report.
        what: description for docs/soak.md.
        broken: returns the reason why it does not hold; "" if it holds.
        ends: the run cannot continue once it is broken.
    """

    name: str
    what: str
    broken: Callable[[SoakHarness, SoakMonitor, Sample], str]
    ends: bool = False


def _dead(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    code = harness.service.poll()
    return "" if code is None else f"the process of the service ended with exit code {code}"


def _hung(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    silent_s = time.monotonic() - monitor.alive_s
    return (
        f"/healthz is not 200 for {silent_s:.0f} s, allowed {SILENT_S:g} s"
        if silent_s > SILENT_S
        else ""
    )


def _silent(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    silent_s = time.monotonic() - max(monitor.beat_s, monitor.muted_s)
    return (
        f"no message of the loop for {silent_s:.0f} s, allowed {SILENT_S:g} s"
        if silent_s > SILENT_S
        else ""
    )


def _unreadable(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    return monitor.checkpoint


def _map_lost(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    age_s = sample["places_age_s"]
    if monitor.calm and age_s is not None and age_s > OLD_S:
        return f"the map file is {age_s:.0f} s old, allowed {OLD_S:g} s"
    return monitor.places


def _recorded_badly(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    return monitor.recordings.problem


def _floods(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    lines = sample["log_a_minute"]
    return f"{lines} log lines in a minute, allowed {LOG_A_MINUTE}" if lines > LOG_A_MINUTE else ""


def _overdue(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    elapsed_s = monitor.status.get("elapsed_s", 0.0)
    limit_s = harness.config.mission.time_limit_s + _SPARE_S
    return (
        f"a mission runs for {elapsed_s:.0f} s, allowed {limit_s:.0f} s"
        if elapsed_s > limit_s
        else ""
    )


def _without_reason(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    status = monitor.status
    silent = status.get("phase") == "failed" and not status.get("reason")
    return "a mission failed without a reason" if silent else ""


def _others_end(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    gone = [name for name in harness.gone() if name != "service"]
    return f"the {gone[0]} ended by itself" if gone else ""


RULES: tuple[Rule, ...] = (
    Rule("service lives", "its process never ends", _dead, ends=True),
    Rule("service answers", f"`/healthz` is 200 at least every {SILENT_S:g} s", _hung),
    Rule(
        "loop beats",
        f"a message of the loop at least every {SILENT_S:g} s, unless a fault silences the bus",
        _silent,
    ),
    Rule("checkpoint", "the file is complete at every sample", _unreadable),
    Rule(
        "map",
        f"`….map` is complete, too; without a fault it is at most {OLD_S:g} s old",
        _map_lost,
    ),
    Rule(
        "recordings",
        "the `mcap` library reads each complete file; together they are at most `keep_mb`",
        _recorded_badly,
    ),
    Rule("log", f"at most {LOG_A_MINUTE} lines a minute", _floods),
    Rule("missions end", f"at most {_SPARE_S:g} s after `mission.time_limit_s`", _overdue),
    Rule("missions say why", "each failed mission has a reason", _without_reason),
    Rule("others live", "simulator, controller and router never exit by themselves", _others_end),
)


@dataclass(frozen=True)
class GrowthLimit:
    """A limit on the growth of a value.

    Attributes:
        name: for the report.
        who: part of a sample: `service` or `model`.
        key: key of the value in that part.
        unit: of the value.
        most_per_h: limit on the growth in an hour.
        settles: limit on the whole growth in a run that is too short for `most_per_h`.
    """

    name: str
    who: str
    key: str
    unit: str
    most_per_h: float
    settles: float


GROWTHS: tuple[GrowthLimit, ...] = (
    GrowthLimit("memory of the service", "service", "memory_mb", "MB", 20.0, 100.0),
    GrowthLimit("memory of the model's process", "model", "memory_mb", "MB", 20.0, 100.0),
    GrowthLimit("threads of the service", "service", "threads", "threads", 2.0, 8.0),
    GrowthLimit("threads of the model's process", "model", "threads", "threads", 2.0, 8.0),
    GrowthLimit("descriptors of the service", "service", "descriptors", "descriptors", 2.0, 8.0),
    GrowthLimit(
        "descriptors of the model's process", "model", "descriptors", "descriptors", 2.0, 8.0
    ),
)
"""Limits on the lower bound of the interval, so only certain growth breaks them.

The report has the smallest growth that would have shown.
"""


def grown(growth: GrowthLimit, samples: Sequence[Sample]) -> Slope | None:
    """Return the growth over samples without a fault; None if there are too few.

    The first samples of the run and of each process are skipped.
    """
    if not samples:
        return None
    settled_s = _SETTLED_AFTER * samples[-1]["t_s"]
    begun_s: dict[int, float] = {}
    lives: dict[int, list[tuple[float, float]]] = {}
    for sample in samples:
        if used := sample[growth.who]:
            t_s, pid = sample["t_s"], used["pid"]
            settles_s = max(settled_s, begun_s.setdefault(pid, t_s) + _WARM_UP_S)
            if sample["calm"] and t_s >= settles_s:
                lives.setdefault(pid, []).append((t_s, used[growth.key]))
    return slope_of(tuple(np.array(life).T) for life in lives.values())  # type: ignore[misc]


def most_per_h(growth: GrowthLimit, ran_s: float) -> float:
    """Return the allowed growth in an hour, for a run of this length."""
    return max(growth.most_per_h, growth.settles * 3600.0 / max(ran_s, 1.0))


def grows(growth: GrowthLimit, slope: Slope | None, ran_s: float) -> str:
    """Return the reason if a value certainly grows by more than allowed, else ""."""
    most = most_per_h(growth, ran_s)
    if slope is None or slope.low <= most:
        return ""
    return (
        f"{slope.per_h:+.1f} {growth.unit}/h, at least {slope.low:.1f}; allowed in a run of "
        f"{ran_s / 60.0:.0f} min: {most:.0f}"
    )


def none_reached(ended: Sequence[dict[str, Any]], ran_s: float) -> str:
    """Return the reason if a long run reached the target of no mission, else ""."""
    if ran_s < _SOME_REACHED_S or any(end["phase"] == "reached" for end in ended):
        return ""
    return f"none of {len(ended)} was reached"
