"""A mission for a thing that a relation describes, in the simulated house.

It takes some seconds, since the robot drives through the house.
"""

from __future__ import annotations

from simulated import simulated

from edge.lab.eval.closed_loop import ClosedLoop


def test_the_vase_on_the_cabinet_is_found_and_the_choice_told():
    data = {
        "mission": {"instruction": 'go to the "vase on the cabinet"'},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},
    }
    loop = ClosedLoop(simulated(data), colour=False).run(600)
    assert loop.service.mission.brief.prompts == ("vase", "cabinet")
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.distance_m("vase") <= 1.0
    (taken,) = [text for text in loop.notes.events if "taken" in text]
    assert taken.startswith("vase on the cabinet: vase ")
    assert " m from cabinet " in taken
