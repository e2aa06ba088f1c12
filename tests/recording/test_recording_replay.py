"""A recorded run replays to the same, tick for tick, whatever came into it; and what does not."""

from __future__ import annotations

import argparse
import threading
from pathlib import Path

import numpy as np
import pytest
from patience import eventually
from recordings import Recording, small

from edge.geometry import SE2
from edge.loop.scorers import Scorers
from edge.mission.brief import prepare
from edge.perception.choice.question import Choice
from edge.policies import make_policy
from edge.recording import commands
from edge.recording.replay import replay
from edge.recording.rolling import files_of
from edge.recording.session import Session
from edge.types import GoalStatus, Observation


def same(path: Path, ticks: int) -> None:
    session = Session(path)
    outcome = replay(session)
    assert (outcome.first, outcome.differing, outcome.ticks) == (None, 0, ticks)
    assert outcome.goals_then == outcome.goals_now
    assert (session.gap, session.cut) == ("", "")


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    """Thirty ticks with a picture each."""
    recording = Recording(tmp_path_factory.mktemp("drive"), rgb_hz=100.0)
    return recording.steps(30).close()


def test_a_run_without_a_tick(tmp_path):
    recording = Recording(tmp_path)
    recording.service.idle(1, None)
    path = recording.close()
    same(path, 0)
    assert commands.replay(argparse.Namespace(file=path, config=None, detect=False)) == 1


def test_a_drive(drive, capsys):
    same(drive, 30)
    args = argparse.Namespace(file=drive, config=None, detect=False)
    assert commands.replay(args) == 0
    told = capsys.readouterr().out
    assert "30 ticks" in told
    assert "the same, tick for tick" in told
    assert "select" in told


def test_all_that_can_come_into_the_loop(tmp_path):
    """Requests, answers, idle beats, a jump, a reload, a tick that fails, in one run."""
    recording = Recording(tmp_path).steps(5)
    service, closed = recording.service, recording.closed
    now_ns = closed.drive.motion.stamp_ns
    service.pause(True, now_ns)
    recording.steps(2)
    service.idle(now_ns + 1, SE2(0.0, 0.0, 0.0))
    service.pause(False, now_ns)
    recording.steps(3)
    service.goal_answered(GoalStatus(service.goal.stamp_ns, "failed", "stuck", (1.0, 2.0)))
    recording.steps(3)
    service.begin(prepare(service.config.mission, formula="F sofa & F bed"), now_ns)
    recording.steps(5)
    service.forget_places(closed.drive.motion.stamp_ns)
    recording.steps(4)
    for k in range(12):  # nothing to be seen, until no one drives on
        service.idle(closed.drive.motion.stamp_ns + k * 200_000_000, SE2(0.1, 0.2, 0.3))
    other = small(policy={"kind": "nearest_frontier"}, perception={"tau_det": 0.5})
    service.reconfigure(other, make_policy(other.policy))
    recording.steps(5)
    broken = Observation(1000, now_ns, np.full((4, 4), np.nan), depth_m=np.ones((3, 5), np.float32),
                         camera=closed.rig.model)  # fmt: skip
    with pytest.raises((ValueError, IndexError)):
        service.tick(broken, now_ns)
    service.idle(now_ns, None, broken)
    service.fail("cancelled", now_ns)
    recording.steps(2)
    kinds = {entry.kind for m in Session(recording.close()).moments() for entry in m.page.entries}
    assert kinds >= {
        "start",
        "tick",
        "idle",
        "answer",
        "mission",
        "pause",
        "fail",
        "config",
        "jump",
    }
    same(files_of(tmp_path)[0], 30)


URL = "http://127.0.0.1:9/v1"


class Thinks:
    """A choice scorer that answers when it is told to."""

    name = "thinks"

    def __init__(self) -> None:
        self.told = threading.Semaphore(0)
        self.answered = 0

    def look(self, view):
        return view

    def answer(self, view):
        self.told.acquire()
        self.answered += 1
        n = len(view.marks)
        p = np.linspace(1.0, 2.0, n, dtype=np.float32) / np.float32(2.0 * n)
        ids = tuple(mark.id for mark in view.marks)
        return Choice(view.observation.stamp_ns, view.target, ids, p, 1.0 - float(p.sum()), 0.7)

    def close(self):
        self.told.release()


def test_what_works_beside_the_loop_comes_when_it_came(tmp_path, monkeypatch):
    """On threads: a scorer, the survey for the planner, the cut into rooms."""
    config = small(
        loop={"lockstep": False},
        policy={"kind": "directional"},
        perception={"prior": "rooms", "choice": {"kind": "openai", "url": URL, "model": "m"}},
        mission={"instruction": "F bed & F sofa", "translator": {"kind": "ltl"},
                 "planner": {"kind": "vitl", "weights": "distance"}},
    )  # fmt: skip
    thinks = Thinks()
    monkeypatch.setattr(
        "edge.eval.closed_loop.make_scorers",
        lambda config, targets: Scorers(None, thinks, feeds=config.value_source),
    )
    recording = Recording(tmp_path, config, pending_mb=500.0)
    for k in range(40):
        recording.steps(1)
        if k % 7 == 3:
            thinks.told.release()
            eventually(lambda k=k: thinks.answered > k // 7)
    workers = [
        entry.fields["worker"]
        for moment in Session(recording.close()).moments()
        for entry in moment.page.entries
        if entry.kind == "found"
    ]
    assert workers.count("choice") >= 2
    assert {"detector", "surveyor", "prior", "choice"} <= set(workers)
    same(files_of(tmp_path)[0], 40)
