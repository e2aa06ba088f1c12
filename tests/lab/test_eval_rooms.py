"""Rooms compared with the ground truth."""

from __future__ import annotations

import pytest

from edge.lab.eval.rooms import RoomGoalOutcome, RoomVerdict, report


def verdict(kinds=("kitchen",), share=1.0, also=("kitchen",), best="kitchen", typical=3):
    return RoomVerdict(1, "kitchen", share, frozenset(also), tuple(kinds), best, typical)


def values(text: str) -> list[str]:
    return [line.split()[-5] for line in text.splitlines()[1:]]


def test_nothing_was_measured():
    assert values(report([], [])) == ["nan"] * 4


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
    assert values(report([one], []))[:3] == shares


def test_drives_count_by_their_success():
    outcomes = [RoomGoalOutcome("flat", "kitchen", "reached", ok, 1.0, "") for ok in (True, False)]
    assert values(report([], outcomes))[3] == "0.500"
