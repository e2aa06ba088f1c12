"""The loop: it reads the source, serves requests and runs ticks, until it is stopped.

In real time it runs at `loop.hz`. In lockstep it runs one tick for each observation, on the clock
of the observations. A *cycle* is one pass of the loop, with or without an observation.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter_ns
from typing import Protocol

from edge.config import Config
from edge.host.priority import real_time
from edge.host.stop_latch import StopLatch
from edge.loop.error_boundary import IDLE, TICK
from edge.loop.reload import Reloader
from edge.loop.service import Service
from edge.loop.source import NO_DROPS, Source
from edge.loop.stages import DETECT, INGEST, STAGES
from edge.perception.worker import DetectorWorker
from edge.types import MissionStatus, Observation

_MISSED_PERIOD_SHARE = 8  # a cycle without an observation is shorter by this factor
_MAX_STEP_NS = 60_000_000_000  # in lockstep, a longer time between observations is a jump
_WAIT_S = 0.05  # in lockstep, longest wait for a message before `stop` is checked


class Server(Protocol):
    """A server of requests (see `edge.bus.requests`)."""

    def serve(self, now_ns: int) -> int:
        """Handle the waiting requests at this loop time. Never block."""


@dataclass(kw_only=True)
class RunningService:
    """A service with its source and its request servers.

    Attributes:
        source: Source of observations and goal statuses.
        latch: The stop of the robot.
        clock: Returns the loop time outside lockstep, in ns, for example of a recording that is
            played. None: wall-clock time.
        reloader: Reloads the configuration on request; may be set. None if reloads are not
            possible.
        now_ns: Loop time of the newest cycle; 0 before the first.
        epoch: Newest `Source.epoch` that the service has handled; a higher one means a pose jump.
    """

    config: Config
    service: Service
    worker: DetectorWorker
    source: Source
    servers: Mapping[str, Server]
    latch: StopLatch = field(default_factory=StopLatch)
    clock: Callable[[], int] | None = None
    reloader: Reloader | None = field(default=None, init=False)
    now_ns: int = field(default=0, init=False)
    epoch: int = field(default=0, init=False)


def loop(
    running: RunningService,
    stop: threading.Event,
    once: bool = False,
    each: Callable[[], None] = lambda: None,
) -> MissionStatus:
    """Run ticks at `loop.hz`, or one for each observation in lockstep, until `stop` is set.

    Args:
        running: The service to run.
        stop: Event that ends the loop.
        once: Return as soon as the mission is over, even without observations.
        each: Function that is called after each cycle, with or without an observation.
    """
    cycles = _lockstep if running.config.loop.lockstep else _real_time
    service = running.service
    with real_time(running.config.loop.priority):
        for _ in cycles(running, stop):
            each()
            running.latch.confirm(service.control.stopped)
            _count_drops(running)
            if once and service.status.done:
                break
    return service.status


def _count_drops(running: RunningService) -> None:
    """Count the messages that became no observation, and the images that the detector skipped."""
    counters, latency = running.source.counters, running.service.latency
    dropped = sum(n for reason, n in counters.items() if reason not in NO_DROPS)
    latency.set_drops(INGEST, dropped)
    latency.set_drops(DETECT, running.worker.stats.replaced)


def _real_time(running: RunningService, stop: threading.Event) -> Iterator[None]:
    """Run cycles at a fixed period. A cycle that is a full period late shifts the schedule.

    A cycle without an observation is followed by the next one after an eighth of the period. This
    synchronises the loop to the camera. Otherwise the two rates would drift, and the loop would
    find two frames in one cycle (and drop one) and none in another.

    The loop time starts at wall-clock time and then follows the monotonic clock, because a change
    of the wall clock during a mission must not end the mission.
    """
    wall_ns = time.time_ns() - time.monotonic_ns()
    clock = running.clock or (lambda: wall_ns + time.monotonic_ns())
    period_ns = int(1e9 / running.config.loop.hz)
    deadline_ns = perf_counter_ns()
    while not stop.is_set():
        observation = _read_inputs(running, clock())
        now_ns = running.now_ns = clock()
        _serve_requests(running, now_ns)
        if observation is None:
            _idle(running, now_ns)
        else:
            _tick(running, observation, now_ns)
        yield
        deadline_ns += period_ns if observation is not None else period_ns // _MISSED_PERIOD_SHARE
        rest_ns = deadline_ns - perf_counter_ns()
        if rest_ns > 0:
            time.sleep(rest_ns * 1e-9)
        elif rest_ns < -period_ns:
            deadline_ns = perf_counter_ns()


def _lockstep(running: RunningService, stop: threading.Event) -> Iterator[None]:
    """Run one tick for each observation, on the clock of the observations.

    This clock stops while no observations come. The mission fails if they stop for longer than its
    time limit, in real time; before the first observation there is no such limit. If the clock of
    the observations jumps, the loop time continues from its last value.

    Of two cameras, one may be late: its stamps then do not set the clock.
    """
    now_ns, stamp_ns, clock_camera = 0, 0, 0
    observed_s, mission = math.inf, running.service.mission
    while not stop.is_set():
        observation = _read_inputs(running, now_ns) if _has_message(running, now_ns) else None
        if observation is not None:
            observed_s = time.monotonic()
            passed_ns = observation.stamp_ns - stamp_ns
            now_ns = _advanced(now_ns, passed_ns)
            if passed_ns >= 0 or observation.camera_index == clock_camera:
                stamp_ns, clock_camera = observation.stamp_ns, observation.camera_index
        running.now_ns = now_ns
        _serve_requests(running, now_ns)
        if running.service.mission is not mission:  # a new mission has its own time
            mission, observed_s = running.service.mission, max(observed_s, time.monotonic())
        limit_s = running.service.config.mission.time_limit_s
        if observation is not None:
            _tick(running, observation, now_ns)
        elif not mission.done and time.monotonic() - observed_s > limit_s:
            running.service.control.fail(f"no observation for {limit_s:g} s", now_ns)
            _idle(running, now_ns)
        yield


def _advanced(now_ns: int, passed_ns: int) -> int:
    """Return the loop time `passed_ns` later; a jump of the sensors' clock adds nothing."""
    if now_ns == 0:  # the first observation
        return passed_ns
    return now_ns + (passed_ns if 0 < passed_ns <= _MAX_STEP_NS else 0)


# The functions below run in the loop and do not raise: an error of one message, request or frame
# must not stop the next one (see `edge.loop.error_boundary`).


def _has_message(running: RunningService, now_ns: int) -> bool:
    """Wait a short time for a message of the source; return True if there is one."""
    wait = partial(running.source.wait, _WAIT_S)
    has_message = running.service.error_boundary.call("wait", now_ns, wait)
    if has_message is None:
        time.sleep(_WAIT_S)  # a source that fails at once must not make the loop spin
    return bool(has_message)


def _read_inputs(running: RunningService, now_ns: int) -> Observation | None:
    """Begin a tick: handle the goal statuses, and return the newest observation, if any.

    If the source fails, the tick is abandoned.
    """
    service = running.service
    service.latency.begin_tick(perf_counter_ns())
    poll = running.source.inbox.poll
    for status in service.error_boundary.call("goal statuses", now_ns, poll) or ():
        with service.error_boundary.contain("goal status", now_ns):
            service.on_goal_status(status)
    failed = service.error_boundary.failed
    observation = service.error_boundary.call("source", now_ns, running.source.poll)
    if service.error_boundary.failed > failed:
        service.latency.abandon_tick(INGEST)
    return observation


def _serve_requests(running: RunningService, now_ns: int) -> None:
    """Apply a stop; serve waiting requests; advance the model swap, load shedder and reload."""
    service, reason = running.service, running.latch.reason
    if reason != service.control.stopped:
        with service.error_boundary.contain("stop", now_ns):
            service.control.stop(reason, now_ns)
    for key, server in running.servers.items():
        service.error_boundary.call(key, now_ns, partial(server.serve, now_ns))
    service.control.end_pause(now_ns)
    with service.error_boundary.contain("swap", now_ns):
        service.detector_swap.step(now_ns)
    if service.load_shedder is not None:
        with service.error_boundary.contain("load shedding", now_ns):
            service.load_shedder.step(now_ns)
    if running.reloader is not None:
        with service.error_boundary.contain("reload", now_ns):
            running.reloader.step(now_ns)


def _idle(running: RunningService, now_ns: int, dropped: Observation | None = None) -> None:
    """Do what a cycle without a usable observation does; `dropped` is one that was not used."""
    with running.service.error_boundary.contain(IDLE, now_ns):
        running.service.idle(now_ns, running.source.pose, dropped)


def _tick(running: RunningService, observation: Observation, now_ns: int) -> None:
    """Run all stages on an observation. If a stage fails, the observation is dropped."""
    service = running.service
    service.latency.mark(INGEST, perf_counter_ns())
    service.stage = INGEST
    try:
        _handle_observation(running, observation, now_ns)
    except Exception as error:
        service.latency.abandon_tick(service.stage)
        service.error_boundary.on_error(TICK, error, now_ns, where=STAGES[service.stage].name)
        # The observation was not used. If this continues, the robot must stop.
        _idle(running, now_ns, observation)
    else:
        service.error_boundary.on_success(TICK, now_ns)
        if service.refused:
            _idle(running, now_ns, observation)
        else:
            # An entire tick does all that `idle` does.
            service.error_boundary.on_success(IDLE, now_ns)
        service.latency.end_tick(perf_counter_ns())
    finally:
        observation.release()


def _handle_observation(running: RunningService, observation: Observation, now_ns: int) -> None:
    """Run the tick; handle a pose jump first."""
    # Before the tick, so that the first observation of the new frame is not put into the old map.
    if running.source.epoch != running.epoch:
        running.service.on_pose_jump(now_ns)
        running.epoch = running.source.epoch
    running.service.tick(observation, now_ns)
