"""The running mission, and the requests of people about it: pause, confirm, stop and cancel."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from edge.config import MissionConfig
from edge.errors import UserError
from edge.loop.goals.goal import GoalTracker
from edge.loop.input_log import InputLog
from edge.mission.destinations import WaitTarget
from edge.mission.run import MissionRun
from edge.mission.spec import MissionSpec, task_state

_MAX_PAST_MISSIONS = 32


class MissionControl:
    """The running mission, and the requests of people about it; for the loop's thread.

    Args:
        spec: First mission.
        config: Section `mission` of the configuration, for the first mission.
        goals: The goal tracker.
        input_log: Input log, which records the requests.
        event: Reports an event for people, at a loop time, with the level of its log record.

    Attributes:
        mission: The running mission, or the last one.
        past: Results of earlier missions that had an id, JSON-ready, oldest first.
        stopped: Why the robot is stopped; "" if it is not (see `stop`).
    """

    def __init__(
        self,
        spec: MissionSpec,
        config: MissionConfig,
        goals: GoalTracker,
        input_log: InputLog,
        event: Callable[..., None],
    ) -> None:
        self.past: deque[dict[str, str]] = deque(maxlen=_MAX_PAST_MISSIONS)
        self.stopped = ""
        self._goals, self._input_log, self._event = goals, input_log, event
        self._resume_ns: int | None = None  # loop time at which a pause ends by itself
        self.mission = self.make_run(spec, config)

    def make_run(self, spec: MissionSpec, config: MissionConfig, id: str = "") -> MissionRun:
        """Return a mission that reports its log as events."""
        run = MissionRun(spec, config, lambda step: self._event(step.text, step.stamp_ns), id)
        run.meter.decide = self._input_log.record_decision
        return run

    def replace(self, mission: MissionRun, now_ns: int) -> None:
        """Put another mission in the place of the present one."""
        before = self.mission
        if before.id:
            status = before.status(self._goals.phase)
            outcome = (status.phase, status.reason) if before.done else ("failed", "replaced")
            self.past.append({"id": before.id, "phase": outcome[0], "reason": outcome[1]})
        self._input_log.note(
            "mission", translation=mission.spec.translation, task=task_state(mission.spec),
            id=mission.id, now_ns=now_ns,
        )  # fmt: skip
        self.mission, self._resume_ns = mission, None
        mission.stopped = self.stopped

    def pause(self, paused: bool, now_ns: int, for_s: float | None = None) -> None:
        """Pause the mission, so that the robot stands still, or resume it.

        If the mission is not paused but waits, resuming it ends the wait.

        Args:
            paused: True to pause.
            now_ns: Loop time.
            for_s: Time after which the mission resumes by itself [s]. None: it stays paused until
                it is resumed. A restart forgets this time, and the mission stays paused.
        """
        mission = self.mission
        self._resume_ns = now_ns + int(1e9 * for_s) if paused and for_s is not None else None
        waits = isinstance(mission.destinations.get(mission.target), WaitTarget)
        ends_wait = not paused and mission.active and waits
        if paused == mission.paused and not ends_wait:  # repeated requests are logged once
            return
        self._input_log.note("pause", paused=paused, now_ns=now_ns)
        if ends_wait:
            mission.on_reached("told to go on", now_ns)
            return
        mission.pause(paused)
        self._event(f"mission: {'paused' if paused else 'resumed'}", now_ns)

    def end_pause(self, now_ns: int) -> None:
        """Resume the mission if its pause is over; called between ticks, as requests are."""
        if self._resume_ns is None or now_ns < self._resume_ns:
            return
        self._resume_ns = None
        if not self.mission.done:
            self.pause(False, now_ns)

    def confirm(self, now_ns: int) -> None:
        """Count the target as reached: a person confirms the object that the robot asks about.

        Raises:
            UserError: The robot asks about nothing.
        """
        mission = self.mission
        if not mission.active or not mission.question:
            raise UserError(
                "nothing to confirm: the robot does not ask about an object (mission.probable: ask)"
            )
        self._input_log.note("confirm", now_ns=now_ns)
        mission.on_reached("confirmed by a person", now_ns, mission.question)

    def stop(self, reason: str, now_ns: int) -> None:
        """Stop the robot and withdraw its goal; missions wait, also later ones.

        Args:
            reason: Why; "" releases the robot.
            now_ns: Loop time.
        """
        self._input_log.note("stop", reason=reason, now_ns=now_ns)
        self.stopped = self.mission.stopped = reason
        if reason:
            self._goals.client.demand_hold()
            text = f"stopped: {reason}; no goal is sent until `edge release`"
            self._event(text, now_ns, logging.WARNING)
        else:
            self._event("released: goals are sent again", now_ns)

    def cancel(self, reason: str, now_ns: int) -> None:
        """End the mission because a person says so; see `MissionRun.cancel`."""
        self._input_log.note("cancel", reason=reason, now_ns=now_ns)
        self.mission.cancel(reason, now_ns)

    def fail(self, reason: str, now_ns: int) -> None:
        """End the mission as failed."""
        self._input_log.note("fail", reason=reason, now_ns=now_ns)
        self.mission.finish("failed", reason, now_ns)
