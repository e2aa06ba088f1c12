"""Puts a service together from a configuration and runs it until it is told to stop."""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter_ns

import zenoh

from edge.bus.desk import Desk, Request
from edge.bus.session import zenoh_session
from edge.config import Config
from edge.host import resources
from edge.host.interruptible import raise_if_stopped, unless_stopped
from edge.host.priority import real_time
from edge.loop import models_desk, requests
from edge.loop.advice import make_advisers
from edge.loop.faults import IDLE, TICK
from edge.loop.mission_desk import MissionDesk
from edge.loop.models_desk import ModelsDesk
from edge.loop.service import DETECT, INGEST, Service
from edge.loop.source import Answers, Source
from edge.loop.stages import STAGES
from edge.loop.warmup import warm_up
from edge.mission.brief import prepare
from edge.mission.keeper import Keeper
from edge.perception.cards import ModelError
from edge.perception.detector import Detector, make_detector
from edge.perception.inline import InlineWorker
from edge.perception.sim_detector import Truth
from edge.perception.worker import DetectorWorker
from edge.sinks import Sink
from edge.sinks.zenoh import ZenohSink
from edge.sources import find_source
from edge.sources.truth import make_truth
from edge.text import one_line
from edge.types import MissionStatus, Observation

log = logging.getLogger("edge.loop.runner")

_SWITCH_S = 2e-4
_MISSED_STEPS = 8
_LEAP_NS = 60_000_000_000  # no two observations in lockstep are this far apart
_ORDERS = 12  # more than wait in a desk's first lane
_PATIENCE_S = 0.05  # how long lockstep waits for an observation before it looks at `stop`


@dataclass
class Running:
    """A service with its ears and hands."""

    config: Config
    session: zenoh.Session
    service: Service
    worker: DetectorWorker | InlineWorker
    source: Source
    inbox: Answers
    desk: Desk
    models: Desk
    sinks: list[Sink] = field(default_factory=list)
    epoch: int = 0


@contextmanager
def open_service(
    config: Config,
    sinks: list[Sink],
    asked: str | None = None,
    formula: str | None = None,
    stop: threading.Event | None = None,
) -> Iterator[Running]:
    """Prepare the mission, open Zenoh, load the detector, compile kernels; all closed at exit.

    Zenoh comes before what takes long: where another service has the endpoint, that is known at
    once. Who connects early finds nobody to take orders until all is ready.

    Args:
        sinks: take the results besides the Zenoh sink.
        asked: the configuration's mission, where the command line named it.
        formula: the mission, in place of the configuration's. With neither, a checkpoint's
            unfinished mission goes on, whatever the configuration says.
        stop: once set, the start is broken off. What cannot be, as compiling, is left to a thread
            (`edge.host.interruptible`).

    Raises:
        Stopped: `stop` was set before the service was ready.
        ConfigError: there is no such source.
        UserError: the mission is not understood or cannot be done.
        CheckpointError: `mission.checkpoint` cannot be read or written.
        ModelError: the detector's or a scorer's model is missing or unusable.
        ChatError: the URL of a scorer's server cannot be used.
        BusError: the endpoint cannot be listened on.
    """
    stop = stop or threading.Event()
    make_source = find_source(config)
    with ExitStack() as stack:
        mission, keeper, brief = config.mission, None, None
        if mission.checkpoint is not None:
            named = asked if formula is None else formula
            keeper = Keeper(config, resources.expand(mission.checkpoint), named)
            stack.callback(keeper.close)
            brief = keeper.brief()
        if brief is None:
            brief = prepare(mission, formula=formula)
        raise_if_stopped(stop)
        session = stack.enter_context(
            zenoh_session(config.zenoh, "listen", stop, exact=config.loop.lockstep)
        )
        detector = _load(config, brief.targets, make_truth(config, session), stop)
        worker = (
            InlineWorker(detector, config.loop.detect_every)
            if config.loop.lockstep
            else DetectorWorker(detector)
        )
        stack.callback(worker.close)
        advisers = unless_stopped(partial(make_advisers, config, brief.targets), stop)
        if advisers is not None:
            stack.callback(advisers.close)
        unless_stopped(partial(warm_up, config), stop)
        raise_if_stopped(stop)
        source = make_source(session)
        stack.callback(source.close)
        every: list[Sink] = [ZenohSink(session, config), *sinks]
        for sink in every:
            stack.callback(sink.close)
        service = Service(config, brief, worker, every, keeper, advisers)
        stack.callback(service.close)
        # What start-up made stays for good; the collector need not walk it again in the loop.
        gc.collect()
        gc.freeze()
        stack.callback(gc.unfreeze)
        # Kernels give the interpreter lock away; by default the loop then waits up to 5 ms for the
        # detector's or the sink's thread to give it back, more than a whole tick's budget.
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(_SWITCH_S)
        inbox = source.inbox
        desk = MissionDesk(session, config.zenoh, partial(prepare, mission))
        stack.callback(desk.close)
        models = ModelsDesk(session, config.zenoh)
        stack.callback(models.close)
        running = Running(config, session, service, worker, source, inbox, desk, models, every)
        service.overruns = partial(_overruns, running)
        yield running


def _load(
    config: Config, targets: Sequence[str], truth: Truth | None, stop: threading.Event
) -> Detector:
    """See `make_detector`; raises Stopped once `stop` is set."""
    make = partial(make_detector, config.perception, targets, cancelled=stop, truth=truth)
    if config.perception.isolation == "thread":
        return unless_stopped(make, stop)
    try:
        return make()
    except ModelError:
        raise_if_stopped(stop)
        raise


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
    taken = counters["received"] + counters["observations"] + counters["overrun"]
    latency.set_drops(INGEST, sum(counters.values()) - taken)
    latency.set_drops(DETECT, running.worker.stats.replaced)


def _overruns(running: Running) -> dict[str, int]:
    """Looks that found a ring full once more (see `edge.bus.session.Ring`)."""
    return {
        "sensors": running.source.counters["overrun"],
        "goal_status": running.inbox.overruns,
        "mission/request": running.desk.overruns,
        "models/request": running.models.overruns,
    }


def _real_time(running: Running, stop: threading.Event) -> Iterator[None]:
    """Tick on a fixed beat; a late tick shifts the beat instead of being caught up with.

    A beat that finds nothing is followed by the next a little sooner, so that the loop falls into
    step with a camera of its own rate: the two would otherwise drift past each other, and the loop
    find now two frames, of which it drops one, now none.

    The loop's time is the wall clock's at the start, and goes on evenly from there: a clock that
    is set while the robot drives must not end the mission.
    """
    wall_ns = time.time_ns() - time.monotonic_ns()
    period_ns = int(1e9 / running.config.loop.hz)
    deadline_ns = perf_counter_ns()
    while not stop.is_set():
        observation = _hear(running, wall_ns + time.monotonic_ns())
        now_ns = wall_ns + time.monotonic_ns()
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
    taken as long, in real time, as the mission may, it is over all the same. Where it was set
    anew, the loop's time goes on from where it was.
    """
    limit_s = running.config.mission.time_limit_s
    seen_s, now_ns, stamp_ns = time.monotonic(), 0, 0
    while not stop.is_set():
        observation = _hear(running, now_ns) if _wait(running, now_ns) else None
        if observation is not None:
            seen_s = time.monotonic()
            now_ns = _later(now_ns, observation.stamp_ns - stamp_ns)
            stamp_ns = observation.stamp_ns
        _obey(running, now_ns)
        if observation is not None:
            _tick(running, observation, now_ns)
        elif time.monotonic() - seen_s > limit_s:
            running.service.mission.fail(f"nothing to be seen for {limit_s:g} s", now_ns)
            _idle(running, now_ns)
        yield


def _later(now_ns: int, passed_ns: int) -> int:
    """The loop's time when so much has passed on the sensors' clock, unless that was set."""
    if now_ns == 0:  # the first observation
        return passed_ns
    return now_ns + (passed_ns if 0 < passed_ns <= _LEAP_NS else 0)


# What follows is called by the loop, and raises nothing into it: whatever one message, order or
# frame does, the next one's turn comes (see `edge.loop.faults`).


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
    for answer in service.faults.attempt("goal_status", now_ns, running.inbox.poll) or ():
        with service.faults.outlived("goal answer", now_ns):
            service.goal_answered(answer)
    failed = service.faults.failed
    observation = service.faults.attempt("source", now_ns, running.source.poll)
    if service.faults.failed > failed:
        service.latency.abandon_tick(INGEST)
    return observation


def _obey(running: Running, now_ns: int) -> None:
    """Take the next orders from outside, if there are any, and the next step of a swap."""
    service = running.service
    orders = partial(_serve, running.desk, partial(requests.handle, service), now_ns)
    service.faults.attempt("orders", now_ns, orders)
    orders = partial(_serve, running.models, partial(models_desk.handle, service.swapper), now_ns)
    service.faults.attempt("model orders", now_ns, orders)
    with service.faults.outlived("swap", now_ns):
        service.swapper.step(now_ns)


def _serve(desk: Desk, handle: Callable[[Request, int], None], now_ns: int) -> int:
    """Handle what waits at a desk, and say how much that was; every order is answered."""
    served = 0
    for request in _orders(desk):
        try:
            handle(request, now_ns)
        except Exception as error:
            request.refuse(f"internal error: {one_line(f'{type(error).__name__}: {error}')}")
            raise
        served += 1
    return served


def _orders(desk: Desk) -> Iterator[Request]:
    """What waits at a desk, for one look: a few, of which one was prepared, since a new mission
    takes a while to begin."""
    for _ in range(_ORDERS):
        request = desk.poll()
        if request is None:
            return
        yield request
        if request.prepared is not None:
            return


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
