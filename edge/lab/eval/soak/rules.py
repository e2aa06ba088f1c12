"""What must hold all the time, and what of the whole run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from edge.lab.eval.soak.growth import Slope, slope_of

if TYPE_CHECKING:
    from edge.lab.eval.soak.stage import Stage
    from edge.lab.eval.soak.watch import Watch

SILENT_S = OLD_S = 10.0
LOG_A_MINUTE = 120
_SPARE_S = 30.0  # of a mission's limit
_WARM_UP_S = 120.0  # a model fills its arenas in some thousand images
_SETTLES = 0.1  # of the run: caches are filled by then
_SOME_REACHED_S = 1200.0

Sample = dict[str, Any]


@dataclass(frozen=True)
class Rule:
    """What must hold at every look.

    Attributes:
        broken: why it does not hold; empty where it does.
        ends: there is nothing to go on with once it is broken.
    """

    name: str
    what: str
    broken: Callable[[Stage, Watch, Sample], str]
    ends: bool = False


def _dead(stage: Stage, watch: Watch, sample: Sample) -> str:
    code = stage.service.poll()
    return "" if code is None else f"it ended with {code}"


def _hung(stage: Stage, watch: Watch, sample: Sample) -> str:
    silent_s = time.monotonic() - watch.alive_s
    return f"not 200 for {silent_s:.0f} s" if silent_s > SILENT_S else ""


def _silent(stage: Stage, watch: Watch, sample: Sample) -> str:
    silent_s = time.monotonic() - max(watch.beat_s, watch.muted_s)
    return f"no beat for {silent_s:.0f} s" if silent_s > SILENT_S else ""


def _unreadable(stage: Stage, watch: Watch, sample: Sample) -> str:
    return watch.checkpoint


def _places_lost(stage: Stage, watch: Watch, sample: Sample) -> str:
    age_s = sample["places_age_s"]
    if watch.calm and age_s is not None and age_s > OLD_S:
        return f"written {age_s:.0f} s ago"
    return watch.places


def _recorded_badly(stage: Stage, watch: Watch, sample: Sample) -> str:
    return watch.recordings.problem


def _floods(stage: Stage, watch: Watch, sample: Sample) -> str:
    lines = sample["log_a_minute"]
    return f"{lines} lines in a minute" if lines > LOG_A_MINUTE else ""


def _endless(stage: Stage, watch: Watch, sample: Sample) -> str:
    elapsed_s = watch.status.get("elapsed_s", 0.0)
    limit_s = stage.config.mission.time_limit_s + _SPARE_S
    return f"one goes on for {elapsed_s:.0f} s" if elapsed_s > limit_s else ""


def _unsaid(stage: Stage, watch: Watch, sample: Sample) -> str:
    status = watch.status
    silent = status.get("phase") == "failed" and not status.get("reason")
    return "one failed without a reason" if silent else ""


def _others_end(stage: Stage, watch: Watch, sample: Sample) -> str:
    gone = [name for name in stage.gone() if name != "service"]
    return f"the {gone[0]} ended by itself" if gone else ""


RULES: tuple[Rule, ...] = (
    Rule("service lives", "its process never ends", _dead, ends=True),
    Rule("service answers", f"`/healthz` is never other than 200 for over {SILENT_S:g} s", _hung),
    Rule("loop beats", f"never {SILENT_S:g} s without a beat, where it can be heard", _silent),
    Rule("checkpoint", "the file is whole at every look", _unreadable),
    Rule(
        "map",
        f"so is `….map`; without a fault it is no older than {OLD_S:g} s",
        _places_lost,
    ),
    Rule(
        "recordings",
        "the `mcap` library reads each complete file; together they are no larger than `keep_mb`",
        _recorded_badly,
    ),
    Rule("log", f"at most {LOG_A_MINUTE} lines a minute", _floods),
    Rule("missions end", f"none goes on {_SPARE_S:g} s past `mission.time_limit_s`", _endless),
    Rule("missions say why", "each that fails has a reason", _unsaid),
    Rule("others live", "simulator, controller and router never end by themselves", _others_end),
)


@dataclass(frozen=True)
class Growth:
    """What must not grow.

    Attributes:
        who: `service` or `model`, of a sample; `key`: of that.
        most_per_h: it may surely not grow by more.
        settles: nor, in a run too short for that, by more than this in all.
    """

    name: str
    who: str
    key: str
    unit: str
    most_per_h: float
    settles: float


GROWTHS: tuple[Growth, ...] = (
    Growth("memory of the service", "service", "memory_mb", "MB", 20.0, 100.0),
    Growth("memory of the model's process", "model", "memory_mb", "MB", 20.0, 100.0),
    Growth("threads of the service", "service", "threads", "threads", 2.0, 8.0),
    Growth("threads of the model's process", "model", "threads", "threads", 2.0, 8.0),
    Growth("descriptors of the service", "service", "descriptors", "descriptors", 2.0, 8.0),
    Growth("descriptors of the model's process", "model", "descriptors", "descriptors", 2.0, 8.0),
)
"""The interval's lower bound is held against these: what is not known to grow is no fault; the page
says how small a growth would have shown."""


def grown(growth: Growth, samples: Sequence[Sample]) -> Slope | None:
    """How it grows, by samples without a fault, after those in which it settles: of the run, and of
    each process; None: too few."""
    if not samples:
        return None
    settled_s = _SETTLES * samples[-1]["t_s"]
    begun_s: dict[int, float] = {}
    lives: dict[int, list[tuple[float, float]]] = {}
    for sample in samples:
        if used := sample[growth.who]:
            t_s, pid = sample["t_s"], used["pid"]
            settles_s = max(settled_s, begun_s.setdefault(pid, t_s) + _WARM_UP_S)
            if sample["calm"] and t_s >= settles_s:
                lives.setdefault(pid, []).append((t_s, used[growth.key]))
    return slope_of(tuple(np.array(life).T) for life in lives.values())  # type: ignore[misc]


def most_per_h(growth: Growth, ran_s: float) -> float:
    """What it may grow by in a run of such a length."""
    return max(growth.most_per_h, growth.settles * 3600.0 / max(ran_s, 1.0))


def grows(growth: Growth, slope: Slope | None, ran_s: float) -> str:
    """Why it surely grows by more than it may; empty where that is not known."""
    most = most_per_h(growth, ran_s)
    if slope is None or slope.low <= most:
        return ""
    return (
        f"{slope.per_h:+.1f} {growth.unit}/h, surely over {slope.low:.1f}; in "
        f"{ran_s / 60.0:.0f} min at most {most:.0f}"
    )


def none_reached(ended: Sequence[dict[str, Any]], ran_s: float) -> str:
    """Why a run was no good at what the service is for; empty for a short one."""
    if ran_s < _SOME_REACHED_S or any(end["phase"] == "reached" for end in ended):
        return ""
    return f"none of {len(ended)} was reached"
