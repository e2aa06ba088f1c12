"""Objects of earlier missions are known to the next mission."""

from __future__ import annotations

import pytest
from simulated import simulated

from edge.bus.verbs import Request
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.requests.handlers import handle_mission
from edge.mission.spec import prepare
from edge.perception.factory import make_detector


@pytest.fixture(scope="module")
def found_a_bed():
    """Return a robot that has found the bed and passed the sofa."""
    small = {"camera": {"width_px": 160, "height_px": 128}}
    data = {"mission": {"target": "bed"}, "sensors": small}
    return ClosedLoop(simulated(data), colour=False).run(200)


def begin(loop: ClosedLoop, formula: str) -> None:
    spec = prepare(loop.config.mission, formula=formula)
    handle_mission(loop.service, Request("new", prepared=spec), loop.drive.motion.stamp_ns)


def test_an_object_seen_as_context_becomes_a_target_at_once(found_a_bed):
    loop = found_a_bed
    assert loop.service.status.phase == "reached"
    assert loop.service.map.tracker.of("sofa") == []
    seen = loop.service.map.objects.read_only
    assert (seen.confidence[seen.of("sofa")] > loop.config.perception.tau_det).sum() >= 1
    begin(loop, "F sofa")
    (sofa,) = loop.service.map.tracker.of("sofa")
    assert sofa.state == "confirmed"
    # The model that is put in the other's place in between may give other context words.
    few = loop.config.perception.model_copy(
        update={"detector": loop.config.perception.detector.model_copy(update={"background": ()})}
    )
    loop.service.perception.worker.exchange(make_detector(few, ("sofa",), truth=loop.truth))
    before = len(loop.notes.goals)
    driven_m = loop.drive.motion.path_m
    loop.run(300)
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.distance_m("sofa") <= 1.0
    assert {goal.kind for goal in loop.notes.goals[before:]} == {"instance"}
    assert loop.drive.motion.path_m - driven_m < 12.0


def test_policies_read_detected_objects_but_cannot_write_them(found_a_bed):
    seen = found_a_bed.service.map.objects.read_only
    assert {"bed", "sofa", "carpet"} <= {seen.words[w] for w in seen.word[: seen.n]}
    with pytest.raises(ValueError, match="read-only"):
        seen.confidence[0] = 1.0
