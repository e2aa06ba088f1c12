"""The dispatcher's patience with robots that are gone, or give no account."""

from __future__ import annotations

import pytest

from edge.fleet.dispatch import Dispatcher, Plan
from edge.fleet.orders import Part
from edge.fleet.roster import Account, Body, Robot

PATIENCE_S = 10.0
BODY = Body((0.0, 0.0, 0.0), "answers", (), {})
FREE = Robot("b", Account("", "words", "idle", "", "x", 0.0, (), BODY))
AT_IT = Robot("a", Account("m.1", "words", "searching", "", "x", 0.0, (), BODY))
MUTE = Robot("a", problem="no answer within 2 s")


class Seen:
    """A roster that sees what it is told to; None: the router is gone."""

    robots: dict[str, Robot] | None

    def seen(self):
        return self.robots

    def each(self, calls):
        """Nothing that is asked for arrives."""


@pytest.mark.parametrize("missing", [(FREE,), (FREE, MUTE)])
@pytest.mark.parametrize("between", ["nothing", "it is back", "the router is gone"])
def test_patience_counts_from_the_look_that_first_misses_a_robot(missing, between):
    roster, now_s, told = Seen(), [0.0], []
    part = Part("m.1", "F bed", "Reach the bed.", ("bed",))
    dispatcher = Dispatcher(roster, Plan("m", (part,)), told.append, PATIENCE_S, lambda: now_s[0])

    def given_to(at_s, *robots):
        now_s[0] = at_s
        roster.robots = {robot.name: robot for robot in robots}
        return [give.robot for give in dispatcher.step().give]

    assert given_to(0.0, FREE, AT_IT) == []
    assert given_to(100.0, *missing) == []  # not since it was last seen
    assert given_to(109.9, *missing) == []
    if between == "nothing":
        assert given_to(110.0, *missing) == ["b"]
        return
    if between == "it is back":
        assert given_to(109.9, FREE, AT_IT) == []
    else:
        roster.robots = None
        assert dispatcher.step() is None
    assert given_to(200.0, *missing) == []  # counted anew
    assert given_to(209.9, *missing) == []
    assert given_to(210.0, *missing) == ["b"]
