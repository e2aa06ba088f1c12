"""A running mission: automaton, knowledge about its targets, and plan (ViTL algorithm 1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from edge.config import MissionConfig
from edge.geometry import SE2
from edge.mission.destinations import (
    Destination,
    FailureTarget,
    PlaceTarget,
    RoomTarget,
    WaitTarget,
    has_own_end,
)
from edge.mission.logic.automaton import NOTHING
from edge.mission.meter import MissionMeter
from edge.mission.planning.plan import Planner, TargetPlan
from edge.mission.planning.planner import make_planner
from edge.mission.planning.task_planner import TaskPlanner
from edge.mission.progress import MissionProgress
from edge.mission.spec import MissionSpec
from edge.mission.target_sets import TargetSets
from edge.text import one_line
from edge.types import MissionEvent, MissionEventKind, MissionPhase, MissionStatus

PROBABLY = "probably"
"""First word of the evidence in the mission log if the detector was not sure of an object."""
MAX_EVENTS = 1000
"""Largest number of entries in the mission log."""
_MOST_RESULTS = 20  # results that the reason of the end shows
_RESULT_CHARS = 400  # longest text of one result


class MissionRun:
    """A running mission: it advances the automaton and chooses the target to pursue.

    A target is a proposition of the formula, and its label is its name. Each step of a trace is a
    label or `NOTHING`. The instances of a target are the known objects of its name.

    The automaton moves when the active target is reached. If the formula requires it, it also takes
    a step in which nothing is reached. The mission is planned again when one of the sets D
    (detected), R (reached) or B (failed) changes; with distances as weights, also when new ones
    come.

    Attributes:
        plan: plan from the current state to acceptance.
        target: the target to pursue now; after the end, the last one.
        progress: the automaton's state, the trace and the round.
        sets: the sets D, R and B.
        meter: time and path, for the limits.
        results: what the mission found out so far, for the reason of its end.
        log: the mission log, oldest entry first, at most the last `MAX_EVENTS`.
        started: True after `start`.
        paused: while True, time and path do not count and no target is pursued.
        stopped: why the robot is stopped (`edge.host.stop_latch`); as a pause, until it is "".
        retargets: number of times that a new target was set.
        changes: number of changes that a checkpoint should hold.
        config: the `mission` section; may be replaced to change the limits.
        destinations: targets that are no objects; `locate` sets poses that were not known before.
        id: the requester's name of the mission; "" if there is none.
        activity: what the robot does for the active target, for the status; "" to say nothing.
        question: text about an object that a person may confirm as the target now; "" if none.
        ended: outcome of the mission, `idle` for a placeholder until the first mission is given;
            None before the end.
        reason: reason of the end; "" before it.
    """

    def __init__(
        self,
        spec: MissionSpec,
        config: MissionConfig,
        on_event: Callable[[MissionEvent], None] = lambda event: None,
        id: str = "",
    ) -> None:
        """Create the run; call `start` to begin it."""
        self.spec = spec
        self.id = id
        self.target = spec.targets[0]
        self.progress = MissionProgress(spec)
        self.destinations: dict[str, Destination] = dict(spec.translation.destinations)
        places = self.destinations.items()
        failures = {n: d.target for n, d in places if isinstance(d, FailureTarget)}
        known = [n for n, d in places if not isinstance(d, RoomTarget)]
        self.sets, self.meter = TargetSets(known, failures), MissionMeter()
        self.started = False
        self.paused = False
        self.stopped = ""
        self.retargets = 0
        self.changes = 0
        self.activity = ""
        self.question = ""
        self.reason = ""
        self.results: tuple[str, ...] = ()
        self.log: tuple[MissionEvent, ...] = ()
        self.config = config
        self._on_event = on_event
        self._planner: Planner = (
            make_planner(config.planner, spec.automaton, spec.translation.instruction)
            if spec.steps is None
            else TaskPlanner(spec.targets, spec.steps)
        )
        self.ended: Literal["idle", "reached", "failed"] | None = None
        self.plan: TargetPlan = self._planner.plan(self.progress.state, self.sets.knowledge)

    # -- properties -------------------------------------------------------------------------

    @property
    def done(self) -> bool:
        """True if the mission has ended or has not been given yet."""
        return self.ended is not None

    @property
    def active(self) -> bool:
        """True while a target is pursued: the mission has not ended, paused or been stopped."""
        return not (self.done or self.paused or self.stopped)

    @property
    def pursued_now_s(self) -> float:
        """Time for which the active target has been pursued."""
        return self.meter.pursued_s.get(self.target, 0.0)

    def status(self, phase: MissionPhase) -> MissionStatus:
        """Return the status of the mission; `phase` applies while the mission is active."""
        repeat, activity = self.spec.translation.repeat, ""
        if self.stopped:
            phase, activity = "stopped", f"{self.stopped}; waits for `edge release`"
        elif self.paused:
            phase = "paused"
        elif not self.done:
            elapsed_s = self.meter.elapsed_s
            rounds = "" if repeat is None else repeat.shown_round(self.progress.round, elapsed_s)
            activity = "; ".join(filter(None, (rounds, self.activity)))
        return MissionStatus(
            self.target,
            self.ended or phase,
            self.reason or activity,
            self.meter.elapsed_s,
            self.meter.path_m,
            one_line(self.spec.translation.instruction),
        )

    # -- time, path and limits ----------------------------------------------------------------

    def locate(self, start: SE2, here: SE2) -> None:
        """Set the poses that were not known when the mission was prepared."""
        for name, pose in (("start", start), ("here", here)):
            if self.destinations.get(name) == PlaceTarget():
                self.destinations[name] = PlaceTarget(pose)
                self.changes += 1

    def start(self, now_ns: int) -> None:
        """Write the first log entries: the understood mission and the first target."""
        self.started = True
        if self.done:
            return
        spec = self.spec
        kind, formula = "task", ""
        if spec.steps is None:
            kind, formula = "mission", f" [{one_line(spec.automaton.formula)}]"
        self.log_event(now_ns, "start", "", f"{kind}: {spec.translation.understood}{formula}")
        for warning in spec.warnings:
            self.log_event(now_ns, "warning", "", warning)
        self.replan(now_ns, retarget=True)

    def observe(self, pose: SE2 | None, now_ns: int, searching: bool = True) -> None:
        """Count time and path; see `MissionMeter.add`."""
        target = self.target if self.active else None
        destination = self.destinations.get(self.target)
        searching = searching or isinstance(destination, WaitTarget)  # which needs no sensors
        exempt = searching and has_own_end(destination)
        self.meter.add(pose, now_ns, target, exempt, searching)

    def check_limits(self, now_ns: int) -> None:
        """End at the end of the repetition; fail at the time or path limit of the mission.

        In a mission that repeats, the limits apply to each round. A target is abandoned at the
        search limit.
        """
        c, repeat = self.config, self.spec.translation.repeat
        if not self.active:
            return
        ends_s = None if repeat is None else repeat.limit_s
        if ends_s is not None and self.meter.elapsed_s > ends_s:
            self.finish("reached", _rounds_text(self.progress.round - 1, self.results), now_ns)
            return
        elapsed_s, path_m = self.meter.limited
        if elapsed_s > c.time_limit_s:
            self.finish("failed", f"time limit of {c.time_limit_s:g} s", now_ns)
        elif path_m > c.path_limit_m:
            self.finish("failed", f"path limit of {c.path_limit_m:g} m", now_ns)
        elif has_own_end(self.destinations.get(self.target)):
            pass
        elif self.pursued_now_s > (c.search_limit_s or math.inf):
            missed = "did not get to" if self.target in self.sets.detected else "no"
            self.abandon_target(f"{missed} {self.target} within {c.search_limit_s:g} s", now_ns)

    # -- events -------------------------------------------------------------------------------

    def on_detections(self, newest: Mapping[str, int], now_ns: int, keep: bool = False) -> None:
        """Update the set D, and plan again if it changes; see `TargetSets.on_detections`.

        The log has objects and rooms, but not places and routines, which are known from the start.
        """
        if self.done or (new := self.sets.on_detections(newest, keep)) is None:
            return
        for label in sorted(new - frozenset(self.sets.reached)):
            self.meter.pursued_s[label] = 0.0
            destination = self.destinations.get(label)
            if destination is None or isinstance(destination, RoomTarget):
                self.log_event(now_ns, "seen", label, f"seen: {label}")
        self.replan(now_ns)

    def on_reached(self, evidence: str, now_ns: int, result: str = "") -> None:
        """Advance the automaton: the active target was reached.

        No other event of a mission with a formula advances it, except steps without an object.
        """
        label = self.target
        if result:
            self.results = (*self.results, one_line(result, _RESULT_CHARS))[-_MOST_RESULTS:]
        self.progress.advance(label)
        self.sets.add_reached(label)
        self.meter.end_pursuit(label)
        self.log_event(now_ns, "reached", label, f"reached: {label} ({evidence})")
        self._accept(evidence, now_ns)
        self.replan(now_ns, retarget=True)

    def on_task_steps_driven(self, steps: int, now_ns: int) -> None:
        """Record that the first `steps` steps of a task were driven; the last one ends the task."""
        task_steps = self.spec.steps
        assert task_steps is not None
        while self.progress.state < steps:
            text = one_line(task_steps[self.progress.state].said, 60)
            self.progress.advance(NOTHING)
            if not self._accept("driven to its end", now_ns):
                self.log_event(now_ns, "trajectory", "", f"driven: {text}")
        if not self.done:
            self.replan(now_ns)

    def abandon_target(self, reason: str, now_ns: int) -> None:
        """Add the active target to B because it could not be reached, and plan again."""
        label = self.target
        self.sets.add_failed(label, reason)
        self.meter.end_pursuit(label)
        self.log_event(now_ns, "failed", label, f"failed: {label} ({reason})")
        self.replan(now_ns, retarget=True)

    def pause(self, paused: bool) -> None:
        """Pause or resume the mission; time does not count while it is paused."""
        self.paused = paused
        self.changes += 1

    def set_idle(self) -> None:
        """Become the idle placeholder until the first mission is given."""
        self.ended, self.reason = "idle", "waiting for a mission"

    def cancel(self, reason: str, now_ns: int) -> None:
        """End the mission because a person says so.

        The mission then fails. One that repeats without an end is fulfilled: this is its regular
        end.
        """
        repeat = self.spec.translation.repeat
        if repeat is not None and repeat.endless:
            reason = f"{reason}; {_rounds_text(self.progress.round - 1, self.results)}"
            self.finish("reached", reason, now_ns)
        else:
            self.finish("failed", reason, now_ns)

    def finish(self, ended: Literal["reached", "failed"], reason: str, now_ns: int) -> None:
        """End the entire mission, unless it has already ended."""
        if self.done:
            return
        self.ended, self.reason, self.question = ended, reason, ""
        self.log_event(now_ns, "end", "", f"{ended}: {reason}")

    def log_event(self, now_ns: int, kind: MissionEventKind, label: str, text: str) -> None:
        """Add an entry to the mission log."""
        self.changes += 1
        event = MissionEvent(now_ns, kind, label, self.progress.state, text)
        self.log = (*self.log, event)[-MAX_EVENTS:]
        self._on_event(event)

    def replan(self, now_ns: int, retarget: bool = False) -> None:
        """Plan from the current state. Take at once each planned step that reaches no object.

        Such a step has no target, or its target is the failure of another one.

        Args:
            now_ns: time of the loop.
            retarget: True if the present target is settled, so that the planner does not favour it.
        """
        self.changes += 1
        if retarget:
            self.question = ""
        while not self.done:
            current = None if retarget else self.target
            self.plan = self._planner.plan(self.progress.state, self.sets.knowledge, current)
            label = self.target
            may_leave_out = not self.plan.feasible and label in self.sets.failed
            if may_leave_out and self.progress.leave_out(label):
                self.sets.failed -= {label}
                text = f"left out in round {self.progress.round}: {label}"
                self.log_event(now_ns, "warning", label, text)
                self._accept("left out", now_ns)
                continue
            if not self.plan.feasible:
                self.finish("failed", self.sets.failure_reasons or self.plan.reason, now_ns)
                return
            step = self.plan.target or NOTHING
            why_failed = self.sets.failure_reason(step)
            if step != NOTHING and not why_failed:
                break
            if not self._accept("nothing more to reach", now_ns):
                self.progress.advance(step)
                text = f"{step}: goes on" if step else "a step in which nothing is reached"
                self.log_event(now_ns, "nothing", step, text)
                self._accept(why_failed, now_ns)
        if self.done:
            return
        # The plan has no steps if a task has detected all objects that it needs.
        if self.plan.steps and (retarget or self.plan.target != self.target):
            self.retargets += 1
            self.target, self.activity = self.plan.target, ""
            self.log_event(
                now_ns, "target", self.target, f"target: {self.target}: {self.plan.reason}"
            )

    def _accept(self, evidence: str, now_ns: int) -> bool:
        """End the mission, or the round, if the formula is fulfilled; return True if it is."""
        progress, repeat = self.progress, self.spec.translation.repeat
        if not progress.accepted:
            return False
        if repeat is None:
            taken = [label for label in progress.trace if label != NOTHING]
            order = ", then ".join(taken) if len(taken) > 1 else evidence
            self.finish("reached", "; ".join(self.results) or order, now_ns)
        elif progress.round == repeat.rounds:
            self.finish("reached", _rounds_text(progress.round, self.results), now_ns)
        else:
            progress.begin_round()
            self.sets.begin_round()
            self.meter.begin_round()
            shown = repeat.shown_round(progress.round, self.meter.elapsed_s)
            self.log_event(now_ns, "round", "", shown)
        return True


def forget_places(mission: MissionRun, now_ns: int) -> None:
    """Give up the places of a mission, whose poses are in an old map frame, in all rounds."""
    places = mission.destinations.items()
    settled = mission.sets.reached if mission.spec.translation.repeat is None else ()
    lost = [
        name
        for name, place in places
        if isinstance(place, PlaceTarget) and place.pose is not None and name not in settled
    ]
    if mission.done or not lost:
        return
    for name in lost:
        reason = f"{name}: its place was in the old map frame"
        mission.sets.add_lost(name, reason)
        mission.log_event(now_ns, "failed", name, f"failed: {reason}")
    mission.replan(now_ns, retarget=mission.target in lost)


def _rounds_text(rounds: int, results: Sequence[str]) -> str:
    """Return the reason of the end after some rounds."""
    return "; ".join((f"{rounds} round{'s' * (rounds != 1)} done", *results))
