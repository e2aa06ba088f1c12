"""Assignment of mission parts to robots, from the status that the robots report.

Robots report the id of a part during and after the part, so the decision needs no memory here.
Every dispatcher comes to the same orders, also after a restart or next to another dispatcher.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

from edge import names
from edge.bus.verbs import CANCELLED
from edge.fleet.roster import OVER, Robot, StatusReply
from edge.text import one_line

DUPLICATE_REASON = "another robot is working on it"
"""Reason for the cancellation of a part that two robots had.

It is not a failure: the robot may get the part again.
"""
AGAIN = "~"
"""Separates the id of a part from the number of times that its robot had the part before."""
MAX_TRIES = 3
"""A robot that refused or forgot a part this many times does not get it again.

A robot forgot a part if it had the part and no longer reports it.
"""


@dataclass(frozen=True)
class MissionPart:
    """A part of a mission, for one robot.

    Attributes:
        formula: LTL formula of the robot's mission.
        words: Names of the targets that the robot may have to reach, such as "chair".
        only: Name of the robot that must do the part; None if any robot may do it.
    """

    id: str
    formula: str
    english: str
    words: tuple[str, ...]
    only: str | None = None


@dataclass(frozen=True)
class PartOutcome:
    """Result of a part.

    Attributes:
        phase: `reached` or `failed`.
        by: Name of the robot, or names of the robots, that caused the result.
    """

    phase: Literal["reached", "failed"]
    by: str
    reason: str


class Assignment(NamedTuple):
    """An order to give a part to a robot.

    Attributes:
        id: Id of the mission on the robot: that of the part; `~N` follows if the robot had the part
            N times before, and another robot was working on it.
        why: Reason why this robot gets the part.
    """

    part: MissionPart
    robot: str
    id: str
    why: str


class Cancellation(NamedTuple):
    """An order to cancel a robot's mission."""

    robot: str
    id: str


@dataclass(frozen=True)
class Orders:
    """Orders for the robots, with the state of the mission.

    Attributes:
        outcomes: Results of the finished parts, by part id.
        under_way: Robot that works on each running part, by part id.
        give: Parts to give to robots now.
        cancel: Missions to cancel now.
        waits: Reason why each busy robot cannot take a waiting part; empty if no part waits.
        lost: Ids of the parts in `outcomes` that no online robot can do. These outcomes are not
            final: a robot that comes online may still do the part.
    """

    outcomes: Mapping[str, PartOutcome]
    under_way: Mapping[str, str]
    give: tuple[Assignment, ...]
    cancel: tuple[Cancellation, ...]
    waits: Mapping[str, str]
    lost: frozenset[str] = frozenset()

    @property
    def failed(self) -> bool:
        """True if a part failed. The mission then fails too, and no more parts are given."""
        return any(outcome.phase == "failed" for outcome in self.outcomes.values())


class _PartOnRobot(NamedTuple):
    """State of a part, as one robot reports it; for the fields see `StatusReply`."""

    robot: str
    id: str
    phase: str
    reason: str
    elapsed_s: float


def decide(
    parts: Sequence[MissionPart],
    robots: Mapping[str, Robot],
    away: Mapping[str, str],
    refused: Mapping[tuple[str, str], int] = MappingProxyType({}),
    settled: Mapping[str, PartOutcome] = MappingProxyType({}),
    forgot: Mapping[tuple[str, str], int] = MappingProxyType({}),
) -> Orders:
    """Return the orders for a mission.

    Args:
        parts: Parts of the mission.
        robots: Online robots, by name.
        away: By part id, the offline robot that last worked on the part and may still come back.
        refused: Number of refusals, by part id and robot.
        settled: Earlier outcomes, by part id. They are final.
        forgot: Number of times that the robot forgot the part, by part id and robot.
    """
    tries = Counter(refused) + Counter(forgot)
    lost: set[str] = set()
    outcomes: dict[str, PartOutcome] = {}
    under_way: dict[str, str] = {}
    cancel: list[Cancellation] = []
    waiting: dict[str, list[str]] = {}  # part id: robots that may get the part
    for part in parts:
        reports = list(_reports_of(part, robots))
        # The robot that works on the part for the longest time keeps it.
        running = sorted(
            (report for report in reports if report.phase not in OVER),
            key=lambda report: -report.elapsed_s,
        )
        reached_reports = [report for report in reports if report.phase == "reached"]
        # Robot: reason of its failure.
        failed = {
            report.robot: report.reason
            for report in reports
            if report.phase == "failed" and report.reason != DUPLICATE_REASON
        }
        outcome = settled.get(part.id)
        if outcome is None and reached_reports:
            outcome = PartOutcome("reached", reached_reports[0].robot, reached_reports[0].reason)
        reached = outcome is not None and outcome.phase == "reached"
        cancel += [
            Cancellation(report.robot, report.id)
            for report in (running if reached else running[1:])
        ]
        if outcome is not None:
            outcomes[part.id] = outcome
        elif running:
            under_way[part.id] = running[0].robot
        elif part.id in away:
            under_way[part.id] = away[part.id]
        elif (outcome := _final_failure(part, failed)) is not None:
            outcomes[part.id] = outcome
        elif (outcome := _provisional_failure(part, robots, failed, tries, forgot)) is not None:
            outcomes[part.id] = outcome
            lost.add(part.id)
        else:
            waiting[part.id] = [
                name for name in _allowed_robots(part, robots, tries) if name not in failed
            ]
    orders = Orders(outcomes, under_way, (), tuple(cancel), {}, frozenset(lost))
    if orders.failed or not waiting:
        return orders
    open_parts = [part for part in parts if part.id in waiting]
    give = tuple(_assign(open_parts, waiting, robots, tries))
    busy = {name: robot.busy_with for name, robot in robots.items() if robot.busy_with}
    waits = busy if len(give) < len(open_parts) else {}
    return replace(orders, give=give, waits=waits)


def has_part(part: MissionPart, robot: Robot) -> bool:
    """Return True if a robot reports this part, running or finished."""
    return next(_reports_of(part, {robot.name: robot}), None) is not None


def _reports_of(part: MissionPart, robots: Mapping[str, Robot]) -> Iterator[_PartOnRobot]:
    """Yield what the robots report about a part, by name; of one robot the oldest report first."""
    for name, robot in sorted(robots.items()):
        if (reply := robot.status_reply) is None:
            continue
        for past in reply.past:
            if past.id.partition(AGAIN)[0] == part.id:
                yield _PartOnRobot(name, past.id, past.phase, past.reason, 0.0)
        if reply.id.partition(AGAIN)[0] == part.id:
            yield _PartOnRobot(name, reply.id, reply.phase, reply.reason, reply.elapsed_s)


def _allowed_robots(
    part: MissionPart, robots: Mapping[str, Robot], tries: Mapping[tuple[str, str], int]
) -> list[str]:
    """Return the online robots that may get a part: not those that refused or forgot it often."""
    allowed = [part.only] if part.only is not None else sorted(robots)
    return [
        name for name in allowed if name in robots and tries.get((part.id, name), 0) < MAX_TRIES
    ]


def _final_failure(part: MissionPart, failed: Mapping[str, str]) -> PartOutcome | None:
    """Return a failure that no other robot can repair, or None.

    `failed` has the reason of each robot that failed the part, by name.
    """
    for name, reason in failed.items():
        # A person cancelled the part, or no other robot may do it.
        if reason == CANCELLED or name == part.only:
            return PartOutcome("failed", name, reason)
    return None


def _provisional_failure(
    part: MissionPart,
    robots: Mapping[str, Robot],
    failed: Mapping[str, str],
    tries: Mapping[tuple[str, str], int],
    forgot: Mapping[tuple[str, str], int],
) -> PartOutcome | None:
    """Return why no online robot can do a part; None if a robot may do it.

    For the arguments see `decide` and `_final_failure`.
    """
    if part.only is not None and part.only not in robots:
        return PartOutcome("failed", part.only, "it is offline")
    tried = {name for id, name in tries if id == part.id}  # robots that refused or forgot it
    if not tried and not failed:
        return None
    if any(name not in failed for name in _allowed_robots(part, robots, tries)):
        return None
    why = {n: "it lost the part" if (part.id, n) in forgot else "it refused" for n in tried}
    why = dict(sorted((why | failed).items()))  # the reason of a failure replaces that of a try
    return PartOutcome("failed", ", ".join(why), "; ".join(f"{n}: {w}" for n, w in why.items()))


def _assign(
    parts: Sequence[MissionPart],
    candidates: Mapping[str, Sequence[str]],
    robots: Mapping[str, Robot],
    tries: Mapping[tuple[str, str], int],
) -> Iterator[Assignment]:
    """Assign at most one part to each free robot, the best pair of part and robot first.

    `candidates` has the robots that may get each part, by part id.
    """
    free = {name for name, robot in robots.items() if not robot.busy_with}
    left = list(parts)
    while True:
        # Fewest tries first, then lowest cost, then order of the parts and of the names.
        pairs = [
            (tries.get((part.id, name), 0), *_cost(part, robots[name].status_reply), k, name, part)
            for k, part in enumerate(left)
            for name in candidates[part.id]
            if name in free
        ]
        if not pairs:
            return
        *_, name, part = min(pairs, key=lambda pair: pair[:-1])
        reply = robots[name].status_reply
        n_duplicates = sum(
            1
            for report in _reports_of(part, {name: robots[name]})
            if report.reason == DUPLICATE_REASON
        )
        yield Assignment(
            part,
            name,
            f"{part.id}{AGAIN}{n_duplicates}" if n_duplicates else part.id,
            _reason_to_give(part, reply),
        )
        left.remove(part)
        free.remove(name)


def _cost(part: MissionPart, reply: StatusReply) -> tuple[int, float]:
    """Return the number of targets at unknown places, and the sum of metres to the others."""
    distances = _known_distances(part, reply)
    return len(part.words) - len(distances), round(sum(distances.values()), 1)


def _known_distances(part: MissionPart, reply: StatusReply) -> dict[str, float]:
    """Return the distance in metres to each target of the part that the robot has in its map."""
    found: dict[str, float] = {}
    for label, away_m in reply.robot.known.items():
        for word in part.words:
            if names.canonical(word) == names.canonical(label):
                found[word] = min(away_m, found.get(word, away_m))
    return found


def _reason_to_give(part: MissionPart, reply: StatusReply) -> str:
    distances = _known_distances(part, reply)
    if not distances:
        return "it is free"
    known = ", ".join(f"{one_line(word)} {away_m:.1f} m" for word, away_m in distances.items())
    return f"it is free and knows {known} away"
