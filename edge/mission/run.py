"""A running mission: automaton, knowledge about its targets, and plan (ViTL algorithm 1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from edge.config import MissionConfig
from edge.geometry import SE2
from edge.mission.destinations import Destination, PlaceTarget, RoomTarget, WaitTarget, is_timed
from edge.mission.logic.automaton import NOTHING
from edge.mission.meter import MissionMeter
from edge.mission.planning.plan import Planner, TargetPlan
from edge.mission.planning.planner import make_planner
from edge.mission.planning.task_planner import TaskPlanner
from edge.mission.repetition import Repetition
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
_TRAJECTORY_CHARS = 300  # longest entry about a task's trajectory


class MissionRun:
    """A running mission: it advances the automaton and chooses the target to pursue.

    A target is a proposition of the formula, and its label is its name. A letter of a trace is a
    label or `NOTHING`. The instances of a target are the known objects of its name.

    The automaton moves when the active target is reached. If the formula requires it, it also takes
    a step in which nothing is reached. The mission is planned again when one of the sets D
    (detected), R (reached) or B (failed) changes; with distances as weights, also when new ones
    come.

    Attributes:
        plan: plan from the current state to acceptance.
        target: the target to pursue now; after the end, the last one.
        trace: letters, oldest first.
        sets: the sets D, R and B.
        meter: time and path, for the limits.
        round: number of the current round, from 1, of a mission that repeats.
        results: what the mission found out so far, for the reason of its end.
        log: the mission log, oldest entry first, at most the last `MAX_EVENTS`.
        started: True after `start`.
        paused: while True, time and path do not count and no target is pursued.
        stopped: why the robot is stopped (`edge.host.stop_latch`); as a pause, until it is "".
        retargets: number of times that a new target was set.
        changes: number of changes that a checkpoint should hold.
        config: the `mission` section; may be replaced to change the limits.
        destinations: targets that are no things; `locate` sets poses that were not known before.
        id: the requester's name of the mission; "" if there is none.
        activity: what the robot does for the active target, for the status; "" to say nothing.
        question: text about an object that a person may confirm as the target now; "" if none.
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
        self.state = 0
        self.target = spec.targets[0]
        self.destinations: dict[str, Destination] = dict(spec.translation.destinations)
        self.trace: tuple[str, ...] = ()
        known = [n for n, d in self.destinations.items() if not isinstance(d, RoomTarget)]
        self.sets, self.meter = TargetSets(known), MissionMeter()
        self.started = False
        self.paused = False
        self.stopped = ""
        self.retargets = 0
        self.changes = 0
        self.activity = ""
        self.question = ""
        self.reason = ""
        self.results: tuple[str, ...] = ()
        self.round = 1
        self.log: tuple[MissionEvent, ...] = ()
        self._instruction = one_line(spec.translation.instruction)
        self.config = config
        self._on_event = on_event
        self._planner: Planner = (
            make_planner(config.planner, spec.automaton, spec.translation.instruction)
            if spec.steps is None
            else TaskPlanner(spec.targets, spec.steps)
        )
        self._ended: Literal["idle", "reached", "failed"] | None = None
        self._n_left_out = 0  # targets left out of rounds since one was reached
        self.plan: TargetPlan = self._planner.plan(self.state, self.sets.knowledge)

    # -- properties -------------------------------------------------------------------------

    @property
    def done(self) -> bool:
        """True if the mission has ended or has not been given yet."""
        return self._ended is not None

    @property
    def active(self) -> bool:
        """True while a target is pursued: the mission has not ended, paused or been stopped."""
        return not (self.done or self.paused or self.stopped)

    @property
    def idle(self) -> bool:
        """True if this is a placeholder until the first mission is given."""
        return self._ended == "idle"

    @property
    def detected(self) -> frozenset[str]:
        """The set D."""
        return self.sets.detected

    @property
    def pursued_now_s(self) -> float:
        """Time for which the active target has been pursued."""
        return self.meter.pursued_s.get(self.target, 0.0)

    @property
    def _target_is_timed(self) -> bool:
        """True if the active target ends by a time of its own, so that no limit applies."""
        return is_timed(self.destinations.get(self.target))

    @property
    def waiting(self) -> bool:
        """True while the active target is a wait."""
        return self.active and isinstance(self.destinations.get(self.target), WaitTarget)

    @property
    def forbidden(self) -> tuple[str, ...]:
        """Targets that would make success impossible if they were reached now."""
        automaton = self.spec.automaton
        return tuple(
            label
            for label in self.spec.targets
            if automaton.is_dead(automaton.step(self.state, label))
        )

    def status(self, phase: MissionPhase) -> MissionStatus:
        """Return the status of the mission; `phase` applies while the mission is active."""
        if self._ended is not None:
            phase = self._ended
        elif self.stopped:
            phase = "stopped"
        elif self.paused:
            phase = "paused"
        return MissionStatus(
            self.target,
            phase,
            self.reason or self._shown_activity,
            self.meter.elapsed_s,
            self.meter.path_m,
            self._instruction,
        )

    @property
    def _shown_activity(self) -> str:
        """Return the robot's present activity for the status; "" for none."""
        repeat = self.spec.translation.repeat
        if self.stopped:
            return f"{self.stopped}; waits for `edge release`"
        if not self.active:
            return ""
        rounds = "" if repeat is None else repeat.shown_round(self.round, self.meter.elapsed_s)
        return "; ".join(filter(None, (rounds, self.activity)))

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
        self._log_event(now_ns, "start", "", f"{kind}: {spec.translation.understood}{formula}")
        for warning in spec.warnings:
            self._log_event(now_ns, "warning", "", warning)
        self._replan(now_ns, retarget=True)

    def observe(self, pose: SE2 | None, now_ns: int, searching: bool = True) -> None:
        """Count time and path; see `MissionMeter.add`."""
        target = self.target if self.active else None
        self.meter.add(pose, now_ns, target, self._target_is_timed, searching)

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
            self._finish("reached", self._rounds_text(self.round - 1), now_ns)
            return
        elapsed_s, path_m = self.meter.limited
        if elapsed_s > c.time_limit_s:
            self.fail(f"time limit of {c.time_limit_s:g} s", now_ns)
        elif path_m > c.path_limit_m:
            self.fail(f"path limit of {c.path_limit_m:g} m", now_ns)
        elif not self._target_is_timed and self.pursued_now_s > (c.search_limit_s or math.inf):
            missed = "did not get to" if self.target in self.detected else "no"
            self.abandon_target(f"{missed} {self.target} within {c.search_limit_s:g} s", now_ns)

    # -- events -------------------------------------------------------------------------------

    def on_detections(self, newest: Mapping[str, int], now_ns: int, keep: bool = False) -> None:
        """Update the set D, and plan again if it changes; see `TargetSets.on_detections`."""
        if self.done or (new := self.sets.on_detections(newest, keep)) is None:
            return
        for label in sorted(new - frozenset(self.sets.reached)):
            self.meter.pursued_s[label] = 0.0
            self._log_event(now_ns, "seen", label, f"seen: {label}")
        self._replan(now_ns)

    def update_distances(self, distance_m: np.ndarray, now_ns: int) -> None:
        """Use new driving distances between the targets; see `MissionKnowledge.distance_m`."""
        if not self.done:
            self.sets.distance_m = distance_m
            self._replan(now_ns)

    def forget_distances(self) -> None:
        """Delete the distances, because their map frame is gone; new ones come later."""
        self.sets.distance_m = None

    def on_reached(self, evidence: str, now_ns: int, result: str = "") -> None:
        """Advance the automaton: the active target was reached.

        No other event of a mission with a formula advances it, except steps without an object.
        """
        label, self._n_left_out = self.target, 0
        if result:
            self.results = (*self.results, one_line(result, _RESULT_CHARS))[-_MOST_RESULTS:]
        self._advance(label)
        self.sets.add_reached(label)
        self.meter.pursued_s[label] = 0.0
        self._log_event(now_ns, "reached", label, f"reached: {label} ({evidence})")
        self._accept(evidence, now_ns)
        self._replan(now_ns, retarget=True)

    def on_task_steps_driven(self, steps: int, now_ns: int) -> None:
        """Record that the first `steps` steps of a task were driven; the last one ends the task."""
        task_steps = self.spec.steps
        assert task_steps is not None
        while self.state < steps:
            text = one_line(task_steps[self.state].said, 60)
            self._advance(NOTHING)
            if not self._accept("driven to its end", now_ns):
                self._log_event(now_ns, "trajectory", "", f"driven: {text}")
        if not self.done:
            self._replan(now_ns)

    def log_trajectory(self, text: str, now_ns: int) -> None:
        """Add a log entry about a task's trajectory; the automaton does not move."""
        self._log_event(now_ns, "trajectory", "", one_line(text, _TRAJECTORY_CHARS))

    def abandon_target(self, reason: str, now_ns: int) -> None:
        """Add the active target to B because it could not be reached, and plan again."""
        label = self.target
        self.sets.add_failed(label, reason)
        self.meter.pursued_s[label] = 0.0
        self._log_event(now_ns, "failed", label, f"failed: {label} ({reason})")
        self._replan(now_ns, retarget=True)

    def warn(self, label: str, text: str, now_ns: int) -> None:
        """Add a warning for the operator, such as a stop near a forbidden target."""
        self._log_event(now_ns, "warning", label, text)

    def pause(self, paused: bool) -> None:
        """Pause or resume the mission; time does not count while it is paused."""
        self.paused = paused
        self.changes += 1

    def set_idle(self) -> None:
        """Become the idle placeholder until the first mission is given."""
        self._ended, self.reason = "idle", "waiting for a mission"

    def cancel(self, reason: str, now_ns: int) -> None:
        """End the mission because a person says so.

        The mission then fails. One that repeats without an end is fulfilled: this is its regular
        end.
        """
        repeat = self.spec.translation.repeat
        if repeat is not None and repeat.endless:
            self._finish("reached", f"{reason}; {self._rounds_text(self.round - 1)}", now_ns)
        else:
            self.fail(reason, now_ns)

    def fail(self, reason: str, now_ns: int) -> None:
        """Fail the whole mission, unless it has already ended."""
        self._finish("failed", reason, now_ns)

    def end_wait(self, now_ns: int) -> None:
        """End a wait, because a person says so; do nothing if the robot does not wait."""
        if self.waiting:
            self.on_reached("told to go on", now_ns)

    def confirm(self, now_ns: int) -> None:
        """Count the active target as reached, because a person says that `question` is right."""
        if self.active and self.question:
            self.on_reached("confirmed by a person", now_ns, self.question)

    def restore(
        self,
        trace: Iterable[str],
        reached: Iterable[str],
        failed: Iterable[str],
        elapsed_s: float,
        path_m: float,
        paused: bool,
        exempt: tuple[float, float] = (0.0, 0.0),
        pursued_s: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Continue from the saved state of a mission with the same formula.

        Call it before `start`. The arguments are attributes of this class, its `sets` and its
        `meter` at the time of saving; `exempt` is the pair of `exempt_s` and `exempt_m`.
        """
        for letter in trace:
            self._advance(letter)
        self.sets.restore(reached, failed)
        self.paused, meter = paused, self.meter
        meter.elapsed_s, meter.path_m, meter.pursued_s = elapsed_s, path_m, dict(pursued_s)
        meter.exempt_s, meter.exempt_m = exempt

    # -- internals ----------------------------------------------------------------------------

    def _advance(self, letter: str) -> None:
        self.state = self.spec.automaton.step(self.state, letter)
        self.trace = (*self.trace, letter)

    def _accept(self, evidence: str, now_ns: int) -> bool:
        """End the mission, or the round, if the formula is fulfilled; return True if it is."""
        if not self.spec.automaton.accepting[self.state]:
            return False
        repeat = self.spec.translation.repeat
        if repeat is not None:
            self._end_round(repeat, now_ns)
            return True
        taken = [letter for letter in self.trace if letter != NOTHING]
        order = ", then ".join(taken) if len(taken) > 1 else evidence
        self._finish("reached", "; ".join(self.results) or order, now_ns)
        return True

    def _end_round(self, repeat: Repetition, now_ns: int) -> None:
        """Begin the next round, or end the mission after the last one."""
        if self.round == repeat.rounds:
            self._finish("reached", self._rounds_text(self.round), now_ns)
            return
        self.round += 1
        self.state, self.trace = 0, ()
        self.sets.begin_round()
        self.meter.begin_round()
        self._log_event(now_ns, "round", "", repeat.shown_round(self.round, self.meter.elapsed_s))

    def _leave_out_failed(self, now_ns: int) -> bool:
        """Leave out the failed target in this round, as if it had been reached.

        Return False, and do nothing, if that is not possible: the mission does not repeat, the
        target is forbidden now, or all others were left out since one was reached.
        """
        label, automaton = self.target, self.spec.automaton
        if self.spec.translation.repeat is None or label not in self.sets.failed:
            return False
        if self._n_left_out >= len(self.spec.targets) - 1:
            return False
        if automaton.is_dead(automaton.step(self.state, label)):
            return False
        self._n_left_out += 1
        self.sets.failed -= {label}
        self._advance(label)
        self._log_event(now_ns, "warning", label, f"left out in round {self.round}: {label}")
        self._accept("left out", now_ns)
        return True

    def _rounds_text(self, rounds: int) -> str:
        """Return the reason of the end after some rounds."""
        done = f"{rounds} round{'s' * (rounds != 1)} done"
        return "; ".join((done, *self.results))

    def _replan(self, now_ns: int, retarget: bool = False) -> None:
        """Plan from the current state; take planned steps without an object at once.

        Args:
            now_ns: time of the loop.
            retarget: True if the present target is settled, so that the planner does not favour it.
        """
        self.changes += 1
        if retarget:
            self.question = ""
        while not self.done:
            current = None if retarget else self.target
            self.plan = self._planner.plan(self.state, self.sets.knowledge, current)
            if not self.plan.feasible and self._leave_out_failed(now_ns):
                continue
            if not self.plan.feasible:
                self._finish("failed", self.sets.failure_reasons or self.plan.reason, now_ns)
                return
            if self.plan.target is not None:
                break
            if not self._accept("nothing more to reach", now_ns):
                self._advance(NOTHING)
                self._log_event(now_ns, "nothing", "", "a step in which nothing is reached")
        if self.done:
            return
        # The plan has no steps if a task has detected all objects that it needs.
        if self.plan.steps and (retarget or self.plan.target != self.target):
            self.retargets += 1
            self.target, self.activity = self.plan.target, ""
            self._log_event(
                now_ns, "target", self.target, f"target: {self.target}: {self.plan.reason}"
            )

    def _finish(self, ended: Literal["reached", "failed"], reason: str, now_ns: int) -> None:
        if self.done:
            return
        self._ended, self.reason, self.question = ended, reason, ""
        self._log_event(now_ns, "end", "", f"{ended}: {reason}")

    def _log_event(self, now_ns: int, kind: MissionEventKind, label: str, text: str) -> None:
        self.changes += 1
        event = MissionEvent(now_ns, kind, label, self.state, text)
        self.log = (*self.log, event)[-MAX_EVENTS:]
        self._on_event(event)
