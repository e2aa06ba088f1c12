"""Reference motion controller as a separate process on the Zenoh bus.

It reads `map`, `goal` and `odom`, and writes `cmd_vel` and `goal_status` (`edge/bus/topics.py`).
Any other controller with these topics can replace it.

In lockstep, the clock of the simulator stands still until the controller has answered the
service's tick. Without it, the controller runs in real time.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.session import Ring, declare_publisher, zenoh_session
from edge.bus.topics import Topic
from edge.bus.wire import messages
from edge.config import Config
from edge.geometry import SE2, Grid, se2_of
from edge.host.interruptible import run_unless_stopped
from edge.lab.motion.controller import Controller
from edge.text import bounded_repr, read_json_object
from edge.trajectory.pursuit import STOP, VelocityCommand
from edge.types import GoalStatus

log = logging.getLogger("edge.lab.motion")
T = TypeVar("T")

ODOMETRY_LOST_S = 1.0  # without odometry for longer, the robot stops
MAP_LOST_S = 3.0  # without a map for longer, the robot stops; or three map periods, if that is more
_PAUSE_S = 0.0003  # between two reads of the messages, in lockstep
# Number of unread messages to keep, the newest ones, by topic.
_RINGS = {topics.MAP: 1, topics.GOAL: 8, topics.ODOMETRY: 64, topics.TICK: 16}
_MAX_JSON = 4096  # bytes of a message


def main(config: Config, stop: threading.Event) -> int:
    """Run the controller until `stop` is set; return the exit status."""
    run_unless_stopped(partial(warm_up, config), stop)
    with zenoh_session(
        config.zenoh, "connect", stop, keep_zenoh_timeout=config.sim.lockstep
    ) as session:
        bus = Bus(session, config)
        controller = Controller(config)
        try:
            if config.sim.lockstep:
                run_lockstep(bus, controller, stop)
            else:
                run(bus, controller, stop, config)
        finally:
            bus.close()
    return 0


def warm_up(config: Config) -> None:
    """Drive one step on a small map, so that the first goal does not wait for the compiler."""
    controller = Controller(config)
    controller.on_map(Grid(np.zeros((64, 64), np.int8), (0.0, 0.0), 0.05))
    controller.on_goal(1, SE2(2.0, 1.0, 0.0))
    controller.step(SE2(0.5, 0.5, 0.0), 0.0, 0.0, 0)


class Bus:
    """The controller's subscribers and publishers.

    Attributes:
        malformed: number of unreadable messages by topic key.
        map_heard_s: time at which the newest map came (`time.monotonic`); None before the first.
    """

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        settings, lockstep = config.zenoh, config.sim.lockstep
        self.malformed: dict[str, int] = {}
        self.map_heard_s: float | None = None
        self._lockstep = lockstep
        self._map_ns: int | None = None
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        self._rings = {
            topic: Ring(session, settings.key(topic.key), kept) for topic, kept in _RINGS.items()
        }
        # In lockstep simulator and service wait for every message: none may be dropped.
        change = {"qos": "block"} if lockstep else {}
        self._commands, self._answers = (
            declare_publisher(session, replace(topic, **change), settings)
            for topic in (topics.CMD_VEL, topics.GOAL_STATUS)
        )

    def read(self, topic: Topic, decode: Callable[[bytes], T]) -> list[T]:
        """Return the messages since the last call, oldest first; count unreadable ones."""
        decoded = []
        for sample in self._rings[topic].take():
            try:
                if len(sample.payload) > self._max_bytes:
                    raise ValueError(
                        f"it has {len(sample.payload)} bytes, over the limit source.max_message_mb"
                    )
                decoded.append(decode(sample.payload.to_bytes()))
            except ValueError as error:
                self._count_malformed(topic, error)
        return decoded

    def _count_malformed(self, topic: Topic, error: Exception) -> None:
        """Count an unreadable message; log the first one of each topic."""
        self.malformed[topic.key] = self.malformed.get(topic.key, 0) + 1
        if self.malformed[topic.key] == 1:
            log.warning(
                "topic %s: ignored an unreadable message: %s; more are counted, not logged",
                topic.key,
                error,
            )

    def send_command(self, command: VelocityCommand, stamp_ns: int) -> None:
        """Publish a command, with the stamp of the odometry that it answers."""
        self._commands.put(messages.encode_twist_stamped(stamp_ns, command.v_mps, command.w_radps))

    def send_answers(self, answers: list[GoalStatus]) -> None:
        """Publish answers to goals."""
        for a in answers:
            data = {"stamp": a.stamp_ns, "state": a.state, "reason": a.reason}
            if a.blocked is not None:
                data["blocked"] = a.blocked
            self._answers.put(json.dumps(data).encode())

    def feed(self, controller: Controller) -> None:
        """Give the controller the newest map and all goals, and send its answers."""
        for stamp_ns, grid in self.read(topics.MAP, messages.decode_occupancy_grid):
            # In lockstep a map is sent again until it is answered. Using the copy would plan
            # again, and the run would depend on the computer's speed.
            if self._lockstep and stamp_ns == self._map_ns:
                continue
            try:
                controller.on_map(grid)
                self._map_ns = stamp_ns
                self.map_heard_s = time.monotonic()
            except ValueError as error:
                self._count_malformed(topics.MAP, error)
        for stamp_ns, goal in self.read(topics.GOAL, messages.decode_pose_stamped):
            self.send_answers(controller.on_goal(stamp_ns, goal))

    def close(self) -> None:
        """End all subscriptions and publishers."""
        for ring in self._rings.values():
            ring.close()
        for publisher in (self._commands, self._answers):
            publisher.undeclare()


def parse_tick(payload: bytes) -> int:
    """Return the stamp of `{"stamp": ns}`.

    Raises:
        ValueError: one line that says what is wrong.
    """
    stamp = read_json_object(payload, _MAX_JSON).get("stamp")
    if type(stamp) is not int:
        raise ValueError(
            f"stamp: expected a whole number of nanoseconds, got {bounded_repr(stamp, 40)}"
        )
    return stamp


def run(bus: Bus, controller: Controller, stop: threading.Event, config: Config) -> None:
    """Step at `motion.rate_hz` on the newest odometry.

    The robot stops if there is no odometry for 1 s. It also stops if the maps cease: without them
    the controller drives blind.
    """
    period_s = 1.0 / config.motion.rate_hz
    map_lost_s = max(MAP_LOST_S, 3.0 / config.report.map_hz)
    stamp_ns, heard_s = 0, None  # stamp of the newest odometry, and the time at which it came
    is_held = False  # True while the robot stands because there is no map
    due_s = time.monotonic()
    while not stop.wait(max(due_s - time.monotonic(), 0.0)):
        due_s = max(due_s + period_s, time.monotonic())
        odometry = bus.read(topics.ODOMETRY, messages.decode_odometry)
        bus.feed(controller)
        was_held, is_held = is_held, _is_lost(bus.map_heard_s, map_lost_s)
        if is_held and not was_held:
            log.warning(
                "controller: no map from the service for %.1f s; the robot stands until one comes",
                map_lost_s,
            )
            controller.pause()
        if odometry and odometry[-1].stamp_ns != stamp_ns:
            newest = odometry[-1]
            stamp_ns, heard_s = newest.stamp_ns, time.monotonic()
            command = STOP if is_held else _step(bus, controller, newest)
            bus.send_command(command, stamp_ns)
        elif _is_lost(heard_s, ODOMETRY_LOST_S):
            bus.send_command(STOP, stamp_ns)
    if heard_s is not None:
        bus.send_command(STOP, stamp_ns)


def _is_lost(heard_s: float | None, after_s: float) -> bool:
    """Return True if something that was heard once has been silent for longer than `after_s`."""
    return heard_s is not None and time.monotonic() - heard_s > after_s


def run_lockstep(bus: Bus, controller: Controller, stop: threading.Event) -> None:
    """Answer each odometry stamp after the service's tick for it has come.

    The service sends a tick after the map and the goal of that tick, so ticks are read first. A
    stamp that comes again (its answer was lost) gets the same command again.
    """
    last: tuple[VelocityCommand, int] | None = None  # the last command and its stamp
    waiting: dict[int, messages.OdometryMessage] = {}  # odometry without an answer, by stamp
    tick_ns: int | None = None
    while not stop.wait(_PAUSE_S):
        ticks = bus.read(topics.TICK, parse_tick)
        arrived = bus.read(topics.ODOMETRY, messages.decode_odometry)
        tick_ns = ticks[-1] if ticks else tick_ns
        waiting.update((o.stamp_ns, o) for o in arrived)
        bus.feed(controller)
        if last is not None and (last[1] in ticks or last[1] in waiting):
            waiting.pop(last[1], None)
            bus.send_command(*last)
        if tick_ns in waiting:
            last = _step(bus, controller, waiting[tick_ns]), tick_ns
            waiting = {t: o for t, o in waiting.items() if t > tick_ns}
            bus.send_command(*last)
        while len(waiting) > _RINGS[topics.ODOMETRY]:
            del waiting[next(iter(waiting))]


def _step(bus: Bus, controller: Controller, odometry: messages.OdometryMessage) -> VelocityCommand:
    """Run one step of the controller and send its answers; return the command, not yet sent."""
    pose = se2_of(odometry.T_map_base)
    command, answers = controller.step(pose, odometry.v_mps, odometry.w_radps, odometry.stamp_ns)
    bus.send_answers(answers)
    return command
