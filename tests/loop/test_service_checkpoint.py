"""A mission goes on after a restart: checkpoint, new service, same robot."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import pytest
from simulated import simulated

from edge.config import Config
from edge.host.checkpoint import load, save
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.checkpoint import ServiceCheckpoint
from edge.loop.result import facts_of
from edge.loop.service import Service
from edge.loop.status import mission_of
from edge.mission.brief import prepare
from edge.mission.checkpoint import MISSION
from edge.perception.factory import make_detector
from edge.perception.worker import DetectorWorker
from edge.policies import make_policy
from edge.text import MAX_CHARS


def config(formula: str) -> Config:
    mission = {"instruction": formula, "translator": {"kind": "ltl"}}
    return simulated({"loop": {"lockstep": True}, "sim": {"lockstep": True}, "mission": mission})


def restart(loop: ClosedLoop, path: Path) -> ServiceCheckpoint:
    """Put a service that reads the checkpoint in the place of the present one."""
    checkpoint = ServiceCheckpoint(loop.config, path, None)
    brief = checkpoint.brief() or loop.service.mission.brief
    detector = make_detector(loop.config.perception, brief.targets, truth=loop.truth)
    worker = DetectorWorker(detector, inline=True)
    policy = make_policy(loop.config.policy)
    loop.service = Service(loop.config, brief, worker, policy, [loop.notes], checkpoint)
    return checkpoint


def television_given_up(path: Path) -> ClosedLoop:
    """A checkpoint of a mission whose television was seen and given up; its bed was not seen."""
    loop = ClosedLoop(config("F (television | bed)"), colour=False)
    checkpoint = restart(loop, path)
    while "television" not in loop.service.mission.detected:
        loop.step()
    loop.service.mission.give_up("no way to it", loop.drive.motion.stamp_ns)
    loop.step()
    checkpoint.close()
    return loop


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "mission.json"


def test_with_no_checkpoint_there_is_nothing_to_go_on_with(path):
    checkpoint = ServiceCheckpoint(config("F bed"), path, None)
    assert (checkpoint.saved, checkpoint.brief(), checkpoint.problem) == (None, None, "")
    checkpoint.close()


def test_which_reading_was_taken_is_kept(path):
    loop = ClosedLoop(
        simulated(
            {
                "loop": {"lockstep": True},
                "sim": {"lockstep": True},
                "mission": {"instruction": "the sofa must be visited before the bed"},
            }
        ),
        colour=False,
    )
    first = restart(loop, path)
    loop.step()
    first.close()
    before, saved = loop.service.mission.brief, ServiceCheckpoint(loop.config, path, None)
    again = saved.brief()
    saved.close()
    assert before.translation.implied
    assert again.warnings == before.warnings != ()
    assert again.translation.readings == before.translation.readings
    mission = mission_of(facts_of(loop.service.mission))
    assert (mission["reading"], mission["readings"]) == (1, list(before.translation.readings))


def test_a_mission_goes_on_from_its_state_and_what_it_had_seen(path):
    loop = ClosedLoop(config("F (sofa & F television)"), colour=False)
    first = restart(loop, path)
    loop.service.mission.id = "1f.2"
    while not loop.service.mission.reached:
        loop.step()
    first.close()
    old = loop.service
    second = restart(loop, path)
    assert loop.service.mission.word == old.mission.word == ("sofa",)
    assert loop.service.mission.id == "1f.2"
    assert loop.service.mission.brief.automaton.formula == old.mission.brief.automaton.formula
    loop.step()
    assert {i.id for i in old.map.tracker.all} <= {i.id for i in loop.service.map.tracker.all}
    assert loop.service.mission.target == "television"
    loop.run(200)
    second.close()
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.distance_m("television") <= 1.0


def test_what_a_checkpoint_says_is_shown_in_one_short_line(path, caplog):
    """A checkpoint is a file: whoever may write it must not write the log."""
    said = "go on\n12:00 error   service: \x1b[31mon fire\u202e" + "!" * 5000
    loop = ClosedLoop(config("F bed"), colour=False)
    first = restart(loop, path)
    loop.step()
    first.close()
    saved, _ = load(path, MISSION)
    said_all = {"instruction": said, "english": said, "backend": said[:900], "reason": said}
    save(path, replace(saved, state=replace(saved.state, **said_all)), MISSION)
    with caplog.at_level(logging.INFO):
        second = restart(loop, path)
        second.resume(loop.service.mission)
        ServiceCheckpoint(loop.config, path, "another").close()
    loop.step()
    second.close()
    told = [record.getMessage() for record in caplog.records if "go on" in record.getMessage()]
    assert len(told) >= 2
    assert load(path, MISSION)[0].state.instruction == said  # which is how it is known again
    service = loop.service
    shown = [
        service.status.instruction,
        *mission_of(facts_of(service.mission)).values(),
        *loop.notes.events,
    ]
    for text in map(str, [*told, *shown]):
        assert text.isprintable()
        assert len(text) < 1500
    assert len(service.status.instruction) == MAX_CHARS


def test_a_restart_that_saw_nothing_loses_no_place(path):
    loop = television_given_up(path)
    places = path.with_name("mission.json.map")
    before = places.read_bytes()
    blind = restart(loop, path)
    loop.service.idle(loop.drive.motion.stamp_ns, None)
    blind.close()
    assert places.read_bytes() == before
    third = restart(loop, path)
    loop.step()
    third.close()
    assert loop.service.map.tracker.of("television")
    assert loop.service.mission.failed == {"television"}


def test_places_come_back_under_an_order_that_came_before_the_first_image(path):
    loop = ClosedLoop(config("F television & F bed"), colour=False)
    first = restart(loop, path)
    while "television" not in loop.service.mission.detected:
        loop.step()
    first.close()
    before = loop.service.map.tracker.all
    second = restart(loop, path)
    loop.service.idle(loop.drive.motion.stamp_ns, None)
    brief = prepare(loop.config.mission, formula="F television")
    loop.service.begin(brief, loop.drive.motion.stamp_ns)
    loop.step()
    second.close()
    hits = {i.id: i.hits for i in loop.service.map.tracker.all}
    assert before
    assert all(hits.get(i.id, 0) >= i.hits for i in before)


def test_what_had_failed_is_not_taken_up_again_for_the_same_instance(path):
    loop = television_given_up(path)
    second = restart(loop, path)
    for _ in range(3):
        loop.step()
    second.close()
    assert loop.service.map.tracker.of("television")
    assert loop.service.mission.failed == {"television"}
    assert loop.service.mission.target == "bed"


def test_an_ended_mission_is_not_taken_up_again(path):
    loop = ClosedLoop(config("F bed"), colour=False)
    first = restart(loop, path)
    loop.step()
    loop.service.mission.fail("cancelled", loop.drive.motion.stamp_ns)
    loop.step()
    first.close()
    second = restart(loop, path)
    assert second.saved is None
    second.close()
