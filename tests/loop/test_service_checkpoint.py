"""A mission goes on after a restart: checkpoint, new service, same robot."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import pytest
from simulated import simulated
from test_map_checkpoint import Run

from edge.host.checkpoint import load, save
from edge.loop.checkpoints.checkpoint import ServiceCheckpoint
from edge.loop.result import mission_facts
from edge.loop.status import mission_json
from edge.mission.checkpoint import MISSION
from edge.mission.spec import prepare
from edge.text import MAX_CHARS


def run_of(path: Path, instruction: str, kind: str = "ltl") -> Run:
    mission = {"instruction": instruction, "translator": {"kind": kind}}
    lockstep = {"lockstep": True}
    return Run(path, simulated({"loop": lockstep, "sim": lockstep, "mission": mission}))


def television_given_up(path: Path) -> Run:
    """Return a restarted run whose television was seen and abandoned; its bed was not seen."""
    run = run_of(path, "F (television | bed)")
    while "television" not in run.service.mission.sets.detected:
        run.step()
    run.service.mission.abandon_target("no way to it", run.drive.motion.stamp_ns)
    return run.ticks(1).killed()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "mission.json"


def test_the_chosen_reading_is_saved(path):
    run = run_of(path, "the sofa must be visited before the bed", "grammar").ticks(1)
    before = run.service.mission.spec
    again = run.killed().service.mission.spec
    assert before.translation.implied
    assert again.warnings == before.warnings != ()
    assert again.translation.readings == before.translation.readings
    mission = mission_json(mission_facts(run.service.mission))
    assert (mission["reading"], mission["readings"]) == (1, list(before.translation.readings))
    run.service.checkpoint.close()


def test_a_mission_resumes_with_its_state_and_objects(path):
    run = run_of(path, "F (sofa & F television)")
    run.service.mission.id = "1f.2"
    while not run.service.mission.sets.reached:
        run.step()
    old = run.service
    mission = run.killed().service.mission
    assert mission.progress.trace == old.mission.progress.trace == ("sofa",)
    assert mission.id == "1f.2"
    assert mission.spec.automaton.formula == old.mission.spec.automaton.formula
    run.step()
    assert {i.id for i in old.map.tracker.all} <= {i.id for i in run.service.map.tracker.all}
    assert mission.target == "television"
    run.run(200)
    run.service.checkpoint.close()
    assert run.service.status.phase == "reached", run.notes.events
    assert run.distance_m("television") <= 1.0


def test_a_patrol_resumes_its_round_and_its_wait(path):
    run = run_of(path, 'G F "wait 3 s" & G F "check surfboard"')
    mission = run.service.mission
    mission.progress.round, mission.results = 4, ("no, there is no surfboard",)
    while mission.pursued_now_s < 2.0:
        run.step()
    again = run.killed().service.mission
    assert (again.progress.round, again.results) == (4, mission.results)
    assert str(again.spec.translation.repeat) == "until told"
    assert again.destinations == mission.destinations
    assert again.pursued_now_s == pytest.approx(2.0, abs=0.2)
    run.ticks(2)
    assert run.service.status.reason == "round 4; waiting, 1 s left"
    run.service.checkpoint.close()


def test_checkpoint_text_is_shown_in_one_short_line(path, caplog):
    """A user who can write the checkpoint must not be able to forge log lines."""
    said = "go on\n12:00 error   service: \x1b[31mon fire\u202e" + "!" * 5000
    run = run_of(path, "F bed").ticks(1)
    run.service.checkpoint.close()
    saved, _ = load(path, MISSION)
    said_all = {"instruction": said, "english": said, "backend": said[:900], "reason": said}
    save(path, replace(saved, state=replace(saved.state, **said_all)), MISSION)
    with caplog.at_level(logging.INFO):
        run.service = run.another()
        ServiceCheckpoint(run.config, path, "another").close()
    run.step()
    run.service.checkpoint.close()
    logged = [record.getMessage() for record in caplog.records if "go on" in record.getMessage()]
    assert len(logged) >= 2
    assert load(path, MISSION)[0].state.instruction == said  # which is how it is known again
    service = run.service
    shown = [
        service.status.instruction,
        *mission_json(mission_facts(service.mission)).values(),
        *run.notes.events,
    ]
    for text in map(str, [*logged, *shown]):
        assert text.isprintable()
        assert len(text) < 1500
    assert len(service.status.instruction) == MAX_CHARS


def test_a_restart_that_saw_nothing_loses_no_object(path):
    run = television_given_up(path)
    places = path.with_name("mission.json.map")
    before = places.read_bytes()
    run.service.idle(run.drive.motion.stamp_ns, None)
    run.killed()
    assert places.read_bytes() == before
    run.ticks(1).service.checkpoint.close()
    assert run.service.map.tracker.of("television")
    assert run.service.mission.sets.failed == {"television"}


def test_objects_are_restored_if_a_mission_comes_first(path):
    run = run_of(path, "F television & F bed")
    while "television" not in run.service.mission.sets.detected:
        run.step()
    before = run.service.map.tracker.all
    run.killed().service.idle(run.drive.motion.stamp_ns, None)
    spec = prepare(run.config.mission, formula="F television")
    run.service.begin(spec, run.drive.motion.stamp_ns)
    run.ticks(1).service.checkpoint.close()
    hits = {i.id: i.hits for i in run.service.map.tracker.all}
    assert before
    assert all(hits.get(i.id, 0) >= i.hits for i in before)


def test_a_failed_target_needs_a_new_instance_after_a_restart(path):
    run = television_given_up(path).ticks(3)
    run.service.checkpoint.close()
    assert run.service.map.tracker.of("television")
    assert run.service.mission.sets.failed == {"television"}
    assert run.service.mission.target == "bed"


def test_an_ended_mission_is_not_resumed(path):
    run = run_of(path, "F bed").ticks(1)
    run.service.mission.finish("failed", "cancelled", run.drive.motion.stamp_ns)
    checkpoint = run.ticks(1).killed().service.checkpoint
    assert checkpoint.saved is None
    checkpoint.close()
