"""A mission under way: the automaton, what is known of its targets, and the plan (ViTL alg. 1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Literal

import numpy as np

from edge.config import Mission
from edge.geometry import SE2
from edge.mission.brief import Brief
from edge.mission.logic.automaton import NOTHING
from edge.mission.planning.in_sight import InSightPlanner
from edge.mission.planning.plan import Knowledge, Plan, Planner
from edge.mission.planning.planner import make_planner
from edge.text import one_line
from edge.types import MissionPhase, MissionStatus, Step, StepKind

MAX_STEPS = 1000


class MissionRun:
    """Advances the automaton by what was reached, and says which target to pursue.

    The automaton moves only when the active target was declared reached, and, where the formula
    asks for it, by a step in which nothing is reached. The plan is made anew whenever one of the
    sets D (seen), R (reached), B (failed) changes; with metres as weights, whenever new ones come.

    Attributes:
        state: of the automaton.
        plan: from here to acceptance.
        target: what to pursue now; at the end, what was pursued last.
        word: the letters taken so far.
        detected, failed: the sets D and B, as labels; `reached`: R in order of reaching.
        steps: what happened, oldest first; of a very long mission, the last `MAX_STEPS`.
        started: whether the first steps were taken.
        paused: time and path do not count, nothing is pursued.
        turns: counts how often a target was set out for.
        changes: counts everything that a checkpoint should hold.
        config: its limits; may be set to one with others.
        places: targets that are places, with their poses; None for a pose that `locate` sets.
        id: what whoever asked for it calls it; "" where it has no name.
    """

    def __init__(
        self,
        brief: Brief,
        config: Mission,
        tell: Callable[[Step], None] = lambda step: None,
        id: str = "",
    ) -> None:
        """
        Args:
            tell: hears of every step when it is taken.
        """
        self.brief = brief
        self.id = id
        self.state = 0
        self.target = brief.targets[0]
        self.places: dict[str, SE2 | None] = dict(brief.translation.places)
        self.word: tuple[str, ...] = ()
        self.detected: frozenset[str] = frozenset(self.places)
        self.reached: tuple[str, ...] = ()
        self.failed: frozenset[str] = frozenset()
        self.started = False
        self.paused = False
        self.turns = 0
        self.changes = 0
        self.elapsed_s = 0.0
        self.path_m = 0.0
        self.reason = ""
        self.steps: tuple[Step, ...] = ()
        self._instruction = one_line(brief.translation.instruction)
        self.config = config
        self._tell = tell
        self._planner: Planner = (
            make_planner(config.planner, brief.automaton, brief.translation.instruction)
            if brief.steps is None
            else InSightPlanner(brief.targets, brief.steps)
        )
        self._distance_m: np.ndarray | None = None
        self._ended: Literal["idle", "reached", "failed"] | None = None
        self._why_failed: dict[str, str] = {}
        self._newest: dict[str, int] = dict.fromkeys(self.places, 0)
        self._stale: dict[str, int] = {}
        self._pursued_s: dict[str, float] = {}
        self._last_ns: int | None = None
        self._last_pose: SE2 | None = None
        self.plan: Plan = self._planner.plan(self.state, self.knowledge)

    # -- what others read -------------------------------------------------------------------

    @property
    def done(self) -> bool:
        """Nothing is, or is any more, to be done."""
        return self._ended is not None

    @property
    def active(self) -> bool:
        """True while something is pursued: the mission is neither over nor paused."""
        return not (self.done or self.paused)

    @property
    def observed(self) -> bool:
        """Whether `observe` was called: the mission's time runs."""
        return self._last_ns is not None

    @property
    def idle(self) -> bool:
        """It only stands for the first one, which was not given yet."""
        return self._ended == "idle"

    @property
    def knowledge(self) -> Knowledge:
        """The sets D, R and B (ViTL IV-A2), and metres where they are weights."""
        reached = frozenset(self.reached)
        return Knowledge(self.detected - reached, reached, self.failed, self._distance_m)

    @property
    def forbidden(self) -> tuple[str, ...]:
        """Targets from which, reached now, success would be impossible."""
        automaton = self.brief.automaton
        return tuple(
            label
            for label in self.brief.targets
            if automaton.dead(automaton.step(self.state, label))
        )

    def status(self, phase: MissionPhase) -> MissionStatus:
        """How the mission stands, given what the robot is at."""
        if self._ended is not None:
            phase = self._ended
        elif self.paused:
            phase = "paused"
        return MissionStatus(
            self.target, phase, self.reason, self.elapsed_s, self.path_m, self._instruction
        )

    # -- time, path and limits ----------------------------------------------------------------

    def locate(self, start: SE2, here: SE2) -> None:
        """Set the poses that were not known when the mission was prepared.

        Args:
            start: the first pose of the service.
            here: the robot's pose now.
        """
        for name, pose in (("start", start), ("here", here)):
            if name in self.places and self.places[name] is None:
                self.places[name] = pose
                self.changes += 1

    def start(self, now_ns: int) -> None:
        """Write the first steps of the story: what was understood, and where to go first."""
        self.started = True
        if self.done:
            return
        brief = self.brief
        kind, formula = "task", ""
        if brief.steps is None:
            kind, formula = "mission", f" [{one_line(brief.automaton.formula)}]"
        self._note(now_ns, "start", "", f"{kind}: {brief.translation.understood}{formula}")
        for warning in brief.warnings:
            self._note(now_ns, "warning", "", warning)
        self._replan(now_ns, anew=True)

    def observe(self, pose: SE2 | None, now_ns: int, looking: bool = True) -> None:
        """Count time, from the first call on, and path; a jump of the pose is not driving.

        Args:
            pose: None while it is not known; time passes all the same.
            looking: whether sensors see anything; else no target is being searched for.
        """
        passed_s = 0.0 if self._last_ns is None else max(0, now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        step_m = 0.0
        if pose is not None:
            if self._last_pose is not None:
                step_m = self._last_pose.distance_to(pose.x_m, pose.y_m)
            self._last_pose = pose
        if not self.active:
            return
        self.elapsed_s += passed_s
        self.path_m += step_m if step_m < 1.0 else 0.0
        if looking:
            self._pursued_s[self.target] = self._pursued_s.get(self.target, 0.0) + passed_s

    def check_limits(self, now_ns: int) -> None:
        """Fail at the time or path limit; a target sought for too long counts as failed."""
        c = self.config
        if not self.active:
            return
        if self.elapsed_s > c.time_limit_s:
            self.fail(f"time limit of {c.time_limit_s:g} s", now_ns)
        elif self.path_m > c.path_limit_m:
            self.fail(f"path limit of {c.path_limit_m:g} m", now_ns)
        elif self._pursued_s.get(self.target, 0.0) > (c.search_limit_s or math.inf):
            missed = "did not get to" if self.target in self.detected else "no"
            self.give_up(f"{missed} {self.target} within {c.search_limit_s:g} s", now_ns)

    # -- what happens to it -------------------------------------------------------------------

    def see(self, newest: Mapping[str, int], now_ns: int, keep: bool = False) -> None:
        """What is known now gives the set D; replans when it changes.

        Args:
            newest: for each target of which an instance is known, the highest id of them. What
                had failed is seen again only when there is a newer one than at that time.
            keep: what was seen stays seen.
        """
        newest = {**self._newest, **newest} if keep else newest
        if newest == self._newest or self.done:
            return
        self._newest = dict(newest)
        detected = frozenset(k for k, i in newest.items() if i > self._stale.get(k, -1))
        if detected == self.detected:
            return
        new = detected - self.detected
        self.detected = detected
        self.failed -= new
        for label in sorted(new - frozenset(self.reached)):
            self._pursued_s[label] = 0.0
            self._note(now_ns, "seen", label, f"seen: {label}")
        self._replan(now_ns)

    def survey(self, distance_m: np.ndarray, now_ns: int) -> None:
        """Take new driving distances between the targets; see `Knowledge.distance_m`."""
        if not self.done:
            self._distance_m = distance_m
            self._replan(now_ns)

    def forget_distances(self) -> None:
        """The frame that they were measured in is gone; new ones come with the next survey."""
        self._distance_m = None

    def arrive(self, evidence: str, now_ns: int) -> None:
        """The active target was reached: the one thing that moves the automaton."""
        label = self.target
        self._take(label)
        self.reached = tuple(dict.fromkeys((*self.reached, label)))
        self._pursued_s[label] = 0.0
        self._note(now_ns, "reached", label, f"reached: {label} ({evidence})")
        if not self._accept(evidence, now_ns):
            self._replan(now_ns, anew=True)

    def drove(self, steps: int, now_ns: int) -> None:
        """The first `steps` steps of a task were driven; it is over with the last of them."""
        told = self.brief.steps
        assert told is not None
        while self.state < steps:
            said = one_line(told[self.state].said, 60)
            self._take(NOTHING)
            if not self._accept("driven to its end", now_ns):
                self._note(now_ns, "trajectory", "", f"driven: {said}")
        if not self.done:
            self._replan(now_ns)

    def tell(self, text: str, now_ns: int) -> None:
        """A step of the story that moves no automaton: how a task's trajectory came about."""
        self._note(now_ns, "trajectory", "", text)

    def give_up(self, reason: str, now_ns: int) -> None:
        """The active target could not be reached: it joins B, and the plan is made anew."""
        label = self.target
        self.failed |= {label}
        self.detected -= {label}
        self._pursued_s[label] = 0.0
        self._stale[label] = self._newest.get(label, -1)
        self._why_failed[label] = reason
        self._note(now_ns, "failed", label, f"failed: {label} ({reason})")
        self._replan(now_ns, anew=True)

    def warn(self, label: str, text: str, now_ns: int) -> None:
        """Something that a person should know, such as a stop near what must not be reached."""
        self._note(now_ns, "warning", label, text)

    def pause(self, paused: bool) -> None:
        """Stop or resume; the clock stands meanwhile."""
        self.paused = paused
        self.changes += 1

    def wait(self) -> None:
        """Do nothing: the first mission is yet to be given."""
        self._ended, self.reason = "idle", "waiting for a mission"

    def fail(self, reason: str, now_ns: int) -> None:
        """Give up the whole mission; what is already over stays as it ended."""
        self._finish("failed", reason, now_ns)

    def restore(
        self,
        word: Iterable[str],
        reached: Iterable[str],
        failed: Iterable[str],
        elapsed_s: float,
        path_m: float,
        paused: bool,
    ) -> None:
        """Go on where a mission of the same formula stopped; call it before `start`."""
        for letter in word:
            self._take(letter)
        self.reached, self.failed = tuple(reached), frozenset(failed)
        self._why_failed = {label: f"{label} failed before the restart" for label in self.failed}
        self.elapsed_s, self.path_m, self.paused = elapsed_s, path_m, paused

    def overlook(self, newest: int) -> None:
        """Instances up to this id were known before a restart: what had failed failed with them."""
        self._stale = dict.fromkeys(self.failed, newest)

    # -- inside -------------------------------------------------------------------------------

    def _take(self, letter: str) -> None:
        self.state = self.brief.automaton.step(self.state, letter)
        self.word = (*self.word, letter)

    def _accept(self, evidence: str, now_ns: int) -> bool:
        if not self.brief.automaton.accepting[self.state]:
            return False
        taken = [letter for letter in self.word if letter != NOTHING]
        self._finish("reached", ", then ".join(taken) if len(taken) > 1 else evidence, now_ns)
        return True

    def _replan(self, now_ns: int, anew: bool = False) -> None:
        """Plan from here; steps that reach nothing are taken at once.

        Args:
            anew: the present target is settled, and has no claim to be kept.
        """
        self.changes += 1
        while True:
            current = None if anew else self.target
            self.plan = self._planner.plan(self.state, self.knowledge, current)
            if not self.plan.feasible:
                why = [why for label, why in self._why_failed.items() if label in self.failed]
                self._finish("failed", "; ".join(why) or self.plan.reason, now_ns)
                return
            if self.plan.target is not None or self._accept("nothing more to reach", now_ns):
                break
            self._take(NOTHING)
            self._note(now_ns, "nothing", "", "a step in which nothing is reached")
        if self.done:
            return
        # A task that has seen all sets out for nothing more.
        if self.plan.steps and (anew or self.plan.target != self.target):
            self.turns += 1
            self.target = self.plan.target
            self._note(now_ns, "target", self.target, f"target: {self.target}: {self.plan.reason}")

    def _finish(self, ended: Literal["reached", "failed"], reason: str, now_ns: int) -> None:
        if self.done:
            return
        self._ended, self.reason = ended, reason
        self._note(now_ns, "end", "", f"{ended}: {reason}")

    def _note(self, now_ns: int, kind: StepKind, label: str, text: str) -> None:
        self.changes += 1
        step = Step(now_ns, kind, label, self.state, text)
        self.steps = (*self.steps, step)[-MAX_STEPS:]
        self._tell(step)
