"""The loop's beat: in real time or in lockstep, until it is told to stop."""

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
from edge.loop.faults import IDLE, TICK
from edge.loop.reload import Reloader
from edge.loop.service import DETECT, INGEST, Service
from edge.loop.source import NO_DROPS, Source
from edge.loop.stages import STAGES
from edge.perception.worker import DetectorWorker
from edge.types import MissionStatus, Observation

_MISSED_STEPS = 8
_LEAP_NS = 60_000_000_000  # no two observations in lockstep are this far apart
_PATIENCE_S = 0.05  # how long lockstep waits for an observation before it looks at `stop`


class Server(Protocol):
    """Takes requests on the side (see `edge.bus.requests`)."""

    def serve(self, now_ns: int) -> int:
        """Do what waits, at the loop's time; never blocks."""


@dataclass
class Running:
    """A service, what it listens to, and what is asked of it.

    Attributes:
        config: of the start.
        now_ns: the loop's time at its newest beat; 0 before there was one.
        epoch: of the source, as the service knows it.
        reloader: changes the service's configuration when it is asked to; None: nobody asks.
        clock: the loop's time outside lockstep, in ns, as that of a recording that is played;
            None: the wall clock's.
    """

    config: Config
    service: Service
    worker: DetectorWorker
    source: Source
    servers: Mapping[str, Server]
    now_ns: int = field(default=0, init=False)
    epoch: int = field(default=0, init=False)
    reloader: Reloader | None = field(default=None, init=False)
    clock: Callable[[], int] | None = field(default=None, init=False)


def loop(
    running: Running,
    stop: threading.Event,
    once: bool = False,
    each: Callable[[], None] = lambda: None,
) -> MissionStatus:
    """Tick at `loop.hz` (or with every observation, in lockstep) until `stop` is set.

    Args:
        once: return as soon as the mission is over, whether or not anything is to be seen.
        each: called after every tick.
    """
    step = _lockstep if running.config.loop.lockstep else _real_time
    service = running.service
    with real_time(running.config.loop.priority):
        for _ in step(running, stop):
            each()
            _count_drops(running)
            if once and service.status.done:
                break
    return service.status


def _count_drops(running: Running) -> None:
    """What never became an observation, and the observations that the detector never saw."""
    counters, latency = running.source.counters, running.service.latency
    dropped = sum(n for reason, n in counters.items() if reason not in NO_DROPS)
    latency.set_drops(INGEST, dropped)
    latency.set_drops(DETECT, running.worker.stats.replaced)


def _real_time(running: Running, stop: threading.Event) -> Iterator[None]:
    """Tick on a fixed beat; a late tick shifts the beat instead of being caught up with.

    A beat that finds nothing is followed by the next a little sooner, so that the loop falls into
    step with a camera of its own rate: the two would otherwise drift past each other, and the loop
    find now two frames, of which it drops one, now none.

    The loop's time is the wall clock's at the start, and goes on evenly from there: a clock that
    is set while the robot drives must not end the mission.
    """
    wall_ns = time.time_ns() - time.monotonic_ns()
    clock = running.clock or (lambda: wall_ns + time.monotonic_ns())
    period_ns = int(1e9 / running.config.loop.hz)
    deadline_ns = perf_counter_ns()
    while not stop.is_set():
        observation = _hear(running, clock())
        now_ns = running.now_ns = clock()
        _obey(running, now_ns)
        if observation is None:
            _idle(running, now_ns)
        else:
            _tick(running, observation, now_ns)
        yield
        deadline_ns += period_ns if observation is not None else period_ns // _MISSED_STEPS
        rest_ns = deadline_ns - perf_counter_ns()
        if rest_ns > 0:
            time.sleep(rest_ns * 1e-9)
        elif rest_ns < -period_ns:
            deadline_ns = perf_counter_ns()


def _lockstep(running: Running, stop: threading.Event) -> Iterator[None]:
    """Tick once for every observation, on the observation's own clock.

    That clock stands still while nothing is to be seen, and so does the robot. When that has
    taken as long, in real time, as the mission may, the mission is over all the same, unless its
    first observation is yet to come. Where it was set anew, the loop's time goes on from where it
    was.
    """
    seen_s, now_ns, stamp_ns = math.inf, 0, 0
    while not stop.is_set():
        observation = _hear(running, now_ns) if _wait(running, now_ns) else None
        if observation is not None:
            seen_s = time.monotonic()
            now_ns = _later(now_ns, observation.stamp_ns - stamp_ns)
            stamp_ns = observation.stamp_ns
        running.now_ns = now_ns
        _obey(running, now_ns)
        if observation is not None:
            _tick(running, observation, now_ns)
        elif time.monotonic() - seen_s > (limit_s := running.service.config.mission.time_limit_s):
            running.service.fail(f"nothing to be seen for {limit_s:g} s", now_ns)
            _idle(running, now_ns)
        yield


def _later(now_ns: int, passed_ns: int) -> int:
    """The loop's time when so much has passed on the sensors' clock, unless that was set."""
    if now_ns == 0:  # the first observation
        return passed_ns
    return now_ns + (passed_ns if 0 < passed_ns <= _LEAP_NS else 0)


# What follows is called by the loop, and raises nothing into it: whatever one message, request
# or frame does, the next one's turn comes (see `edge.loop.faults`).


def _wait(running: Running, now_ns: int) -> bool:
    """Whether there is something new to hear, in lockstep."""
    wait = partial(running.source.wait, _PATIENCE_S)
    came = running.service.faults.attempt("wait", now_ns, wait)
    if came is None:
        time.sleep(_PATIENCE_S)  # a source that fails at once must not have the loop spin
    return bool(came)


def _hear(running: Running, now_ns: int) -> Observation | None:
    """What the controller said, and what there is to be seen now."""
    service = running.service
    service.latency.begin_tick(perf_counter_ns())
    for answer in service.faults.attempt("goal_status", now_ns, running.source.inbox.poll) or ():
        with service.faults.outlived("goal answer", now_ns):
            service.goal_answered(answer)
    failed = service.faults.failed
    observation = service.faults.attempt("source", now_ns, running.source.poll)
    if service.faults.failed > failed:
        service.latency.abandon_tick(INGEST)
    return observation


def _obey(running: Running, now_ns: int) -> None:
    """Take the next requests from outside, if there are any, and the next step of a swap, of the
    governor or of a reload."""
    service = running.service
    for key, server in running.servers.items():
        service.faults.attempt(key, now_ns, partial(server.serve, now_ns))
    with service.faults.outlived("swap", now_ns):
        service.swapper.step(now_ns)
    if service.governor is not None:
        with service.faults.outlived("governor", now_ns):
            service.governor.step(now_ns)
    if running.reloader is not None:
        with service.faults.outlived("reload", now_ns):
            running.reloader.step(now_ns)


def _idle(running: Running, now_ns: int, dropped: Observation | None = None) -> None:
    with running.service.faults.outlived(IDLE, now_ns):
        running.service.idle(now_ns, running.source.pose, dropped)


def _tick(running: Running, observation: Observation, now_ns: int) -> None:
    """Take an observation through all stages; one that a stage fails on is dropped."""
    service = running.service
    service.latency.mark(INGEST, perf_counter_ns())
    service.stage = INGEST
    try:
        _see(running, observation, now_ns)
    except Exception as error:
        service.latency.abandon_tick(service.stage)
        service.faults.caught(TICK, error, now_ns, where=STAGES[service.stage].name)
        # No one has looked: where that goes on, the robot must not drive on.
        _idle(running, now_ns, observation)
    else:
        service.faults.passed(TICK, now_ns)
        if service.refused:
            _idle(running, now_ns, observation)
        else:
            service.faults.passed(IDLE, now_ns)  # of which a whole tick does all
        service.latency.end_tick(perf_counter_ns())
    finally:
        observation.release()


def _see(running: Running, observation: Observation, now_ns: int) -> None:
    # Before the tick, so that the map of the old frame does not take in the first of the new one.
    if running.source.epoch != running.epoch:
        running.service.forget_places(now_ns)
        running.epoch = running.source.epoch
    running.service.tick(observation, now_ns)
