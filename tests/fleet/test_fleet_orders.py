"""Assignment of mission parts to robots, from the robots' own reports."""

from __future__ import annotations

import pytest

from edge.fleet.orders import DUPLICATE_REASON, Cancellation, MissionPart, PartOutcome, decide
from edge.fleet.roster import PastMission, Robot, RobotState, StatusReply

BED = MissionPart("m.1", "F bed", "Reach the bed.", ("bed",))
SOFA = MissionPart("m.2", "F sofa", "Reach the sofa.", ("sofa",))


def robot(
    name: str,
    at: str = "",
    phase: str = "idle",
    past: tuple[tuple[str, str, str], ...] = (),
    reason: str = "",
    problems: tuple[str, ...] = (),
    controller: str = "answers",
    elapsed_s: float = 0.0,
    **known_m: float,
) -> Robot:
    body = RobotState((0.0, 0.0, 0.0), controller, problems, known_m)
    outcomes = tuple(PastMission(*entry) for entry in past)
    return Robot(name, StatusReply(at, "words", phase, reason, "x", elapsed_s, outcomes, body))


def orders(parts, *robots: Robot, away=None, refused=None):
    return decide(parts, {r.name: r for r in robots}, away or {}, refused or {})


def given(*args, **options) -> dict[str, str]:
    return {give.id: give.robot for give in orders(*args, **options).give}


def test_without_robots_or_parts_no_orders_are_given():
    none = orders([])
    assert (none.outcomes, none.under_way, none.give, none.cancel) == ({}, {}, (), ())
    alone = orders([BED])
    assert (alone.outcomes, alone.give, alone.failed) == ({}, (), False)


@pytest.mark.parametrize(
    ("robots", "expected"),
    [
        # One part a robot; ties go by the order of parts and names.
        ([robot("b"), robot("a")], {"m.1": "a", "m.2": "b"}),
        # The robot that knows the object and is nearer.
        ([robot("a"), robot("b", bed=9.0)], {"m.1": "b", "m.2": "a"}),
        # A busy robot gets nothing.
        ([robot("a", "other", "searching"), robot("b")], {"m.1": "b"}),
        ([robot("a", "", "paused"), robot("b", "other", "reached")], {"m.1": "b"}),
        ([robot("a", problems=("no usable observations",))], {}),
        ([Robot("a", problem="no answer within 2 s")], {}),
        # A robot does not get a failed part again; a duplicate may, under another name.
        ([robot("a", past=(("m.1", "failed", "no bed"),)), robot("b")], {"m.2": "a", "m.1": "b"}),
        ([robot("a", "m.1", "failed", reason=DUPLICATE_REASON)], {"m.1~1": "a"}),
        ([robot("a", "m.1", "reached"), robot("b", "m.2~1", "paused")], {}),
        ([robot("a", past=(("m.1", "reached", ""),)), robot("b")], {"m.2": "a"}),
    ],
)  # fmt: skip
def test_parts_go_to_the_free_robot_that_suits_best(robots, expected):
    assert given([BED, SOFA], *robots) == expected


def test_a_part_for_one_robot_goes_to_no_other_robot():
    mine = MissionPart("m.1", "F bed", "", ("bed",), only="b")
    assert given([mine], robot("a", bed=1.0), robot("b")) == {"m.1": "b"}
    assert given([mine], robot("a"), robot("b", "x", "searching")) == {}
    gone = orders([mine], robot("a"))
    assert gone.outcomes == {"m.1": PartOutcome("failed", "b", "it is offline")}
    assert orders([mine], robot("a"), away={"m.1": "b"}).under_way == {"m.1": "b"}


def test_an_absent_robot_keeps_its_part_for_a_while():
    assert given([BED], robot("b"), away={"m.1": "a"}) == {}
    assert given([BED], robot("b")) == {"m.1": "b"}


def test_a_cancelled_part_is_not_given_to_another_robot():
    end = orders([BED, SOFA], robot("a", "m.1", "failed", reason="cancelled"), robot("b"))
    assert end.outcomes == {"m.1": PartOutcome("failed", "a", "cancelled")}
    assert end.give == ()


def test_a_settled_part_keeps_its_outcome():
    stopped = {"m.1": PartOutcome("failed", "a", "cancelled")}
    end = decide([BED, SOFA], {"b": robot("b")}, {}, {}, stopped)
    assert (end.outcomes, end.give) == (stopped, ())
    done = {"m.1": PartOutcome("reached", "a", "seen")}
    on = decide([BED, SOFA], {"b": robot("b", "m.1", "searching"), "c": robot("c")}, {}, {}, done)
    assert (on.outcomes, on.cancel) == (done, (Cancellation("b", "m.1"),))
    assert [(give.id, give.robot) for give in on.give] == [("m.2", "c")]


def test_a_robot_that_refused_is_asked_last():
    assert given([BED], robot("a"), robot("b"), refused={("m.1", "a"): 1}) == {"m.1": "b"}
