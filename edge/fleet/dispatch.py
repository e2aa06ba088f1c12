"""Hands a mission out to robots and tells what becomes of it; see `edge.fleet.orders`."""

from __future__ import annotations

import hashlib
import re
import secrets
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from edge.bus.client import RefusedError, RequestError
from edge.config import Mission
from edge.fleet.orders import DOUBLED, Cancel, Give, Orders, Outcome, Part, decide, holds
from edge.fleet.roster import OVER, Robot, Roster
from edge.mission.brief import Brief
from edge.mission.language.english import describe
from edge.mission.logic.ltl import Formula
from edge.mission.split import asked_for, split
from edge.text import one_line

LOOK_S = 1.0
GIVE_S = 10.0
_DIGITS = 8


@dataclass(frozen=True)
class Plan:
    """A mission and its parts.

    Attributes:
        id: of this mission; of the same one given again later, another.
        why_whole: why it was not split; "" where it was, or was not to be.
    """

    id: str
    parts: tuple[Part, ...]
    why_whole: str = ""


def plan(
    brief: Brief,
    limits: Mission,
    robots: Mapping[str, Robot],
    to: Sequence[str] = (),
    share: bool = False,
    anew: bool = False,
) -> Plan:
    """The parts of a mission, named as the robots know them if they are at it already.

    Args:
        to: a robot each: all of them get the whole. None: one of them does.
        share: its parts may go to several.
        anew: though the robots know of such a mission that is not over.

    Raises:
        CompileError: see `edge.mission.split`.
    """
    formula = brief.automaton.formula
    cut = split(formula, limits) if share else None
    formulas = (formula,) * max(len(to), 1) if cut is None else cut.parts
    digest = _digest(formula, to, share)
    make = partial(_parts, formulas, to, limits)
    run = None if anew else _unfinished(digest, robots, make)
    id = f"{digest}.{run or secrets.token_hex(4)}"
    return Plan(id, make(id), cut.why_whole if cut is not None else "")


def _parts(
    formulas: Sequence[Formula], to: Sequence[str], limits: Mission, id: str
) -> tuple[Part, ...]:
    return tuple(
        Part(
            f"{id}.{k + 1}", str(formula), one_line(describe(formula)),
            asked_for(formula, limits), to[k] if to else None,
        )
        for k, formula in enumerate(formulas)
    )  # fmt: skip


def _digest(*of: object) -> str:
    return hashlib.sha256(repr([str(x) for x in of]).encode()).hexdigest()[:_DIGITS]


def _unfinished(
    digest: str, robots: Mapping[str, Robot], make: Callable[[str], tuple[Part, ...]]
) -> str | None:
    """Of the missions with this digest that robots know of, one that is not over."""
    accounts = [robot.account for robot in robots.values() if robot.account is not None]
    ids = [id for account in accounts for id in (account.id, *(p.id for p in account.past))]
    runs = {m[1] for id in ids if (m := re.match(rf"{digest}\.([0-9a-f]+)\.", id))}
    for run in sorted(runs):
        parts = make(f"{digest}.{run}")
        orders = decide(parts, robots, {})
        if not _is_over(parts, orders):
            return run
    return None


def _is_over(parts: Sequence[Part], orders: Orders) -> bool:
    return len(orders.outcomes) == len(parts) or (orders.failed and not orders.under_way)


class Dispatcher:
    """Looks, decides, gives and tells, until it is over.

    Args:
        tell: hears what happens, a line each.
        patience_s: how long a robot that is gone, or gives no account, is hoped to come back;
            counted from the first look that misses it. A part that no robot there may do fails
            only after it stayed so for as long, since one look may lack a robot that is there.
    """

    def __init__(
        self,
        roster: Roster,
        mission: Plan,
        tell: Callable[[str], None],
        patience_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._roster, self._plan, self._tell = roster, mission, tell
        self._patience_s, self._clock = patience_s, clock
        self._at: dict[str, str] = {}  # who was last known to be at a part
        self._missed: dict[str, float] = {}  # since when a robot is gone, or gives no account
        self._lost: dict[str, float] = {}  # since when no robot that is there may do a part
        self._refused: Counter[tuple[str, str]] = Counter()
        self._forgot: Counter[tuple[str, str]] = Counter()
        self._has: set[tuple[str, str]] = set()  # which robot took, or reported, which part
        self._settled: dict[str, Outcome] = {}
        self._gave: set[tuple[str, str]] = set()
        self._told: dict[str, object] = {}
        self.ended_ns: dict[str, int] = {}

    def run(self) -> Mapping[str, Outcome]:
        """What became of each part, by id; those that were not begun any more are left out."""
        while True:
            orders = self.step()
            if orders is not None and self._is_over(orders):
                return orders.outcomes
            self._roster.wait(LOOK_S)

    def step(self) -> Orders | None:
        """Look once, and do what that comes to; None while nobody can be seen."""
        robots = self._roster.seen()
        if robots is None:
            self._once("router", "the router is gone; robots go on, trying to reach it")
            self._missed.clear()
            self._lost.clear()
            return None
        self._once("router", None, "the router is back")
        for at in [at for at in self._refused if at[1] in robots and robots[at[1]].busy_with]:
            del self._refused[at]  # it refused since it is another's by now
        self._count_forgotten(robots)
        orders = decide(
            self._plan.parts, robots, self._away(robots), self._refused, self._settled,
            self._forgot,
        )  # fmt: skip
        self._settled = {k: o for k, o in orders.outcomes.items() if k not in orders.lost}
        hoped = self._hoped(orders)
        outcomes = {k: o for k, o in orders.outcomes.items() if k not in hoped}
        orders = replace(orders, outcomes=outcomes, lost=orders.lost.difference(hoped))
        self._report(orders, robots, hoped)
        self._roster.each(
            [*(partial(self._give, g) for g in orders.give),
             *(partial(self._cancel, c) for c in orders.cancel)]
        )  # fmt: skip
        return orders

    def _is_over(self, orders: Orders) -> bool:
        return _is_over(self._plan.parts, orders)

    def _count_forgotten(self, robots: Mapping[str, Robot]) -> None:
        """Count the robots that had a part and now report that they never did.

        Such a robot lost its memory in a restart, or lies: others get the part first.
        """
        for part in self._plan.parts:
            for name, robot in robots.items():
                if holds(part, robot):
                    self._has.add((part.id, name))
                elif robot.account is not None and (part.id, name) in self._has:
                    self._has.remove((part.id, name))
                    self._forgot[part.id, name] += 1
                    self._tell(f"{_safe(name)} forgot what it was given: {part.english}")

    def _hoped(self, orders: Orders) -> dict[str, Outcome]:
        """The outcomes of parts that have been lost for less than the patience, by id."""
        now_s = self._clock()
        self._lost = {id: self._lost.get(id, now_s) for id in orders.lost}
        return {
            id: orders.outcomes[id]
            for id, since_s in self._lost.items()
            if now_s - since_s < self._patience_s
        }

    def _away(self, robots: Mapping[str, Robot]) -> dict[str, str]:
        now_s, away = self._clock(), {}
        for name, robot in robots.items():
            if (account := robot.account) is None:
                continue
            self._missed.pop(name, None)
            if account.phase not in OVER:
                self._at[account.id.partition("~")[0]] = name
        for id, name in self._at.items():
            silent = name not in robots or robots[name].account is None
            if silent and now_s - self._missed.setdefault(name, now_s) < self._patience_s:
                away[id] = name
        return away

    # -- what is told --------------------------------------------------------------------------

    def _report(
        self, orders: Orders, robots: Mapping[str, Robot], hoped: Mapping[str, Outcome]
    ) -> None:
        for k, part in enumerate(self._plan.parts, start=1):
            what = f"part {k} of {len(self._plan.parts)} ({part.english})"
            if part.id not in orders.outcomes:
                self.ended_ns.pop(part.id, None)
            if (outcome := orders.outcomes.get(part.id)) is not None:
                self.ended_ns.setdefault(part.id, time.time_ns())
                told = f"{what}: {outcome.phase} by {_safe(outcome.by)}: {one_line(outcome.reason)}"
            elif (name := orders.under_way.get(part.id)) is not None:
                gave = (part.id, name) in self._gave
                told = None if gave else f"{what}: {_safe(name)} is at it"
                if name not in robots:
                    told = (f"{what}: {_safe(name)} is gone; another gets it unless it is back in "
                            f"{self._patience_s:g} s")  # fmt: skip
                elif robots[name].account is None:
                    told = f"{what}: {_safe(name)} gives no account: {robots[name].problem}"
            elif (outcome := hoped.get(part.id)) is not None:
                told = (f"{what}: {one_line(outcome.reason)}; failed unless another robot comes "
                        f"within {self._patience_s:g} s")  # fmt: skip
            else:
                told = None
            self._once(part.id, told)
        waits = "; ".join(f"{_safe(name)}: {why}" for name, why in sorted(orders.waits.items()))
        given = len(orders.outcomes) + len(orders.under_way) + len(orders.give)
        left = len(self._plan.parts) - given
        self._once(
            "waits", f"parts that wait for a free robot: {left} ({waits})" if waits else None
        )
        self._once("nobody", None if robots else "no robot is there; waiting for one")

    def _once(self, about: str, text: str | None, otherwise: str | None = None) -> None:
        """Tell what is new about something; `otherwise`, where there was something to tell and
        is nothing now."""
        before = self._told.get(about)
        self._told[about] = text
        if text != before and (said := text or (otherwise if before else None)):
            self._tell(said)

    # -- what is asked for, each on a thread of its own ------------------------------------------

    def _give(self, give: Give) -> None:
        request = {"do": "new", "formula": give.part.formula, "id": give.id, "if_free": True}
        try:
            self._roster.tell(give.robot, request, GIVE_S)
        except RequestError as error:
            # Late is not never: the next look tells whether it began.
            self._refused[give.part.id, give.robot] += 1
            refused = "" if isinstance(error, RefusedError) else "did not answer: "
            self._tell(f"{refused}{one_line(error)}")
        else:
            self._gave.add((give.part.id, give.robot))
            self._has.add((give.part.id, give.robot))
            self._at[give.part.id] = give.robot
            self._tell(f"{_safe(give.robot)} gets: {give.part.english}: {give.why}")

    def _cancel(self, cancel: Cancel) -> None:
        request = {"do": "cancel", "id": cancel.id, "why": DOUBLED}
        try:
            self._roster.tell(cancel.robot, request, GIVE_S)
        except RequestError as error:
            self._tell(one_line(error))
        else:
            self._tell(f"{_safe(cancel.robot)} is told to stop: {DOUBLED}")


def _safe(name: str) -> str:
    return one_line(name, 80)
