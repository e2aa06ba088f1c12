"""Who gets which part of a mission: decided from what the robots say of themselves alone.

No state is needed: every part has a name, which its robot knows it by, now and after it is over.
So whoever looks comes to the same orders, the first time or after a restart, alone or beside
another.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

from edge import names
from edge.bus.verbs import CANCELLED
from edge.fleet.roster import OVER, Account, Robot
from edge.text import one_line

DOUBLED = "another robot is at it"
"""Why a robot's part was cancelled that two had: no failure, and it may have it again."""
TRIES = 3
"""A robot that refused or forgot a part so often does not get it."""


@dataclass(frozen=True)
class Part:
    """What one robot is to do.

    Attributes:
        id: of the mission that it becomes.
        formula: of it, as text.
        english: the same, for people.
        words: what may have to be reached.
        only: the robot that it is for; None: whichever.
    """

    id: str
    formula: str
    english: str
    words: tuple[str, ...]
    only: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of a part, and by whom."""

    phase: Literal["reached", "failed"]
    by: str
    reason: str


class Give(NamedTuple):
    part: Part
    robot: str
    id: str
    why: str


class Cancel(NamedTuple):
    robot: str
    id: str


@dataclass(frozen=True)
class Orders:
    """What is to be done now.

    Attributes:
        outcomes: of the parts that are over, by id.
        under_way: who is at it, of the others, by id.
        waits: why each robot that is there cannot take a part that waits; empty where none does.
        lost: ids of the `outcomes` that hold only for the robots that are there now: another
            robot may still do the part.
    """

    outcomes: Mapping[str, Outcome]
    under_way: Mapping[str, str]
    give: tuple[Give, ...]
    cancel: tuple[Cancel, ...]
    waits: Mapping[str, str]
    lost: frozenset[str] = frozenset()

    @property
    def failed(self) -> bool:
        """A part is lost, and so is the whole: no more is given out."""
        return any(outcome.phase == "failed" for outcome in self.outcomes.values())


class _Held(NamedTuple):
    """A part as one robot has, or had, it."""

    robot: str
    id: str
    phase: str
    reason: str
    elapsed_s: float


def decide(
    parts: Sequence[Part],
    robots: Mapping[str, Robot],
    away: Mapping[str, str],
    refused: Mapping[tuple[str, str], int] = MappingProxyType({}),
    settled: Mapping[str, Outcome] = MappingProxyType({}),
    forgot: Mapping[tuple[str, str], int] = MappingProxyType({}),
) -> Orders:
    """The orders for a mission.

    Args:
        robots: that are there.
        away: parts by id, and the robot that was at each when it was last heard of, for as long as
            it is hoped to come back.
        refused: how often, by part and robot.
        settled: outcomes from before, which stand whatever became of the robots since.
        forgot: how often a robot that had a part reported next that it never had it, by part and
            robot.
    """
    tries = Counter(refused) + Counter(forgot)
    lost: set[str] = set()
    outcomes: dict[str, Outcome] = {}
    under_way: dict[str, str] = {}
    cancel: list[Cancel] = []
    waiting: dict[str, list[str]] = {}
    for part in parts:
        held = list(_held(part, robots))
        at_it = sorted((h for h in held if h.phase not in OVER), key=lambda h: -h.elapsed_s)
        done = [h for h in held if h.phase == "reached"]
        failed = {h.robot: h.reason for h in held if h.phase == "failed" and h.reason != DOUBLED}
        outcome = settled.get(part.id)
        if outcome is None and done:
            outcome = Outcome("reached", done[0].robot, done[0].reason)
        reached = outcome is not None and outcome.phase == "reached"
        cancel += [Cancel(h.robot, h.id) for h in (at_it if reached else at_it[1:])]
        if outcome is not None:
            outcomes[part.id] = outcome
        elif at_it:
            under_way[part.id] = at_it[0].robot
        elif part.id in away:
            under_way[part.id] = away[part.id]
        elif (outcome := _stopped(part, failed)) is not None:
            outcomes[part.id] = outcome
        elif (outcome := _lost(part, robots, failed, tries, forgot)) is not None:
            outcomes[part.id] = outcome
            lost.add(part.id)
        else:
            waiting[part.id] = [name for name in _may(part, robots, tries) if name not in failed]
    orders = Orders(outcomes, under_way, (), tuple(cancel), {}, frozenset(lost))
    if orders.failed or not waiting:
        return orders
    open_parts = [part for part in parts if part.id in waiting]
    give = tuple(_given(open_parts, waiting, robots, tries))
    waits = {name: robot.busy_with for name, robot in robots.items() if robot.busy_with}
    still = waits if len(give) < len(open_parts) else {}
    return replace(orders, give=give, waits=still)


def holds(part: Part, robot: Robot) -> bool:
    """Whether a robot reports a part, under way or over."""
    return any(True for _ in _held(part, {robot.name: robot}))


def _held(part: Part, robots: Mapping[str, Robot]) -> Iterator[_Held]:
    for name, robot in sorted(robots.items()):
        if (account := robot.account) is None:
            continue
        for past in account.past:
            if past.id.partition("~")[0] == part.id:
                yield _Held(name, past.id, past.phase, past.reason, 0.0)
        if account.id.partition("~")[0] == part.id:
            yield _Held(name, account.id, account.phase, account.reason, account.elapsed_s)


def _may(
    part: Part, robots: Mapping[str, Robot], tries: Mapping[tuple[str, str], int]
) -> list[str]:
    may = [part.only] if part.only is not None else sorted(robots)
    return [name for name in may if name in robots and tries.get((part.id, name), 0) < TRIES]


def _stopped(part: Part, failed: Mapping[str, str]) -> Outcome | None:
    """The failure that no other robot can undo; None while there is none."""
    for name, reason in failed.items():
        # A person's word: no other robot sets out for it.
        if reason == CANCELLED or name == part.only:
            return Outcome("failed", name, reason)
    return None


def _lost(
    part: Part,
    robots: Mapping[str, Robot],
    failed: Mapping[str, str],
    tries: Mapping[tuple[str, str], int],
    forgot: Mapping[tuple[str, str], int],
) -> Outcome | None:
    """Why no robot that is there will do a part; None while one may."""
    if part.only is not None and part.only not in robots:
        return Outcome("failed", part.only, "it is not there")
    tried = {name for id, name in tries if id == part.id}
    if not tried | failed.keys() or any(n not in failed for n in _may(part, robots, tries)):
        return None
    why = {n: "it forgot it" if (part.id, n) in forgot else "it refused" for n in tried}
    why = dict(sorted((why | failed).items()))
    return Outcome("failed", ", ".join(why), "; ".join(f"{n}: {w}" for n, w in why.items()))


def _given(
    parts: Sequence[Part],
    candidates: Mapping[str, Sequence[str]],
    robots: Mapping[str, Robot],
    tries: Mapping[tuple[str, str], int],
) -> Iterator[Give]:
    """Each free robot gets one part at most: the pair that suits best first."""
    free = {name for name, robot in robots.items() if not robot.busy_with}
    left = list(parts)
    while True:
        pairs = [
            (tries.get((part.id, name), 0), *_cost(part, robots[name].account), k, name, part)
            for k, part in enumerate(left)
            for name in candidates[part.id]
            if name in free
        ]
        if not pairs:
            return
        *_, name, part = min(pairs, key=lambda pair: pair[:-1])
        account = robots[name].account
        again = sum(1 for h in _held(part, {name: robots[name]}) if h.reason == DOUBLED)
        yield Give(part, name, f"{part.id}~{again}" if again else part.id, _why(part, account))
        left.remove(part)
        free.remove(name)


def _cost(part: Part, account: Account) -> tuple[int, float]:
    """Words whose place the robot does not know, and metres to the others."""
    places = _places(part, account)
    return len(part.words) - len(places), round(sum(places.values()), 1)


def _places(part: Part, account: Account) -> dict[str, float]:
    """Metres to what the part asks for, of what the robot knows."""
    found: dict[str, float] = {}
    for label, away_m in account.robot.known.items():
        for word in part.words:
            if names.canonical(word) == names.canonical(label):
                found[word] = min(away_m, found.get(word, away_m))
    return found


def _why(part: Part, account: Account) -> str:
    places = _places(part, account)
    if not places:
        return "it is free"
    known = ", ".join(f"{one_line(word)} {away_m:.1f} m" for word, away_m in places.items())
    return f"it is free and knows {known} away"
