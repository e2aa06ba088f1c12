"""The loops around the service, with a source and a controller played by the test."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from types import SimpleNamespace

import pytest
from frames import Slot, blank_observation
from patience import eventually
from simulated import simulated

from edge.errors import Stopped
from edge.geometry import SE2
from edge.host import resources
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop import runner
from edge.loop.error_boundary import DEGRADED_AFTER
from edge.loop.runner import RunningService, loop
from edge.loop.stages import STAGES
from edge.loop.status import PartsStatus, status_message
from edge.perception.runtime.health import ModelHealth
from edge.perception.worker import DetectorWorker
from edge.types import GoalStatus, Observation


class Source:
    """Source of given observations; the one at `jump_at` begins a new epoch."""

    def __init__(self, observations: list[Observation], jump_at: int = -1) -> None:
        self.counters = Counter(received=0, observations=0)
        self.epoch = 0
        self.inbox = SimpleNamespace(poll=list)
        self.pose: SE2 | None = None
        self.observations = observations
        self._jump_at = jump_at

    def wait(self, timeout_s: float) -> bool:
        if not self.observations:
            time.sleep(0.001)
        return bool(self.observations)

    def poll(self) -> Observation | None:
        if not self.observations:
            return None
        observation = self.observations.pop(0)
        self.epoch += observation.seq == self._jump_at
        return observation

    def close(self) -> None: ...


def running(lockstep: bool, frames: int = 0, jump_at: int = -1, **mission) -> RunningService:
    config = simulated(
        {"loop": {"lockstep": lockstep, "hz": 200.0}, "mission": {"target": "bed", **mission}}
    )
    closed = ClosedLoop(config)
    return running_of(closed, blanks(closed, frames), jump_at)


def blanks(closed: ClosedLoop, frames: int) -> list[Observation]:
    """Frames in which nothing returned, a tenth of a second apart."""
    pose, start_ns = closed.drive.motion.odometry, closed.drive.motion.stamp_ns
    return [
        replace(blank_observation(i, start_ns + i * 10**8, pose, closed), slot=Slot(holds=1))
        for i in range(frames)
    ]


def running_of(
    closed: ClosedLoop,
    seen: list[Observation],
    jump_at: int = -1,
    worker: DetectorWorker | None = None,
) -> RunningService:
    """Return the loop over these frames, with another worker if one is given."""
    servers = {"mission/request": SimpleNamespace(serve=lambda now_ns: 0)}
    service, source = closed.service, Source(seen, jump_at)
    if worker is not None:
        service.perception.worker = service.parts_status._worker = worker
    return RunningService(
        config=closed.config, service=service, worker=service.perception.worker, source=source,
        servers=servers,
    )  # fmt: skip


def run_out(run: RunningService, seen: list[Observation]) -> None:
    """Let the loop see all of it."""
    stop = threading.Event()
    loop(run, stop, each=lambda: None if seen else stop.set())


def test_in_lockstep_a_late_second_camera_keeps_the_clock():
    """Its stamps are two seconds old; a second of the first one is a second of the loop."""
    run = running(lockstep=True)
    seen = blanks(ClosedLoop(run.config), 21)
    for i in range(1, 21, 2):
        late_ns = seen[i].stamp_ns - 2 * 10**9
        seen[i] = replace(seen[i], camera_index=1, stamp_ns=late_ns)
    run.source.observations = seen
    times_ns = []
    stop = threading.Event()
    loop(run, stop, each=lambda: times_ns.append(run.now_ns) or (seen or stop.set()))
    assert run.now_ns - times_ns[0] == 2 * 10**9
    assert times_ns == sorted(times_ns)


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("frames", [1, 2])
def test_once_ends_though_nothing_is_to_be_seen_any_more(lockstep, frames):
    # The first tick loads kernels; simulated time stands still meanwhile.
    run = running(lockstep, frames, time_limit_s=0.5)
    status = loop(run, threading.Event(), once=True)
    assert status.phase == "failed"
    assert "0.5 s" in status.reason


def test_in_lockstep_a_new_mission_has_its_own_time_to_wait_for_an_observation():
    run, stop, failed_s = running(True, 1, time_limit_s=0.3), threading.Event(), []

    def each() -> None:
        if run.service.mission.done:
            failed_s.append(time.monotonic())
            if len(failed_s) == 1:
                run.service.begin(run.service.mission.spec, run.now_ns)
            elif len(failed_s) == 4:
                stop.set()

    loop(run, stop, each=each)
    assert failed_s[1] - failed_s[0] > 0.3
    kinds = [record.kind for record in run.service._input_log.pending]
    assert kinds.count("fail") <= 1


@pytest.mark.parametrize("lockstep", [False, True])
def test_once_waits_for_sensors_that_have_not_spoken_yet(lockstep):
    run, stop = running(lockstep, 0, time_limit_s=0.05), threading.Event()
    end_s = time.monotonic() + 0.5  # ten times the limit of the mission
    status = loop(run, stop, True, lambda: stop.set() if time.monotonic() > end_s else None)
    assert (status.phase, status.elapsed_s) == ("searching", 0.0)


def test_a_changed_wall_clock_does_not_end_a_mission(monkeypatch):
    run, stop, ticks = running(False, time_limit_s=300.0), threading.Event(), []
    monkeypatch.setattr(runner.time, "time_ns", lambda: 10**18 + len(ticks) * 10**13)

    def each() -> None:
        ticks.append(run.service.status)
        if len(ticks) == 5:
            stop.set()

    assert loop(run, stop, once=True, each=each).phase == "searching"
    assert len(ticks) == 5


@pytest.mark.parametrize("steps_s", [(1.0, -400.0, 1.0), (1.0, 1e9, 1.0), (1.0, -3e9, 2.5e9)])
def test_a_reset_sensor_clock_does_not_move_lockstep_time(steps_s):
    """Otherwise a wait never ends, or a mission ends by its time limit."""
    run, stop, times = running(True, time_limit_s=300.0), threading.Event(), []
    run.service.tick = lambda observation, now_ns: times.append(now_ns)
    stamp_ns = 2 * 10**9
    seen = [SimpleNamespace(seq=0, camera_index=0, stamp_ns=stamp_ns, release=lambda: None)]
    for step_s in steps_s:
        stamp_ns += int(step_s * 1e9)
        seen.append(SimpleNamespace(seq=0, camera_index=0, stamp_ns=stamp_ns, release=lambda: None))
    run.source.observations = seen
    loop(run, stop, each=lambda: stop.set() if len(times) == 4 else None)
    assert times[:2] == [2 * 10**9, 3 * 10**9]
    assert [b - a for a, b in pairwise(times)] == [10**9 * (0 < s <= 60) for s in steps_s]


def test_stages_are_in_the_order_of_the_table():
    from edge.loop import stages

    for index, stage in enumerate(STAGES):
        assert getattr(stages, stage.name.upper()) == index
        assert (resources.PACKAGE.parent / stage.code).exists(), stage.code


def broken(*_, **__) -> None:
    raise ZeroDivisionError("oh no")


BREAKS: dict[str, Callable[[RunningService], tuple[object, str]]] = {
    "ingest": lambda run: (run.service, "on_pose_jump"),
    "check": lambda run: (run.service.plausibility, "permitted_use"),
    "detect": lambda run: (run.service.perception.worker, "submit"),
    "map": lambda run: (run.service.perception, "map"),
    "lift": lambda run: (run.service.map._back_projector, "back_project"),
    "candidates": lambda run: (run.service.map, "update_candidates"),
    "score": lambda run: (run.service.perception.policy, "score"),
    "plan": lambda run: (run.service.mission, "observe"),
    "select": lambda run: (run.service.goals.chooser, "choose"),
    "publish": lambda run: (run.service.goals, "send_pending"),
}


@pytest.mark.parametrize("stage", [stage.name for stage in STAGES])
def test_a_failing_stage_loses_only_its_frames(stage, monkeypatch):
    failing, passing = DEGRADED_AFTER + 2, 3
    closed = ClosedLoop(simulated({"loop": {"lockstep": True}, "mission": {"target": "bed"}}))
    seen = blanks(closed, failing + passing)
    slots, states = [observation.slot for observation in seen], []
    run = running_of(closed, seen, jump_at=0 if stage == "ingest" else -1)
    service, stop = run.service, threading.Event()
    breaking = ExitStack()
    breaking.enter_context(monkeypatch.context()).setattr(*BREAKS[stage](run), broken)

    def each() -> None:
        states.append(status_message(service.result())["loop"]["state"])
        if len(seen) == passing and len(states) == failing:
            breaking.close()
        if not seen:
            stop.set()

    with breaking:
        loop(run, stop, each=each)
    assert states.index("degraded") == DEGRADED_AFTER - 1
    assert states[-passing:] == ["ok"] * passing
    said = status_message(service.result())["loop"]
    assert said["failures"][f"{stage}: ZeroDivisionError"] == failing
    assert "oh no" in said["last_error"]
    report = service.latency.report()
    assert (report.tick.count, report.tick.drops) == (passing, failing)
    assert report.stage(stage).drops == failing
    run.worker.close()  # it may still hold its last result
    assert [slot.holds for slot in slots] == [0] * len(slots)


@pytest.mark.parametrize("stage", ["map", "plan", "publish"])
def test_failing_ticks_stop_the_robot_like_missing_images(stage, monkeypatch):
    closed = ClosedLoop(simulated({"loop": {"lockstep": True}, "mission": {"target": "surfboard"}}))
    while not (closed.service.goals.client.driving and closed.drive.motion.v_mps > 0.2):
        closed.step()
    seen, before = blanks(closed, 20), len(closed.notes.goals)
    run = running_of(closed, seen)
    run.source.pose = closed.drive.motion.odometry
    monkeypatch.setattr(*BREAKS[stage](run), broken)
    run_out(run, seen)
    assert [goal.kind for goal in closed.notes.goals[before:]] == ["spin"]
    assert closed.notes.goals[-1].pose == run.source.pose
    # One second after the last good tick, which was a tenth of a second before the first bad one.
    assert closed.notes.goals[-1].stamp_ns - closed.drive.motion.stamp_ns == pytest.approx(1e9, 2e8)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, Stopped])
def test_an_exception_that_ends_the_process_ends_the_loop(error, monkeypatch):
    run, slot = running(True, frames=1), Slot(holds=1)
    run.source.observations[0] = replace(run.source.observations[0], slot=slot)

    def ends(*_) -> None:
        raise error

    monkeypatch.setattr(run.service, "tick", ends)
    with pytest.raises(error):
        loop(run, threading.Event())
    assert slot.holds == 0


@pytest.mark.parametrize("inline", [True, False])
def test_a_failing_detector_is_degraded_until_it_works_again(inline, monkeypatch):
    closed = ClosedLoop(simulated({"loop": {"lockstep": True}, "mission": {"target": "bed"}}))
    failing, passing = DEGRADED_AFTER + 2, 3
    seen = blanks(closed, failing + passing)
    detector = closed.service.perception.worker.detector
    run = running_of(closed, seen, worker=DetectorWorker(detector, inline))
    service, stop, states = run.service, threading.Event(), []
    whole = detector.detect
    monkeypatch.setattr(detector, "detect", broken)

    def each() -> None:
        eventually(lambda: run.worker.idle)
        states.append(status_message(service.result())["detector"])
        if len(states) == failing:
            monkeypatch.setattr(detector, "detect", whole)
        if not seen:
            stop.set()

    loop(run, stop, each=each)
    run.worker.close()
    well, ill = ("ok", ""), ("degraded", "fails on every image: ZeroDivisionError: oh no")
    assert [(s["state"], s["detail"]) for s in states] == [
        *[well] * (DEGRADED_AFTER - 1), *[ill] * 3, *[well] * passing
    ]  # fmt: skip
    name = f"detector {detector.name}: "
    texts = [text.removeprefix(name) for text in closed.notes.events if text.startswith(name)]
    assert texts == [f"degraded: {ill[1]}", "works again"]
    assert status_message(service.result())["loop"]["state"] == "ok"


def test_each_change_of_the_detector_is_reported_once():
    """A detector on a server is replaced by one here, fails altogether, and works again."""
    far, near = ModelHealth(), ModelHealth("ok", "near answers until far does again: no connection")
    loads, ill = ModelHealth("building engine", "5 s"), ModelHealth("degraded", "near: it ended")
    now = SimpleNamespace(health=far)
    detector = SimpleNamespace(name="far", health=lambda: now.health)
    worker = SimpleNamespace(detector=detector, stats=SimpleNamespace(in_a_row=0))
    texts: list[str] = []
    watch = PartsStatus(worker, {}, None, None, lambda text, now_ns: texts.append(text))
    for now.health in (loads, far, far, near, near, ill, ill, near, far, near, far, far):
        watch.check(0)
    assert [text.removeprefix("detector far: ") for text in texts] == [
        near.detail, f"degraded: {ill.detail}", near.detail, "works again", near.detail,
        "works again",
    ]  # fmt: skip


class Sink:
    """Notes the stamps of the ticks that it gets."""

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []

    def tick(self, result) -> None:
        self.stamps_ns.append(result.observation.stamp_ns)


class BadSink:
    tick = broken


def test_a_failing_sink_does_not_affect_the_others():
    sinks = [BadSink(), Sink()]
    closed = ClosedLoop(
        simulated({"loop": {"lockstep": True}, "mission": {"target": "bed"}}), sinks=sinks
    )
    seen = blanks(closed, DEGRADED_AFTER)
    run_out(running_of(closed, seen), seen)
    assert len(sinks[1].stamps_ns) == DEGRADED_AFTER
    said = closed.service.error_boundary.status()
    assert said["state"] == "degraded"
    assert said["failures"]["BadSink.tick: ZeroDivisionError"] == DEGRADED_AFTER
    assert closed.service.latency.report().tick.drops == 0
    assert closed.notes.goals


@pytest.mark.parametrize("stage", ["ingest", "map", "publish"])
def test_a_frame_that_fails_still_counts_as_handled(stage, monkeypatch):
    """In lockstep the simulator's clock stands still until it is."""
    sink = Sink()
    closed = ClosedLoop(
        simulated({"loop": {"lockstep": True}, "mission": {"target": "bed"}}), sinks=[sink]
    )
    seen = blanks(closed, 3)
    stamps_ns = [observation.stamp_ns for observation in seen]
    run = running_of(closed, seen, jump_at=0 if stage == "ingest" else -1)
    monkeypatch.setattr(*BREAKS[stage](run), broken)
    run_out(run, seen)
    assert sink.stamps_ns == stamps_ns


def ticks(run: RunningService) -> int:
    return run.service.latency.report().tick.count


@pytest.mark.parametrize(
    ("lockstep", "part", "method", "step"),
    [
        (False, "source.inbox", "poll", "goal statuses"),
        (False, "source", "poll", "source"),
        (False, "mission/request", "serve", "mission/request"),
        (False, "service", "idle", "idle"),
        (True, "source.inbox", "poll", "goal statuses"),
        (True, "source", "wait", "wait"),
        (True, "source", "poll", "source"),
        (True, "mission/request", "serve", "mission/request"),
    ],
)
def test_the_loop_survives_failures_around_the_ticks(lockstep, part, method, step, monkeypatch):
    run, stop, beats = running(lockstep, frames=1), threading.Event(), []
    if part == "service":  # idle runs only without an observation
        run.source.poll = lambda: run.source.observations.pop() if len(beats) > 2 else None
    owner = run.servers.get(part) or attrgetter(part)(run)
    whole = getattr(owner, method)

    def sometimes(*args) -> object:
        beats.append(len(beats))
        return whole(*args) if len(beats) > 2 else broken()

    monkeypatch.setattr(owner, method, sometimes)
    loop(run, stop, each=lambda: stop.set() if ticks(run) else None)
    assert ticks(run) == 1
    assert run.service.error_boundary.failures == {f"{step}: ZeroDivisionError": min(len(beats), 2)}


def test_one_bad_answer_does_not_affect_the_others(monkeypatch):
    run, heard = running(True, frames=1), []
    answers = [GoalStatus(stamp, "accepted") for stamp in (1, 2, 3)]

    def hear(answer: GoalStatus) -> None:
        heard.append(answer.stamp_ns)
        if answer.stamp_ns == 2:
            broken()

    run.source.inbox = SimpleNamespace(poll=lambda: answers if not heard else [])
    monkeypatch.setattr(run.service, "on_goal_status", hear)
    run_out(run, run.source.observations)
    assert heard == [1, 2, 3]
    assert run.service.error_boundary.failed == 1
