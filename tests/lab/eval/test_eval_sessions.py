"""Sessions: several goals one after another, with and without memory."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from edge.errors import Stopped, UserError
from edge.lab.eval.arms import make_arms, with_and_without_memory
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.episodes import make_episode, read, sensing_settings, write
from edge.lab.eval.runs import run_all
from edge.lab.eval.sessions import plan_sessions, run_session


@pytest.fixture(scope="module")
def session(config):
    """Return a session: the robot passes the sofa on its way to the bed, and drives back to it."""
    world = config.sim.world.model_dump()
    sensing = sensing_settings(config)
    return make_episode(world, "small", (1.0, 2.0, 0.5), 0.0, sensing, goals=("bed", "sofa"))


@pytest.fixture(scope="module")
def arms(config):
    return with_and_without_memory(make_arms(config, {"search": {"policy": {"kind": "search"}}}))


@pytest.fixture(scope="module")
def outcomes(session, arms):
    return [run_session(arm, session) for arm in arms]


def test_no_world_has_no_session(config):
    with pytest.raises(UserError, match="no world has 3 of the targets, each 2 m or more"):
        plan_sessions(config, [], ["bed", "sofa"], 3, 0, 2.0)


def test_the_goals_of_a_session_are_different_and_apart(config):
    (planned,) = plan_sessions(config, [], ["bed", "sofa", "unicorn"], 2, 0, 1.0)
    assert sorted(planned.goals) == ["bed", "sofa"]
    assert [planned] == plan_sessions(config, [], ["bed", "sofa", "unicorn"], 2, 0, 1.0)
    assert planned.parts == (f"{planned.id}/1", f"{planned.id}/2")


def test_a_session_is_written_and_read(session, tmp_path):
    write(tmp_path / "e.jsonl", [session])
    assert read(tmp_path / "e.jsonl") == [session]


def test_each_goal_starts_at_the_end_of_the_last(outcomes):
    for first, second in outcomes:
        assert (first.target, first.goal, second.target, second.goal) == ("bed", 1, "sofa", 2)
        assert first.success, first.reason
        assert second.success, second.reason
        assert second.start[:2] == pytest.approx(first.trail[-1], abs=0.3)
        assert second.trail[0] == pytest.approx(second.start[:2], abs=1e-3)
        assert 0.0 < second.shortest_m <= second.path_m


def test_memory_helps_only_the_second_goal(outcomes):
    (first, _), (known_first, known_second) = outcomes
    assert first.trail == known_first.trail
    assert (first.arm, known_first.arm) == ("search, no memory", "search")
    assert known_second.first_sight_path_m is not None
    assert known_second.path_m < 1.2 * known_second.shortest_m
    assert {kind for *_, kind in known_second.goal_xy} == {"instance"}  # it knows where the sofa is


def test_a_goal_may_be_a_room(config, session, arms):
    (planned,) = plan_sessions(config, [], ["bed", "living room", "kitchen"], 2, 0, 1.0)
    assert sorted(planned.goals) == ["bed", "living room"]
    _, room = run_session(arms[1], replace(session, goals=("bed", "living room")))
    assert (room.success, room.target, room.distance_m) == (True, "living room", 0.0), room.reason
    assert 1.0 < room.shortest_m <= room.path_m


def test_a_comparison_leaves_the_first_goal_out(outcomes):
    found = gather(outcome for arm in outcomes for outcome in arm)
    assert found.arms == ("search, no memory", "search")
    assert found.target.tolist() == ["sofa"]
    assert found["shortest_m"][:, 0].tolist() == [
        pytest.approx(arm[1].shortest_m, abs=1e-3) for arm in outcomes
    ]


def test_an_error_fails_the_goals_that_are_left(session, arms, monkeypatch):
    monkeypatch.setattr("edge.lab.eval.sessions.prepare_mission", lambda *_: 1 / 0)
    first, second = run_session(arms[0], session)
    assert (first.success, second.failure, second.target, second.goal) == (
        True, "crashed", "sofa", 2,
    )  # fmt: skip
    assert "ZeroDivisionError" in second.reason


def test_a_stop_ends_a_session(session, arms):
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        run_session(arms[0], session, stop)


def test_a_finished_session_is_not_run_again(session, arms, outcomes, tmp_path, monkeypatch):
    ran = iter(outcomes)
    monkeypatch.setattr("edge.lab.eval.workers.run_session", lambda *_: next(ran))
    reported = []
    first = run_all(arms, [session], tmp_path, on_outcome=lambda *news: reported.append(news[:2]))
    assert reported == [(1, 4), (2, 4), (3, 4), (4, 4)]
    again = run_all(arms, [session], tmp_path)
    assert [outcome.key for outcome in first] == [outcome.key for outcome in again]
