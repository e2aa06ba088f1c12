"""The dispatcher's patience with absent, silent and forgetful robots."""

from __future__ import annotations

import dataclasses

import pytest
from fake_robots import LIMITS

from edge.fleet.dispatch import Dispatcher, FleetPlan, plan
from edge.fleet.orders import MAX_TRIES, MissionPart, PartOutcome
from edge.fleet.roster import PastMission, Robot, RobotState, StatusReply
from edge.mission.spec import prepare

PATIENCE_S = 10.0
BODY = RobotState((0.0, 0.0, 0.0), "answers", (), {})
BED = MissionPart("m.1", "F bed", "Reach the bed.", ("bed",))


def robot(name: str, at: str = "", phase: str = "idle", reason: str = "", **known: float) -> Robot:
    body = dataclasses.replace(BODY, known=known)
    return Robot(name, StatusReply(at, "words", phase, reason, "x", 0.0, (), body))


FREE = robot("b")
AT_IT = robot("a", "m.1", "searching")
MUTE = Robot("a", problem="no answer within 2 s")
FAILED = robot("a", "m.1", "failed", "no bed")


class Fleet:
    """A roster with given robots, and a dispatcher that reads it.

    Attributes:
        robots: the present robots; None: the router is gone.
        accepts: True if robots accept their orders.
    """

    def __init__(self, *parts: MissionPart, accepts: bool = False) -> None:
        self.robots: dict[str, Robot] | None = {}
        self.accepts, self.now_s, self.told = accepts, 0.0, []
        clock = lambda: self.now_s  # noqa: E731
        self.dispatcher = Dispatcher(
            self, FleetPlan("m", parts), self.told.append, PATIENCE_S, clock
        )

    def complete_list(self):
        return self.robots

    def run_all(self, calls):
        for call in calls if self.accepts else ():
            call()

    def send(self, name, request, timeout_s):
        return {}

    def look(self, at_s: float, *robots: Robot):
        self.now_s, self.robots = at_s, {robot.name: robot for robot in robots}
        return self.dispatcher.step()

    def given_to(self, at_s: float, *robots: Robot) -> list[str]:
        return [give.robot for give in self.look(at_s, *robots).give]

    def router_is_gone(self) -> None:
        self.robots = None
        assert self.dispatcher.step() is None


@pytest.mark.parametrize("missing", [(FREE,), (FREE, MUTE)])
@pytest.mark.parametrize("between", ["nothing", "it is back", "the router is gone"])
def test_patience_counts_from_the_first_failed_look(missing, between):
    fleet = Fleet(BED)
    assert fleet.given_to(0.0, FREE, AT_IT) == []
    assert fleet.given_to(100.0, *missing) == []  # not since it was last seen
    assert fleet.given_to(109.9, *missing) == []
    if between == "nothing":
        assert fleet.given_to(110.0, *missing) == ["b"]
        return
    if between == "it is back":
        assert fleet.given_to(109.9, FREE, AT_IT) == []
    else:
        fleet.router_is_gone()
    assert fleet.given_to(200.0, *missing) == []  # counted again
    assert fleet.given_to(209.9, *missing) == []
    assert fleet.given_to(210.0, *missing) == ["b"]


@pytest.mark.parametrize(
    ("part", "there", "reason"),
    [
        (BED, (FAILED,), "a: no bed"),
        (dataclasses.replace(BED, only="b"), (robot("a"),), "it is offline"),
        (dataclasses.replace(BED, only="b"), (), "it is offline"),
    ],
)
@pytest.mark.parametrize("between", ["nothing", "it is back", "the router is gone"])
def test_a_part_fails_only_after_the_patience(part, there, reason, between):
    """One look may lack a robot that is there."""
    fleet = Fleet(part)
    over = fleet.dispatcher._is_over
    first = fleet.look(100.0, *there)
    assert (first.outcomes, over(first), first.failed) == ({}, False, False)
    assert any(f"{reason}; the part fails unless another robot" in line for line in fleet.told)
    assert not over(fleet.look(109.9, *there))
    since_s = 100.0
    if between == "it is back":
        assert fleet.given_to(109.9, *there, FREE) == ["b"]
    elif between == "the router is gone":
        fleet.router_is_gone()
    if between != "nothing":
        since_s = 200.0
        assert not over(fleet.look(since_s, *there))
        assert not over(fleet.look(since_s + 9.9, *there))
    last = fleet.look(since_s + 10.0, *there)
    assert over(last)
    assert last.outcomes["m.1"].reason == reason


def test_a_robot_that_forgets_its_part_loses_it_to_another():
    liar, other = robot("liar", bed=0.0), robot("other")
    fleet = Fleet(BED, accepts=True)
    assert fleet.given_to(0.0, liar, other) == ["liar"]
    assert fleet.given_to(1.0, liar, other) == ["other"]
    assert "liar no longer knows its part: Reach the bed." in fleet.told
    assert fleet.look(2.0, liar, robot("other", "m.1", "searching")).under_way == {"m.1": "other"}


@pytest.mark.parametrize(
    "between",
    [
        (),
        (FAILED,),  # it says one, then another
        (AT_IT,),
        (robot("a", "other", "searching"),),
        (MUTE,),
    ],
)
def test_a_forgetful_robot_gets_a_limited_number_of_tries(between):
    """Whatever it reports in between, and even without another robot."""
    fleet = Fleet(BED, accepts=True)
    gives, now_s = 0, 0.0
    for _ in range(3 * MAX_TRIES):
        for there in (robot("a"), *between):
            now_s += 1.0
            orders = fleet.look(now_s, there)
            gives += len(orders.give)
    assert gives == MAX_TRIES
    fleet.look(now_s + 100.0, robot("a"))
    assert fleet.look(now_s + 200.0, robot("a")).outcomes == {
        "m.1": PartOutcome("failed", "a", "a: it lost the part")
    }


def test_a_mission_with_a_running_part_is_resumed():
    spec = prepare(LIMITS, instruction="go to the bed and the sofa")
    first = plan(spec, {}, share=True)
    bed, sofa = (part.id for part in first.parts)
    past = (PastMission(sofa, "failed", "no sofa"),)
    account = dataclasses.replace(robot("a", bed, "searching").status_reply, past=past)
    assert plan(spec, {"a": Robot("a", account)}, share=True) == first
    over = dataclasses.replace(account, phase="reached")
    assert plan(spec, {"a": Robot("a", over)}, share=True).id != first.id
