"""Monitor of `edge soak`: observes the service from outside, by its topics, pages and processes."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from prometheus_client.parser import text_string_to_metric_families

from edge.bus import topics
from edge.host.checkpoint import CheckpointFormat
from edge.host.processes import usage
from edge.lab.eval.soak.harness import SoakHarness
from edge.lab.eval.soak.recordings import RecordingCheck
from edge.loop.checkpoints.map_checkpoint import MAP, SUFFIX
from edge.loop.monitoring.service_health import PROBES
from edge.mission.checkpoint import MISSION
from edge.text import read_json_object

log = logging.getLogger("edge.lab.eval.soak")

_MINUTE_S = 60.0
_DROPPED = "edge_source_dropped_total"  # metric of `/metrics`
_LINE_START = re.compile(r"\d\d:\d\d:\d\d")  # time at the start of a log record


class SoakMonitor:
    """Observes the service: Zenoh's threads keep its newest messages, `take_sample` gets the rest.

    The soak's own thread reads the attributes. Times are `time.monotonic` in seconds.

    Attributes:
        beats: (time, ticks since the start) of the newest three latency messages, oldest first. The
            loop sends one each second, with or without an observation.
        ready_problems: problems that `/readyz` reported in the last sample.
        is_ready: `/readyz` was 200 in the last sample.
        healthy_s: time at which `/healthz` was last 200.
        counts: number of goals, and of goals reached and failed.
        checkpoint_problem: why the mission's checkpoint cannot be read; "" if it can.
        map_problem: why the map file (the map's checkpoint) cannot be read; "" if it can.
        calm: True while no fault is active and the service has recovered from the last one. The
            caller sets it.
        bus_is_muted: True while a fault stops all published messages. The caller sets it.
        muted_s: time of the last sample with `bus_is_muted`.
    """

    def __init__(self, harness: SoakHarness) -> None:
        self._harness = harness
        self._lock = threading.Lock()
        self.status: dict[str, Any] = {}
        self.beats: deque[tuple[float, int]] = deque(maxlen=3)
        self.status_s = self.healthy_s = self.sampled_s = self.began_s = time.monotonic()
        self.ready_problems: tuple[str, ...] = ()
        self.is_ready = False
        self.counts: Counter[str] = Counter()
        self.checkpoint_problem = self.map_problem = ""
        self.recordings = RecordingCheck(harness.config, harness.out)
        self.calm = True
        self.bus_is_muted = False
        self.muted_s = self.began_s
        self._calm_hz: deque[float] = deque(maxlen=600)  # tick rates without a fault
        handlers: dict[str, Callable[[dict[str, Any]], None]] = {
            topics.STATUS.key: self._on_status,
            topics.LATENCY.key: self._on_latency,
            topics.GOAL_STATUS.key: self._on_goal_status,
        }
        for key, handle in handlers.items():
            full_key = harness.config.zenoh.key(key)
            harness.session.declare_subscriber(full_key, partial(self._on_json, handle))
        goal = harness.config.zenoh.key(topics.GOAL.key)
        self._newest_goal: bytes | None = None  # the message
        harness.session.declare_subscriber(goal, self._on_goal)

    # -- on Zenoh's threads -----------------------------------------------------------------------

    def _on_json(self, handle: Callable[[dict[str, Any]], None], sample: zenoh.Sample) -> None:
        try:
            message = read_json_object(sample.payload.to_bytes())
        except ValueError:  # the soak itself sends garbage
            return
        with self._lock:
            handle(message)

    def _on_status(self, message: dict[str, Any]) -> None:
        self.status, self.status_s = message, time.monotonic()

    def _on_latency(self, message: dict[str, Any]) -> None:
        self.beats.append((time.monotonic(), message["tick"]["count"]))
        if self.calm and (hz := _rate_hz(list(self.beats)[-2:])):
            self._calm_hz.append(hz)

    def _on_goal_status(self, message: dict[str, Any]) -> None:
        if isinstance(state := message.get("state"), str) and state in ("reached", "failed"):
            self.counts[f"goals {state}"] += 1

    def _on_goal(self, sample: zenoh.Sample) -> None:
        """Count a goal once: it is sent again until it is answered."""
        payload = sample.payload.to_bytes()
        with self._lock:
            if payload != self._newest_goal:
                self._newest_goal = payload
                self.counts["goals"] += 1

    # -- on the soak's thread --------------------------------------------------------------------

    @property
    def usual_hz(self) -> float:
        """Median rate of ticks without a fault [1/s]."""
        with self._lock:
            rates_hz = list(self._calm_hz)
        return float(np.median(rates_hz)) if rates_hz else 0.0

    def ticks_hz(self, since_s: float) -> float:
        """Return the tick rate [1/s] from the oldest of `beats` to the newest.

        It is 0 if there are not three after `since_s`.
        """
        with self._lock:
            beats = list(self.beats)
        return _rate_hz(beats) if len(beats) == 3 and beats[0][0] >= since_s else 0.0

    @property
    def beat_s(self) -> float:
        """Time of the newest of `beats`; of the begin if there is none yet."""
        with self._lock:
            return self.beats[-1][0] if self.beats else self.began_s

    def take_sample(self) -> dict[str, Any]:
        """Take a sample of pages, processes and checkpoints. Return it, JSON-ready.

        `places_age_s` is the age of the map file.
        """
        harness, now_s = self._harness, time.monotonic()
        (health_code, _), (ready_code, ready_page) = (harness.page(path) for path in PROBES)
        if health_code == 200:
            self.healthy_s = now_s
        self.is_ready = ready_code == 200
        self.ready_problems = tuple(ready_page.get("why", ("no answer",)))
        self.sampled_s = now_s
        if self.bus_is_muted:
            self.muted_s = now_s
        mission = Path(harness.config.mission.checkpoint)
        self.checkpoint_problem = _read_problem(mission, MISSION)
        map_file = mission.with_name(mission.name + SUFFIX)
        self.map_problem = _read_problem(map_file, MAP)
        self.recordings.check_next_file()
        harness.update_descendants()
        with self._lock:
            status = self.status
            beat_s, ticks = self.beats[-1] if self.beats else (now_s, 0)
        sample: dict[str, Any] = {
            "healthz": health_code,
            "readyz": ready_code,
            "why": list(self.ready_problems) if not self.is_ready else [],
            "beat_age_s": round(now_s - beat_s, 2),
            "ticks": ticks,
            "dropped": dropped(harness.text("/metrics")),
            "phase": status.get("phase"),
            "instruction": status.get("instruction"),
            "checkpoint": status.get("checkpoint"),
            "sinks": status.get("sinks"),
            "places_age_s": _age_s(map_file),
            "recorded_mb": round(self.recordings.size_mb, 2),
            "loop": status.get("loop"),
            "detector": status.get("detector"),
            "log_a_minute": sum(
                map(bool, map(_LINE_START.match, harness.log.since(now_s - _MINUTE_S)))
            ),
            "goals": self.counts["goals"],
            "goals_reached": self.counts["goals reached"],
            "goals_failed": self.counts["goals failed"],
        }
        model = harness.model_process()
        for name, pid in (("service", harness.service.pid), ("model", model and model.pid)):
            used = usage(pid) if pid is not None else None
            # None: the process does not run.
            sample[name] = used and {
                "pid": pid,
                "memory_mb": round(used.memory_mb, 2),
                "shared_mb": round(used.shared_mb, 2),
                "threads": used.threads,
                "descriptors": used.descriptors,
                "cpu_s": round(used.cpu_s, 2),
            }
        return sample


def _rate_hz(beats: list[tuple[float, int]]) -> float:
    """Return the tick rate between the first and the last; 0 if the count began again."""
    (first_s, first), (last_s, last) = beats[0], beats[-1]
    return max(0, last - first) / (last_s - first_s) if last_s > first_s else 0.0


def dropped(page: str) -> dict[str, int]:
    """Return the messages that became part of no observation, by reason, from `/metrics`."""
    samples = (s for family in text_string_to_metric_families(page) for s in family.samples)
    return {s.labels["reason"]: int(s.value) for s in samples if s.name == _DROPPED and s.value}


def _age_s(path: Path) -> float | None:
    try:
        return round(time.time() - path.stat().st_mtime, 1)
    except FileNotFoundError:
        return None


def _read_problem(path: Path, form: CheckpointFormat) -> str:
    """Return why a checkpoint cannot be read; "" if it can, or if it is not there yet."""
    try:
        with path.open("rb") as file:
            form.decode(file.read(form.max_bytes + 1))
    except FileNotFoundError:
        return ""
    except (OSError, ValueError) as error:
        return str(error)
    return ""
