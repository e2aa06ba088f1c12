"""Prometheus metrics of the service: `/metrics` (docs/metrics.md).

The loop does no work for the metrics. A scrape reads, on its own thread, the numbers that the
service counts anyway: numbers, strings and frozen objects that the loop's thread replaces at
once, dicts of counts (copied in one step of the interpreter), and methods that any thread may call
(`LatencyRing`, `RollingMap.known_m2`, `Detector.health`). Two values may therefore come from two
ticks. A scrape does not wait for the loop, except for the lock of the ring, which the loop holds
for microseconds. So a loop that hangs is visible, too.

Outside texts (instructions, targets, errors) are not labels, because each would create a series
that lasts forever.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, get_args

from prometheus_client.core import Metric

from edge import __version__
from edge.host.board import BoardReading, read_board
from edge.host.web_server import GetRoutes
from edge.loop.monitoring.exposition import Exposition, MetricSpec, read_table
from edge.loop.monitoring.service_health import STATES, ServiceHealth
from edge.loop.publish import statuses
from edge.loop.reload import OUTCOMES
from edge.loop.result import Sink
from edge.loop.runner import RunningService
from edge.loop.source import NO_DROPS
from edge.loop.status import detector_health
from edge.perception.detection.process import ProcessDetector
from edge.perception.runtime.health import MODEL_STATES
from edge.tasks.facts import StepState
from edge.types import CandidateKind, MissionPhase

_STEP_STATES = get_args(StepState)
_GOALS = ("none", *get_args(CandidateKind))
_S_PER_MS = 1e-3


class ScrapeSnapshot:
    """The state of a running service at one scrape; the source of `SERVICE_METRICS`.

    Attributes:
        sinks: Status of each sink by name.
        failed: Names of the plausibility checks that fail.
        latency: Latency report: counts since the start, without percentiles.
        images: Counts of the detector's images.
        scorers: Status of each scorer by name.
        checkpoint: Status of the checkpoint; None without one.
    """

    def __init__(self, running: RunningService, sinks: Sequence[Sink]) -> None:
        service = running.service
        self.running, self.service, self.sinks = running, service, statuses(sinks)
        self.mission, self.goal = service.mission, service.goals.goal
        self.source, self.inputs = dict(running.source.counters), service.parts_status.inputs()
        self.failed = {found.name for found in service.plausibility.failed}
        self.latency = service.latency.report(last=1)
        self.histograms = service.latency.histograms()
        self.detector, self.images = running.worker.detector, running.worker.stats
        scorers = service.perception.scorers
        self.scorers: dict[str, Any] = {} if scorers is None else scorers.status()
        self.checkpoint = None if service.checkpoint is None else service.checkpoint.status()

    def by_stage(self, value: Callable[[Any], float]) -> dict[str, float]:
        """Apply `value` to each stage of the latency report. Return the results by stage name."""
        return {row.name: value(row) for row in self.latency.stages}

    def by_budgeted_stage(self, value: Callable[[Any], float]) -> dict[str, float]:
        """Do the same as `by_stage`, but only for stages with a time budget."""
        return {row.name: value(row) for row in self.latency.stages if row.budget_ms is not None}

    def of_sinks(self, name: str) -> dict[str, int]:
        """Return an integer field of the sinks' status, by sink, if it has the field."""
        values = {sink: status.get(name) for sink, status in self.sinks.items()}
        return {sink: n for sink, n in values.items() if isinstance(n, int)}

    def models(self) -> Iterator[tuple[str, str]]:
        """Yield (part, name) of every model in use."""
        yield "detector", self.detector.name
        yield from ((part, str(status["model"])) for part, status in self.scorers.items())


def _seconds(ms: float | None) -> float:
    return math.nan if ms is None else round(ms * _S_PER_MS, 9)


def _errors(snapshot: ScrapeSnapshot) -> dict[tuple[str, str], int]:
    """Count the errors by (step, type of error)."""
    kinds = dict(snapshot.service.error_boundary.failures)
    return {(kind.partition(": ")[0], kind.partition(": ")[2]): n for kind, n in kinds.items()}


def _task_steps(snapshot: ScrapeSnapshot) -> dict[str, int]:
    """Count the steps of a task by state."""
    task = snapshot.service.behaviour.task_status()
    counted = Counter(step.state for step in task.steps) if task else Counter()
    return {state: counted[state] for state in _STEP_STATES}


def _answers(snapshot: ScrapeSnapshot) -> dict[tuple[str, str], int]:
    """Count the answers by (scorer, outcome)."""
    return {
        (part, outcome): status[outcome]
        for part, status in snapshot.scorers.items()
        for outcome in ("answered", "failed")
        if outcome in status
    }


HEALTH_METRICS: tuple[MetricSpec[ServiceHealth], ...] = (
    MetricSpec("edge_build_info", "gauge", "Version of edge (label version); always 1.",
           lambda h: {__version__: 1}, ("version",)),
    MetricSpec("edge_service_state", "state",
           "State of the service: 1 for the current one, else 0.",
           lambda h: h.state, states=STATES),
    MetricSpec("edge_service_ready", "gauge",
           "1 if the service is ready, as /readyz reports, else 0.",
           lambda h: not h.problems()),
    MetricSpec("edge_loop_beat_age_seconds", "gauge",
           "Time since the loop's last cycle; it grows if the loop hangs.",
           lambda h: h.silent_s),
    MetricSpec("edge_observation_age_seconds", "gauge",
           "Time since the newest usable observation; infinite before the first.",
           lambda h: h.no_observation_s),
)  # fmt: skip
"""Metrics of the service's health, available from its start on."""

SERVICE_METRICS: tuple[MetricSpec[ScrapeSnapshot], ...] = (
    # The tick.
    MetricSpec("edge_tick_duration_seconds", "histogram", "Duration of a tick.",
           lambda s: s.histograms.tick),
    MetricSpec("edge_tick_budget_seconds", "gauge",
           "Budget of ticks: the 95th percentile of their durations should stay below.",
           lambda s: _seconds(s.latency.tick.budget_ms)),
    MetricSpec("edge_tick_deadline_seconds", "gauge", "Longest permitted duration of a tick.",
           lambda s: _seconds(s.latency.deadline_ms)),
    MetricSpec("edge_tick_deadline_missed_total", "counter",
           "Ticks that took longer than the deadline.",
           lambda s: s.latency.tick.overruns),
    MetricSpec("edge_tick_interval_seconds", "histogram",
           "Time from the start of a tick to the start of the next.",
           lambda s: s.histograms.interval),
    MetricSpec("edge_tick_period_seconds", "gauge", "Configured period of ticks (1 / loop.hz).",
           lambda s: 1.0 / s.running.config.loop.hz),
    MetricSpec("edge_stage_duration_seconds", "histogram",
           "Duration of a stage; detect runs in parallel to the tick.",
           lambda s: s.histograms.stages, ("stage",)),
    MetricSpec("edge_stage_budget_seconds", "gauge",
           "Budget of a stage: the 95th percentile of its durations should stay below. Without "
           "`edge bench --calibrate`, only stages with a deadline have one: the deadline.",
           lambda s: s.by_budgeted_stage(lambda row: _seconds(row.budget_ms)), ("stage",)),
    MetricSpec("edge_stage_over_budget_total", "counter",
           "Runs of a stage that took longer than its budget.",
           lambda s: s.by_budgeted_stage(lambda row: row.overruns), ("stage",)),
    MetricSpec("edge_stage_dropped_total", "counter",
           "Inputs dropped by a stage: messages (ingest), images (detect), failed ticks.",
           lambda s: s.by_stage(lambda row: row.drops), ("stage",)),
    # Inputs.
    MetricSpec("edge_source_received_total", "counter", "Messages received from sensors.",
           lambda s: s.source.get("received", 0)),
    MetricSpec("edge_source_observations_total", "counter",
           "Observations made from the messages of sensors.",
           lambda s: s.source.get("observations", 0)),
    MetricSpec("edge_source_old_pose_total", "counter",
           "Observations whose pose or mount transform is older than they are.",
           lambda s: s.source.get("old_pose", 0)),
    MetricSpec("edge_source_dropped_total", "counter",
           "Messages from sensors that were not used in an observation, by reason.",
           lambda s: {why: n for why, n in s.source.items() if why not in NO_DROPS}, ("reason",)),
    MetricSpec("edge_input_dropped_total", "counter",
           "Messages from sensors that were not used in an observation, by input and reason.",
           lambda s: {(row.name, why): n for row in s.inputs for why, n in row.dropped.items()},
           ("input", "reason")),
    MetricSpec("edge_input_rate_hertz", "gauge", "Message rate of an input.",
           lambda s: {row.name: row.hz for row in s.inputs}, ("input",)),
    MetricSpec("edge_input_age_seconds", "gauge",
           "Time since an input's newest message; infinite before the first.",
           lambda s: {row.name: math.inf if row.age_s is None else row.age_s for row in s.inputs},
           ("input",)),
    MetricSpec("edge_input_lacking", "gauge",
           "1 if a needed input is missing or silent, or all its messages are dropped, else 0.",
           lambda s: {row.name: row.is_lacking for row in s.inputs}, ("input",)),
    MetricSpec("edge_check_failed", "gauge",
           "1 if this check of the sensor data fails now, else 0.",
           lambda s: {row.name: row.name in s.failed for row in s.service.plausibility.checks},
           ("check",)),
    MetricSpec("edge_observations_refused_total", "counter",
           "Observations not used for driving, by the check of the sensor data that failed.",
           lambda s: dict(s.service.plausibility.refused), ("check",)),
    MetricSpec("edge_overruns_total", "counter",
           "Times that a message buffer (ring) was full, so that messages were lost, by ring.",
           lambda s: s.service.parts_status.overruns(), ("ring",)),
    MetricSpec("edge_pose_jumps_total", "counter", "Pose jumps; each one cleared the map.",
           lambda s: s.service.map.epoch),
    # Errors.
    MetricSpec("edge_faults_total", "counter", "Errors that the loop caught.",
           lambda s: s.service.error_boundary.failed),
    MetricSpec("edge_faults_by_step_total", "counter",
           "Errors that the loop caught, by step of the loop and type of error.",
           _errors, ("step", "error")),
    MetricSpec("edge_loop_degraded", "gauge", "1 if a step of the loop keeps failing, else 0.",
           lambda s: s.service.error_boundary.state != "ok"),
    MetricSpec("edge_sink_failures_total", "counter",
           "Messages that a sink could not send or write.",
           lambda s: s.of_sinks("failed"), ("sink",)),
    MetricSpec("edge_sink_dropped_total", "counter",
           "Messages that a sink dropped: replaced by newer ones, or the queue was full.",
           lambda s: s.of_sinks("dropped"), ("sink",)),
    MetricSpec("edge_checkpoint_written_total", "counter", "Checkpoints that reached the disk.",
           lambda s: s.checkpoint and s.checkpoint["written"]),
    MetricSpec("edge_checkpoint_failed_total", "counter", "Checkpoints that could not be written.",
           lambda s: s.checkpoint and s.checkpoint["failed"]),
    # Models.
    MetricSpec("edge_model_info", "gauge", "Model in use (label model) of each part; always 1.",
           lambda s: dict.fromkeys(s.models(), 1), ("part", "model")),
    MetricSpec("edge_detector_state", "state",
           "State of the detector: 1 for the current one, else 0.",
           lambda s: detector_health(s.running.worker).state, states=MODEL_STATES),
    MetricSpec("edge_detector_images_total", "counter",
           "Images by outcome: detected, failed, or replaced by a newer image.",
           lambda s: {"detected": s.images.done, "failed": s.images.failed,
                      "replaced": s.images.replaced}, ("outcome",)),
    MetricSpec("edge_detector_invalid_boxes_total", "counter",
           "Boxes dropped: not finite, far outside the image, or scored outside 0 to 1.",
           lambda s: {s.detector.name: s.detector.invalid_boxes}, ("model",)),
    MetricSpec("edge_model_process_restarts_total", "counter",
           "Restarts of the detector's process; 0 if it has none.",
           lambda s: {s.detector.name: s.detector.restarts
                      if isinstance(s.detector, ProcessDetector) else 0}, ("model",)),
    MetricSpec("edge_model_swaps_total", "counter", "Swaps of the detector's model, by outcome.",
           lambda s: dict(s.service.detector_swap.outcomes), ("outcome",)),
    MetricSpec("edge_load_shedding_level", "gauge",
           "Degradation level (entry of perception.load_shedding.levels); 0: no load is shed.",
           lambda s: s.service.load_shedder and s.service.load_shedder.level),
    MetricSpec("edge_load_shedding_steps_total", "counter",
           "Changes of the degradation level, by direction.",
           lambda s: s.service.load_shedder and dict(s.service.load_shedder.steps), ("direction",)),
    MetricSpec("edge_scorer_answers_total", "counter", "Questions to scorers, by outcome.",
           _answers, ("scorer", "outcome")),
    MetricSpec("edge_reloads_total", "counter", "Reloads of the configuration, by outcome.",
           lambda s: dict.fromkeys(OUTCOMES, 0) if s.running.reloader is None
           else dict(s.running.reloader.outcomes), ("outcome",)),
    MetricSpec("edge_policy_info", "gauge", "Policy in use (label policy); always 1.",
           lambda s: {s.service.config.policy.kind: 1}, ("policy",)),
    # The mission and its goal.
    MetricSpec("edge_mission_state", "state",
           "State of the mission: 1 for the current one, else 0.",
           lambda s: s.mission.status(s.service.goals.phase).phase, states=get_args(MissionPhase)),
    MetricSpec("edge_mission_targets", "gauge", "Number of targets of the mission.",
           lambda s: len(s.mission.spec.targets)),
    MetricSpec("edge_mission_targets_reached", "gauge", "Number of targets that were reached.",
           lambda s: len(s.mission.sets.reached)),
    MetricSpec("edge_mission_plan_steps", "gauge",
           "Number of targets that the plan still has to reach.",
           lambda s: 0 if s.mission.done else len(s.mission.plan.steps)),
    MetricSpec("edge_mission_elapsed_seconds", "gauge", "Time that the mission has taken.",
           lambda s: s.mission.meter.elapsed_s),
    MetricSpec("edge_mission_path_meters", "gauge", "Distance driven for the mission.",
           lambda s: s.mission.meter.path_m),
    MetricSpec("edge_task_steps", "gauge", "Steps of the task, by state.",
           _task_steps, ("state",)),
    MetricSpec("edge_goal_state", "state",
           "Kind of the current goal: 1 for the current one, else 0; none without a goal.",
           lambda s: "none" if s.goal is None else s.goal.kind, states=_GOALS),
    MetricSpec("edge_goal_age_seconds", "gauge", "Time since the current goal was chosen.",
           lambda s: None if s.goal is None
           else max(s.running.now_ns - s.goal.stamp_ns, 0) * 1e-9),
    MetricSpec("edge_controller_answers", "gauge", "1 if a motion controller answers, else 0.",
           lambda s: s.service.goals.client.has_controller),
    # The map.
    MetricSpec("edge_map_known_square_meters", "gauge", "Known area of the map.",
           lambda s: s.service.map.grid.known_m2),
    MetricSpec("edge_map_frontiers", "gauge", "Number of frontiers of the map.",
           lambda s: s.service.map.grid.frontiers.n),
)  # fmt: skip
"""Metrics of the service, available once it is ready."""

BOARD_METRICS: tuple[MetricSpec[BoardReading], ...] = (
    MetricSpec("edge_board_temperature_celsius", "gauge", "Temperature of a thermal zone.",
           lambda b: b.temperature_c, ("zone",)),
    MetricSpec("edge_board_trip_celsius", "gauge",
           "Temperature at which a zone is throttled (passive), too hot (hot) or shut down "
           "(critical).",
           lambda b: b.trip_c, ("zone", "trip")),
    MetricSpec("edge_board_throttled_ratio", "gauge",
           "How far the kernel throttles a part to cool it: 0 not at all, 1 as far as possible.",
           lambda b: b.throttled, ("device",)),
    MetricSpec("edge_board_over_current_total", "counter",
           "Times that a Jetson throttled itself because of over-current or under-voltage.",
           lambda b: b.over_current, ("alarm",)),
    MetricSpec("edge_board_power_watts", "gauge", "Power drawn by a supply rail of the board.",
           lambda b: b.power_w, ("rail",)),
    MetricSpec("edge_board_power_mode_info", "gauge",
           "Power mode of a Jetson (label mode); always 1.",
           lambda b: {} if b.power_mode is None else {b.power_mode: 1}, ("mode",)),
    MetricSpec("edge_board_memory_bytes", "gauge", "Memory of the computer, total and available.",
           lambda b: b.memory_bytes, ("kind",)),
)  # fmt: skip
"""Metrics of the computer. There is no series for a sensor that it does not have."""


class Metrics:
    """The page `/metrics`. Metrics of the service are on it after `add_service` was called."""

    def __init__(
        self, health: ServiceHealth, board: Callable[[], BoardReading] = read_board
    ) -> None:
        self._health, self._board = health, board
        self._watched: tuple[RunningService, Sequence[Sink]] | None = None
        self._exposition = Exposition(self._read)

    def add_service(self, running: RunningService, sinks: Sequence[Sink]) -> None:
        """Add the metrics of a service that is ready. They stay readable after it ends."""
        self._watched = running, sinks

    def pages(self) -> GetRoutes:
        """Return the HTTP handler of `/metrics`."""
        return {"/metrics": self._exposition.page}

    def _read(self) -> Iterator[Metric]:
        """Yield all metrics with their current values."""
        yield from read_table(HEALTH_METRICS, self._health)
        if self._watched is not None:
            yield from read_table(SERVICE_METRICS, ScrapeSnapshot(*self._watched))
        yield from read_table(BOARD_METRICS, self._board())
