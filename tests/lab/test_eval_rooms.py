"""Rooms compared with the ground truth."""

from __future__ import annotations

import pytest
from simulated import simulated

from edge.lab.eval import rooms
from edge.lab.eval.rooms import RoomVerdict, report


def verdict(kinds=("kitchen",), share=1.0, also=("kitchen",), best="kitchen", typical=3):
    return RoomVerdict(1, "kitchen", share, frozenset(also), tuple(kinds), best, typical)


def values(text: str) -> list[str]:
    return [line.split()[-5] for line in text.splitlines()[1:]]


def test_nothing_was_measured():
    assert values(report([])) == ["nan"] * 3


@pytest.mark.parametrize(
    ("one", "shares"),
    [
        (verdict(), ["1.000", "1.000", "1.000"]),
        (verdict(("bedroom",), best="bedroom"), ["0.000", "0.000", "0.000"]),
        (verdict((), best="kitchen"), ["0.000", "1.000", "nan"]),
        (verdict(typical=1), ["nan", "nan", "1.000"]),
        (verdict(share=0.4), ["nan", "nan", "nan"]),
        (verdict(("kitchen", "living room")), ["0.000", "1.000", "0.000"]),
        (
            verdict(("kitchen", "living room"), also=("kitchen", "living room")),
            ["1.000", "1.000", "1.000"],
        ),
    ],
)
def test_a_room_kind_is_judged_against_the_truth(one, shares):
    assert values(report([one])) == shares


@pytest.mark.parametrize(("choice", "colour"), [("none", False), ("openai", True)])
def test_a_model_that_looks_at_images_gets_them(monkeypatch, choice, colour):
    asked = []

    class Loop:
        def __init__(self, config, world, colour):
            asked.append(colour)

        def run(self, seconds):
            return self

    monkeypatch.setattr(rooms, "ClosedLoop", Loop)
    options = {"url": "http://127.0.0.1:1/v1", "model": "any"} if choice == "openai" else {}
    rooms.explore(simulated({"perception": {"choice": {"kind": choice, **options}}}), None)
    assert asked == [colour]
