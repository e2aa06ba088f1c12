"""Which episodes are planned, and what becomes of one whose process fails."""

from __future__ import annotations

import json
import os
import re
import threading

import pytest
from simulated import simulated

from edge.errors import Stopped, UserError
from edge.eval import episodes
from edge.eval.episodes import Episode

HOUSE = simulated()


def test_no_targets_give_no_episodes():
    assert episodes.plan_episodes(HOUSE, [], 4, 0, 3.0) == []


def test_episodes_are_seeded_free_and_far():
    planned = episodes.plan_episodes(HOUSE, ["television", "bed"], 2, 0, 2.0)
    assert [e.target for e in planned] == ["television"] * 2 + ["bed"] * 2
    assert all(e.shortest_m >= 2.0 for e in planned)
    assert planned == episodes.plan_episodes(HOUSE, ["television", "bed"], 2, 0, 2.0)
    assert planned != episodes.plan_episodes(HOUSE, ["television", "bed"], 2, 1, 2.0)


def test_too_few_starts_are_told():
    with pytest.raises(UserError, match="only 0 of 1 starts lie 500 m"):
        episodes.plan_episodes(HOUSE, ["bed"], 1, 0, 500.0)


def blocked(tmp_path, **sim):
    """A house whose own start lies in a sofa."""
    corners = [(0, 0), (8, 0), (8, 6), (0, 6)]
    walls = [
        {"start": a, "end": b} for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    objects = [{"category": "sofa", "at": [1, 3]}, {"category": "bed", "at": [7, 3]}]
    house = {"name": "blocked", "start": [1, 3, 0], "walls": walls, "objects": objects}
    house["rooms"] = [{"name": "hall", "rect": [0, 0, 8, 6]}]
    path = tmp_path / "blocked.json"
    path.write_text(json.dumps(house))
    world = {"kind": "house", "house": str(path)}
    return simulated({"sim": {"world": world, **sim}})


def test_a_blocked_start_is_told_and_another_takes_its_place(tmp_path):
    with pytest.raises(UserError, match=r"around the start \(1\.00, 3\.00\): .* in sim\.start$"):
        episodes.plan_episodes(blocked(tmp_path), ["bed"], 1, 0, 2.0)
    planned = episodes.plan_episodes(blocked(tmp_path, start=[4, 3, 0]), ["bed"], 1, 0, 2.0)
    assert [e.target for e in planned] == ["bed"]


def test_planning_says_how_far_it_is(monkeypatch, capsys):
    monkeypatch.setattr("edge.host.bars.LOG_PERIOD_S", 0.0)
    episodes.plan_episodes(HOUSE, ["bed", "sofa"], 1, 0, 2.0)
    assert re.search(r"targets: .* 1/2 ", capsys.readouterr().err)


def test_a_process_that_fails_fails_its_episode():
    planned = [Episode("bed", (0.0, 0.0, 0.0), 3.0)]
    stop = threading.Event()
    (outcome,) = episodes._run_all("nowhere.yaml", planned, 1, None, stop)
    assert not outcome.success
    assert outcome.reason.startswith(f"crashed ({os.EX_CONFIG}): nowhere.yaml: no such file")


def test_an_episode_that_is_stopped_before_it_begins_has_no_outcome():
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        episodes.run_episode(HOUSE, Episode("bed", (0.0, 0.0, 0.0), 3.0), None, stop)


def test_nothing_begins_after_a_stop():
    stop = threading.Event()
    stop.set()
    assert list(episodes._run_all("demo", [Episode("bed", (0, 0, 0), 3.0)], 1, None, stop)) == []
