"""The simulated robot as a separate process, which uses only Zenoh.

In real time one thread moves the robot and sends its odometry at `sensors.odometry_hz`. Other
threads take images and LiDAR sweeps, and skip those they have no time for. In lockstep the
simulated clock stands still until the controller has answered the service's tick.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import zenoh

from edge.bus import topics
from edge.bus.session import Ring, declare_publisher, zenoh_session
from edge.bus.wire import messages
from edge.config import Config
from edge.lab.sim.base import World
from edge.lab.sim.people import with_people
from edge.lab.sim.robot import DriveTrain, MotionState
from edge.lab.sim.sensors import Message, Rig, make_rigs, odometry_message, truth_message
from edge.lab.sim.worlds import load_world

log = logging.getLogger("edge.lab.sim")

COMMAND_TIMEOUT_S = 0.5  # without a command for longer, the robot stops (in real time)
WARN_AFTER_S = 10.0  # of waiting for a command, in lockstep
REPEAT_S = 0.5  # time after which unanswered sensor data is sent again, in lockstep
FIRST_STAMP_NS = 1_000_000_000  # start of the simulated clock, in lockstep
_TRUTH_HZ = 10.0  # rate of the ground truth
_DESCRIPTION_HZ = 1.0  # rate of camera intrinsics and labels
_POLL_S = 0.0005  # pause between two looks for a command or a motion


def main(config: Config, stop: threading.Event) -> int:
    """Simulate the configured robot in its world until `stop` is set; return the exit status."""
    world = load_world(config)
    first_ns = FIRST_STAMP_NS if config.sim.lockstep else time.time_ns()
    world = with_people(world, config, world.start)
    drive = DriveTrain(config.robot, config.sim, world, world.start, first_ns)
    with zenoh_session(
        config.zenoh, "connect", stop, keep_zenoh_timeout=config.sim.lockstep
    ) as session:
        bus = SimBus(session, config)
        log.info("simulating the robot %s in the world %s", config.robot_name, world.name)
        run = run_lockstep if config.sim.lockstep else run_real_time
        run(config, world, drive, bus, stop)
    now = drive.motion
    log.info("simulation ended: drove %.1f m, %d collisions", now.path_m, now.collisions)
    return 0


class SimBus:
    """The simulator's publishers, and the subscriber for commands."""

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        # In lockstep the service waits for every message: none may be dropped.
        change = {"qos": "block"} if config.sim.lockstep else {}
        self._publishers = {
            topic.key: declare_publisher(session, replace(topic, **change), config.zenoh)
            for topic in topics.PLAYED
        }
        self._commands = Ring(session, config.zenoh.key(topics.CMD_VEL.key), 16)
        self._malformed = 0

    def send(self, batch: Iterable[Message]) -> None:
        """Publish each message on its topic."""
        for topic, payload in batch:
            self._publishers[topic.key].put(payload)

    def take_commands(self) -> Iterable[tuple[int, float, float]]:
        """Yield (stamp_ns, v, w) of the commands since the last call; count malformed ones."""
        for sample in self._commands.take():
            try:
                yield messages.decode_twist_stamped(sample.payload.to_bytes())
            except messages.DecodeError as error:
                self._malformed += 1
                if self._malformed == 1:
                    log.warning(
                        "cmd_vel: ignored a malformed command: %s; more are counted, not logged",
                        error,
                    )


def run_real_time(
    config: Config, world: World, drive: DriveTrain, bus: SimBus, stop: threading.Event
) -> None:
    """Move and send odometry at its rate; other threads run the sensors."""
    rigs = make_rigs(config, world)
    with ThreadPoolExecutor(len(rigs), thread_name_prefix="sensor") as pool:
        running = [pool.submit(_sense, rig, drive, bus, stop) for rig in rigs]
        # A sensor that fails ends the simulation, with its error.
        for future in running:
            future.add_done_callback(lambda _: stop.set())
        try:
            _move(config, drive, bus, stop)
        finally:
            stop.set()
    for future in running:
        future.result()


def _move(config: Config, drive: DriveTrain, bus: SimBus, stop: threading.Event) -> None:
    """Move the robot in real time by the newest command, and send odometry and ground truth."""
    period_s = 1.0 / config.sensors.odometry_hz
    truth_every = max(1, round(config.sensors.odometry_hz / _TRUTH_HZ))
    command, heard_s, count = (0.0, 0.0), -COMMAND_TIMEOUT_S, 0
    next_s = time.monotonic()
    while not stop.is_set():
        now_s = time.monotonic()
        for _, v, w in bus.take_commands():
            command, heard_s = (v, w), now_s
        if now_s - heard_s > COMMAND_TIMEOUT_S:
            command = (0.0, 0.0)
        # The robot catches up with the clock if this thread wakes up late.
        lag_s = 1e-9 * (time.time_ns() - drive.motion.stamp_ns)
        if lag_s > 0.0:  # not if the computer's clock was set back
            motion = drive.step(min(lag_s, 1.0), *command)
            bus.send([odometry_message(motion)])
            if count % truth_every == 0:
                bus.send([truth_message(motion)])
            count += 1
        next_s = max(next_s + period_s, time.monotonic())
        stop.wait(max(0.0, next_s - time.monotonic()))


def _sense(rig: Rig, drive: DriveTrain, bus: SimBus, stop: threading.Event) -> None:
    """Send one sensor's data at its rate, and its description once a second."""
    next_s = describe_at_s = time.monotonic()
    motion = None
    while not stop.is_set():
        if drive.motion is motion:  # the robot's thread is late: no sensor sends one stamp twice
            stop.wait(_POLL_S)
            continue
        motion = drive.motion
        if time.monotonic() >= describe_at_s:
            bus.send(rig.description(motion.stamp_ns))
            describe_at_s += 1.0 / _DESCRIPTION_HZ
        rig.look(motion.pose)
        bus.send(rig.messages(motion.stamp_ns))
        next_s = next_frame(next_s, 1.0 / rig.rate_hz, time.monotonic())
        stop.wait(next_s - time.monotonic())


def next_frame(due_s: float, period_s: float, now_s: float) -> float:
    """Return when the image after the one due at `due_s` is due; images already late are skipped.

    >>> next_frame(10.0, 0.5, 10.25), next_frame(10.0, 0.5, 11.75)
    (10.5, 12.0)
    """
    late_s = max(0.0, now_s - due_s)
    return due_s + period_s * (int(late_s / period_s) + 1)


def run_lockstep(
    config: Config, world: World, drive: DriveTrain, bus: SimBus, stop: threading.Event
) -> None:
    """Send the sensor data of time t, wait for the command that answers t, drive one step; repeat.

    There is no timeout. If a slow computer could advance the clock without a command, the run would
    be different each time.
    """
    rigs = make_rigs(config, world)
    while not stop.is_set():
        motion = drive.motion
        for rig in rigs:
            rig.look(motion.pose)
        command = _command_for(motion, rigs, bus, stop)
        if command is not None:
            drive.step(config.sim.step_s, *command)


def _command_for(
    motion: MotionState, rigs: list[Rig], bus: SimBus, stop: threading.Event
) -> tuple[float, float] | None:
    """Send the sensor data of one instant again and again, until a command has its stamp.

    Returns:
        Speed [m/s] and turn rate [rad/s] of the command; None if `stop` was set first.
    """
    stamp_ns, begun_s, sent_s, warned = motion.stamp_ns, time.monotonic(), 0.0, False
    while not stop.is_set():
        now_s = time.monotonic()
        if now_s - sent_s > REPEAT_S:
            sent_s = now_s
            bus.send([odometry_message(motion), truth_message(motion)])
            for rig in rigs:
                bus.send(rig.description(stamp_ns))
            for rig in rigs:
                bus.send(rig.messages(stamp_ns))
        for answered_ns, v, w in bus.take_commands():
            if answered_ns == stamp_ns:
                return v, w
        if now_s - begun_s > WARN_AFTER_S and not warned:
            warned = True
            log.warning(
                "simulator: no velocity command for t = %.2f s; check that the controller runs",
                stamp_ns * 1e-9,
            )
        stop.wait(_POLL_S)
    return None
