"""Rules of `edge soak`, the endurance test: what the service must keep to under faults.

`RULES` must hold at every sample. `GROWTHS` limit the growth of values over the entire run.

The functions named `…_problem` return the reason why a rule does not hold, or "" if it holds. A
sample is calm if no fault is active.
"""

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

MAX_SILENCE_S = 10.0  # longest time without an answer of `/healthz` or a message of the loop
MAX_MAP_AGE_S = 10.0  # largest age of the map file (the map's checkpoint) without a fault
MAX_LOG_LINES_PER_MIN = 120
_MISSION_SPARE_S = 30.0  # added to the mission's own time limit
# After a process starts: a model fills its memory arenas in some thousand images.
_WARM_UP_S = 120.0
_SETTLED_SHARE = 0.1  # share of the run after which caches are filled
_SOME_REACHED_S = 1200.0  # in a longer run, at least one mission must reach its target

Sample = dict[str, Any]


@dataclass(frozen=True)
class Rule:
    """A condition that must hold at every sample.

    Attributes:
        problem: returns the reason why the condition does not hold; "" if it holds.
        ends_run: the run cannot continue once the condition does not hold.
    """

    name: str
    problem: Callable[[SoakHarness, SoakMonitor, Sample], str]
    ends_run: bool = False


def _over(value: float, limit: float, words: str) -> str:
    """Return the words, with value and limit, if the value is over the limit, else ""."""
    return words.format(value, limit) if value > limit else ""


def _process_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    code = harness.service.poll()
    return "" if code is None else f"the process of the service ended with exit code {code}"


def _health_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    silent_s = time.monotonic() - monitor.healthy_s
    return _over(silent_s, MAX_SILENCE_S, "/healthz is not 200 for {:.0f} s, allowed {:g} s")


def _loop_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    # While a fault silences the bus, no beat can arrive.
    silent_s = time.monotonic() - max(monitor.beat_s, monitor.muted_s)
    return _over(silent_s, MAX_SILENCE_S, "no message of the loop for {:.0f} s, allowed {:g} s")


def _map_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    age_s = sample["places_age_s"] if monitor.calm else None  # of the map file
    words = "the map file is {:.0f} s old, allowed {:g} s"
    return _over(age_s or 0.0, MAX_MAP_AGE_S, words) or monitor.map_problem


def _log_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    words = "{} log lines in a minute, allowed {}"
    return _over(sample["log_a_minute"], MAX_LOG_LINES_PER_MIN, words)


def _mission_time_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    limit_s = harness.config.mission.time_limit_s + _MISSION_SPARE_S
    words = "a mission runs for {:.0f} s, allowed {:.0f} s"
    return _over(monitor.status.get("elapsed_s", 0.0), limit_s, words)


def _mission_reason_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    status = monitor.status
    silent = status.get("phase") == "failed" and not status.get("reason")
    return "a mission failed without a reason" if silent else ""


def _other_process_problem(harness: SoakHarness, monitor: SoakMonitor, sample: Sample) -> str:
    ended = [name for name in harness.children.ended() if name != "service"]
    return f"the {ended[0]} ended by itself" if ended else ""


RULES: tuple[Rule, ...] = (
    Rule("service lives", _process_problem, ends_run=True),
    Rule("service answers", _health_problem),
    Rule("loop beats", _loop_problem),
    Rule("checkpoint", lambda harness, monitor, sample: monitor.checkpoint_problem),
    Rule("map", _map_problem),
    Rule("recordings", lambda harness, monitor, sample: monitor.recordings.problem),
    Rule("log", _log_problem),
    Rule("missions end", _mission_time_problem),
    Rule("missions say why", _mission_reason_problem),
    Rule("others live", _other_process_problem),
)
"""docs/soak.md describes them."""


@dataclass(frozen=True)
class GrowthLimit:
    """A limit on the growth of a value.

    Attributes:
        part: part of a sample, `service` or `model`.
        most_in_all: growth in the entire run that is always allowed, such as caches that fill. It
            decides in a short run.
    """

    name: str
    part: str
    key: str
    unit: str
    most_per_h: float
    most_in_all: float


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
"""The limit is compared with the lower bound of the slope's confidence interval, so that only
growth that is statistically sure breaks it.

The report also gives the smallest growth that the run could have detected.
"""


def growth_slope(growth: GrowthLimit, samples: Sequence[Sample]) -> Slope | None:
    """Return the slope of a value over samples without a fault; None if there are too few.

    The first samples of the run and of each process are skipped.
    """
    if not samples:
        return None
    settled_s = _SETTLED_SHARE * samples[-1]["t_s"]
    begun_s: dict[int, float] = {}  # by process id: time of its first sample
    lives: dict[int, list[tuple[float, float]]] = {}  # by process id: (time, value) of samples
    for sample in samples:
        if used := sample[growth.part]:
            t_s, pid = sample["t_s"], used["pid"]
            settles_s = max(settled_s, begun_s.setdefault(pid, t_s) + _WARM_UP_S)
            if sample["calm"] and t_s >= settles_s:
                lives.setdefault(pid, []).append((t_s, used[growth.key]))
    return slope_of(tuple(np.array(life).T) for life in lives.values())  # type: ignore[misc]


def allowed_per_h(growth: GrowthLimit, ran_s: float) -> float:
    """Return the allowed growth per hour, for a run of this length."""
    return max(growth.most_per_h, growth.most_in_all * 3600.0 / max(ran_s, 1.0))


def growth_problem(growth: GrowthLimit, slope: Slope | None, ran_s: float) -> str:
    """Return the reason if a value surely grows by more than is allowed, else ""."""
    allowed = allowed_per_h(growth, ran_s)
    if slope is None or slope.low <= allowed:
        return ""
    return (
        f"{slope.per_h:+.1f} {growth.unit}/h, at least {slope.low:.1f}; allowed in a run of "
        f"{ran_s / 60.0:.0f} min: {allowed:.0f}"
    )


def missions_problem(ended: Sequence[dict[str, Any]], ran_s: float) -> str:
    """Return the reason if a long run reached the target of no mission, else ""."""
    if ran_s < _SOME_REACHED_S or any(end["phase"] == "reached" for end in ended):
        return ""
    return f"none of {len(ended)} was reached"
