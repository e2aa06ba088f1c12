"""Replay of a recorded run through the real service, tick for tick.

Background workers do not run: their recorded answers arrive in the recorded ticks. With another
configuration the loop takes other decisions. Then workers that need only the map (the travel-cost
survey, the room segmentation) do run; answers of detectors and scorers stay as recorded.

A page is one message of the recording's journal: the inputs since the last page, in order, and the
observation and decisions of their last tick. In names, `then` is the recorded run and `now` the
replay.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter_ns
from typing import Any

from edge.config import ChoiceCooccurrence, Config, DetectorOnnx
from edge.errors import UserError
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.checkpoints.map_checkpoint import SUFFIX
from edge.loop.error_boundary import TICK
from edge.loop.input_log import TASK, USE, LoopInput
from edge.loop.result import TickResult
from edge.loop.scoring.scorers import Scorers, make_scorers
from edge.loop.service import Service
from edge.loop.stages import INGEST, STAGES
from edge.memory import Site, SiteFile
from edge.mission.spec import restore_spec
from edge.perception.detection.detector import Detector
from edge.perception.factory import make_detector
from edge.perception.masks.ground import make_ground_classifier
from edge.perception.masks.masker import make_masker
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy
from edge.recording.file import RecordingError
from edge.recording.journal import decisions_of
from edge.recording.replay_source import NullModel, ReplaySource, ReplayTick
from edge.recording.session import RecordedRun, RecordedStep
from edge.text import one_line
from edge.types import Detections, Observation

_MAP_WORKERS = ("travel_cost", "rooms")  # workers that need only the map


class ReplayError(UserError):
    """A recording cannot be replayed with these options; the message is one line."""


@dataclass(frozen=True)
class Difference:
    """A tick with different decisions.

    Attributes:
        tick: number of the tick, from 1; 0: before the first.
        stamp_ns: stamp of the observation; 0: there was none.
        recorded: recorded decisions, see `edge.recording.journal.decisions_of`; None: none.
        replayed: replayed decisions; None: none.
    """

    tick: int
    stamp_ns: int
    recorded: dict[str, Any] | None
    replayed: dict[str, Any] | None


@dataclass
class ReplayResult:
    """Result of a replay.

    Attributes:
        differing: number of ticks with different decisions.
        goals_then: number of recorded goals.
        n_unrecorded: images for the detector that were not recorded.
        ended: why the replay ended before the run; empty if it reached the run's end.
        phase_then: last recorded phase of the mission.
        seconds: time from the first to the last replayed observation.
    """

    ticks: int = 0
    differing: int = 0
    first: Difference | None = None
    goals_then: int = 0
    goals_now: int = 0
    n_unrecorded: int = 0
    ended: str = ""
    phase_then: str = ""
    phase_now: str = ""
    seconds: float = 0.0


class DecisionSink:
    """The sink of a replay: collects the decisions of results."""

    def __init__(self) -> None:
        self.decisions: list[dict[str, Any]] = []

    def tick(self, result: TickResult) -> None:
        """Collect decisions; see `edge.loop.result.Sink`."""
        if (decisions := decisions_of(result)) is not None:
            self.decisions.append(decisions)

    def close(self) -> None:
        """Do nothing."""


def _is_refused(step: RecordedStep) -> bool:
    """Return True if the observation was refused, so that no detector got it."""
    decisions = (e.fields for e in step.page.entries if e.kind == "decision")
    return any(fields["name"] == USE and fields["value"] for fields in decisions)


class _ReplayedService:
    """A service that gets the recorded inputs.

    Args:
        config: another configuration; None: the recorded one.
        detect: run the detector on the recorded images.
        stack: closes all that the run opens.
    """

    def __init__(
        self, run: RecordedRun, config: Config | None, detect: bool, stack: ExitStack
    ) -> None:
        self._has_other_config = config is not None
        self._run, self._detect, self._stack = run, detect, stack
        self.config = self._limit(run.config()) if config is None else _replay_settings(config)
        self._tick_events, self.sink = ReplayTick(), DecisionSink()
        self._replay_source: ReplaySource | None = None
        self._failed: Observation | None = None  # observation of a failed or refused tick
        self.service: Service | None = None
        self._worker: DetectorWorker | None = None

    def _limit(self, config: Config) -> Config:
        """Return the recorded configuration without file names."""
        if self._run.trust:
            return _replay_settings(config)
        config, detector = _replay_settings(config), config.perception.detector
        if not isinstance(detector, DetectorOnnx):
            return config
        if self._detect and detector.vocabulary is not None:
            raise ReplayError(
                "--detect: perception.detector.vocabulary: not read, because a recording may "
                "name any file: give your own configuration with --config, or --trust if you know "
                "who made it"
            )
        detector = detector.model_copy(update={"engine_cache": None, "vocabulary": None})
        perception = config.perception.model_copy(update={"detector": detector})
        return config.model_copy(update={"perception": perception})

    @property
    def n_unrecorded(self) -> int:
        return 0 if self._replay_source is None else self._replay_source.n_unrecorded

    def apply(self, step: RecordedStep) -> None:
        """Give the inputs of a page to the service."""
        if step.observation is not None and not _is_refused(step):
            self._tick_events.add_frame(step.observation, step.picture)
        for action, entries in _actions(step.page.entries):
            self._tick_events.begin(entries)
            if self._worker is not None:
                self._count_images(entries)
            if action.kind == "start":
                self._start(**action.fields)
            elif self.service is None:
                raise RecordingError("damaged: the journal does not begin with the service's start")
            else:
                _HANDLERS[action.kind](self, step.observation, **action.fields)

    def _start(
        self,
        translation: Any,
        mission_checkpoint: bytes | None,
        map_checkpoint: bytes | None,
        idle: bool,
        site: Site,
        task: Any = None,
    ) -> None:
        """Start the service as it was started when the run was recorded."""
        config = self.config
        spec = restore_spec(config.mission, translation, task)
        checkpoint = self._checkpoint(mission_checkpoint, map_checkpoint)
        detector: Detector = NullModel("replay")
        detect: Callable[[Observation], Detections] | None = None  # None: recorded detections
        if self._detect:
            if config.perception.detector.kind == "sim":
                raise ReplayError(
                    "--detect: perception.detector.kind: sim cannot detect in images: name a "
                    "model with --config, or EDGE__PERCEPTION__DETECTOR__KIND=onnx"
                )
            masker = make_masker(config.perception, timed=False)
            detector = make_detector(config.perception, spec.prompts)
            detect = detector.detect if masker is None else lambda o: masker.add(detector.detect(o))
        self._worker = worker = DetectorWorker(detector, inline=True)
        self._stack.callback(worker.close)
        scorers = self._scorers(spec.prompts)
        real_workers: tuple[str, ...] = ()
        if self._has_other_config:
            real_workers = _MAP_WORKERS
            if isinstance(config.perception.choice, ChoiceCooccurrence):
                real_workers = (*real_workers, "choice")
            if config.tasks.planner.kind == "rules":
                real_workers = (*real_workers, TASK)
        self._replay_source = ReplaySource(self._tick_events, detect, real_workers)
        policy = make_policy(config.policy, config.path)
        self.service = Service(
            config, spec, worker, policy, [self.sink], checkpoint, scorers,
            idle=idle, input_log=self._replay_source, site=SiteFile(site=site),
            ground=make_ground_classifier(config.tasks) if TASK in real_workers else None,
        )  # fmt: skip
        self._stack.callback(self.service.close)

    def _checkpoint(self, *files: bytes | None) -> ServiceCheckpoint | None:
        """Return the checkpoint that the run loaded, from the files of mission and map, or None."""
        if files == (None, None):
            return None
        folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="edge-replay-"))
        path = Path(folder) / "checkpoint"
        for suffix, content in zip(("", SUFFIX), files, strict=True):
            if content is not None:
                path.with_name(path.name + suffix).write_bytes(content)
        checkpoint = ServiceCheckpoint(self.config, path, None)
        self._stack.callback(checkpoint.close)
        for problem in filter(None, (checkpoint.problem, checkpoint.map.problem)):
            raise ReplayError(f"the checkpoint in the recording cannot be used: {problem}")
        return checkpoint

    def _count_images(self, entries: Sequence[LoopInput]) -> None:
        """Set the number of images that the detector had processed when the loop asked."""
        for entry in entries:
            if entry.kind == "images":
                self._worker.stats.done = entry.fields["done"]

    def _scorers(self, targets: Sequence[str]) -> Scorers | None:
        """Return the scorers of the configuration, with models that are never called."""
        scorers = make_scorers(
            self.config, targets,
            make_similarity=lambda card, *_: NullModel(card.name),
            make_choice=lambda choice, perception: NullModel(choice.kind),
        )  # fmt: skip
        if scorers is not None:
            self._stack.callback(scorers.close)
        return scorers

    # -- inputs by kind ----------------------------------------------------------------------------

    def _tick(self, observation: Observation, now_ns: int) -> None:
        """Run a tick as `edge.loop.runner` does."""
        service = self.service
        service.latency.begin_tick(perf_counter_ns())
        service.latency.mark(INGEST, perf_counter_ns())
        self._failed = None
        try:
            service.tick(observation, now_ns)
        except Exception as error:
            self._failed = observation
            service.latency.abandon_tick(service.stage)
            service.error_boundary.on_error(TICK, error, now_ns, where=STAGES[service.stage].name)
        else:
            self._failed = observation if service.refused else None
            service.latency.end_tick(perf_counter_ns())

    def _idle(self, observation: Observation | None, now_ns: int, pose: Any) -> None:
        failed, self._failed = self._failed, None
        self.service.idle(now_ns, pose, failed)

    def _begin(
        self,
        observation: Observation | None,
        translation: Any,
        id: str,
        now_ns: int,
        task: Any = None,
    ) -> None:
        """Begin a recorded mission."""
        self.service.begin(restore_spec(self.config.mission, translation, task), now_ns, id)

    def _reconfigure(self, observation: Observation | None, config: Config) -> None:
        """Apply a recorded reload, unless another configuration is used for the entire run."""
        if not self._has_other_config:
            self._run.check(config)
            config, service = self._limit(config), self.service
            same = config.policy == service.config.policy
            policy = service.perception.policy if same else make_policy(config.policy, config.path)
            service.reconfigure(config, policy)


def _replay_settings(config: Config) -> Config:
    """Return the configuration for a replay: lockstep, without sinks and checkpoint."""
    loop = config.loop.model_copy(update={"lockstep": True})
    mission = config.mission.model_copy(update={"checkpoint": None})
    return config.model_copy(update={"loop": loop, "mission": mission, "sinks": ()})


# Kind of an input → function (replayed service, observation, its fields).
_HANDLERS: dict[str, Callable[..., None]] = {
    "tick": _ReplayedService._tick,
    "idle": _ReplayedService._idle,
    "goal_status": lambda replayed, _, goal_status: replayed.service.on_goal_status(goal_status),
    "mission": _ReplayedService._begin,
    "site": lambda replayed, _, site, now_ns: replayed.service.change_site(site, now_ns),
    "pause": lambda replayed, _, paused, now_ns: replayed.service.control.pause(paused, now_ns),
    "stop": lambda replayed, _, reason, now_ns: replayed.service.control.stop(reason, now_ns),
    "cancel": lambda replayed, _, reason, now_ns: replayed.service.control.cancel(reason, now_ns),
    "confirm": lambda replayed, _, now_ns: replayed.service.control.confirm(now_ns),
    "fail": lambda replayed, _, reason, now_ns: replayed.service.control.fail(reason, now_ns),
    "config": _ReplayedService._reconfigure,
    "jump": lambda replayed, _, now_ns: replayed.service.on_pose_jump(now_ns),
}


def _actions(entries: Sequence[LoopInput]) -> Iterator[tuple[LoopInput, list[LoopInput]]]:
    """Yield each input with the worker events and decisions that happened while it was handled.

    In the journal, these events follow their input.
    """
    action, events = None, []
    for entry in entries:
        if entry.kind in ("request", "result", "decision", "images"):
            events.append(entry)
            continue
        if action is not None:
            yield action, events
        action, events = entry, []
    if action is not None:
        yield action, events


def replay(run: RecordedRun, config: Config | None = None, detect: bool = False) -> ReplayResult:
    """Replay a recorded run through a service and compare the decisions.

    Args:
        run: the recorded run.
        config: another configuration than the recorded one; the mission stays the recorded one.
        detect: run the detector on the recorded images instead of using recorded detections.

    Raises:
        RecordingError: the recording does not begin with the run, or is malformed.
        ReplayError: there is no usable detector.
        UserError: configuration, mission or model cannot be used.
    """
    if run.head.part:
        raise RecordingError(
            f"{run.head.path}: file {run.head.part + 1} of a run: replay the first file; "
            "the others in the folder follow"
        )
    outcome, first_ns = ReplayResult(), None
    with ExitStack() as stack:
        replayed = _ReplayedService(run, config, detect, stack)
        for step in run.steps():
            try:
                replayed.apply(step)
            except UserError:
                raise
            except Exception as error:  # an error that the loop survived, or damaged data
                raise RecordingError(
                    f"{run.head.path}: the replay failed after {outcome.ticks} ticks; the "
                    "recorded run had an error, or the recording is damaged: "
                    f"{type(error).__name__}: {one_line(error, 120)}"
                ) from error
            _compare(outcome, step, replayed.sink.decisions)
            replayed.sink.decisions.clear()
            if step.observation is not None:
                first_ns = step.observation.stamp_ns if first_ns is None else first_ns
                outcome.seconds = (step.observation.stamp_ns - first_ns) * 1e-9
        outcome.n_unrecorded, outcome.ended = replayed.n_unrecorded, run.gap or run.truncation
    return outcome


def _compare(outcome: ReplayResult, step: RecordedStep, now: list[dict[str, Any]]) -> None:
    """Compare the decisions of a page with those of the replay, and update the result."""
    then = [] if step.page.decisions is None else [step.page.decisions]
    outcome.ticks += sum(entry.kind == "tick" for entry in step.page.entries)
    outcome.goals_then += sum(len(decisions["sent"]) for decisions in then)
    outcome.goals_now += sum(len(decisions["sent"]) for decisions in now)
    outcome.phase_then = then[-1]["phase"] if then else outcome.phase_then
    outcome.phase_now = now[-1]["phase"] if now else outcome.phase_now
    if then != now:
        outcome.differing += 1
        if outcome.first is None:
            stamp_ns = 0 if step.observation is None else step.observation.stamp_ns
            outcome.first = Difference(
                outcome.ticks, stamp_ns, then[-1] if then else None, now[-1] if now else None
            )
