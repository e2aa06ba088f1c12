"""Dispatch of a mission to robots, and reports of its progress; see `edge.fleet.orders`."""

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
from edge.fleet.orders import (
    AGAIN,
    DUPLICATE_REASON,
    Assignment,
    Cancellation,
    MissionPart,
    Orders,
    PartOutcome,
    decide,
    has_part,
)
from edge.fleet.roster import OVER, Robot, Roster
from edge.mission.language.grammar.english import describe
from edge.mission.logic.ltl import Formula
from edge.mission.spec import MissionSpec
from edge.mission.split import required_propositions, split
from edge.text import one_line

POLL_S = 1.0
"""Period of the polls of the robots, in seconds."""
REQUEST_S = 10.0
"""Timeout of a request that gives or cancels a part, in seconds."""
_DIGITS = 8  # of the digest of a mission


@dataclass(frozen=True)
class FleetPlan:
    """A mission and its parts.

    Attributes:
        id: Id of the mission: a digest of its formula and options, a dot, and the id of the run. So
            the same mission gets another id when it is given again later. The id of a part is this
            id, a dot, and the part's number.
        unsplit_reason: Reason why the mission was not split; "" if it was split, or if no split was
            requested.
    """

    id: str
    parts: tuple[MissionPart, ...]
    unsplit_reason: str = ""


def plan(
    spec: MissionSpec,
    robots: Mapping[str, Robot],
    to: Sequence[str] = (),
    share: bool = False,
    restart: bool = False,
) -> FleetPlan:
    """Return the parts of a mission.

    If robots already work on such a mission, the parts get the ids that the robots know.

    Args:
        spec: The mission.
        robots: Robots by name, with their status.
        to: Names of robots that each get the entire mission. Empty: any one robot gets it.
        share: Split the mission, so that several robots can share it.
        restart: Start a new mission even if robots know an unfinished one like it.

    Raises:
        CompileError: See `edge.mission.split`.
    """
    formula = spec.automaton.formula
    mission_split = split(formula) if share else None
    formulas = (formula,) * max(len(to), 1) if mission_split is None else mission_split.parts
    digest = _digest(formula, to, share)
    make_parts = partial(_make_parts, formulas, to)
    run_id = None if restart else _find_unfinished_run(digest, robots, make_parts)
    id = f"{digest}.{run_id or secrets.token_hex(4)}"  # such as 1f2e3d4c.9a8b7c6d
    return FleetPlan(
        id, make_parts(id), mission_split.unsplit_reason if mission_split is not None else ""
    )


def _make_parts(formulas: Sequence[Formula], to: Sequence[str], id: str) -> tuple[MissionPart, ...]:
    return tuple(
        MissionPart(
            f"{id}.{k + 1}", str(formula), one_line(describe(formula)),
            required_propositions(formula), to[k] if to else None,
        )
        for k, formula in enumerate(formulas)
    )  # fmt: skip


def _digest(*values: object) -> str:
    return hashlib.sha256(repr([str(value) for value in values]).encode()).hexdigest()[:_DIGITS]


def _find_unfinished_run(
    digest: str, robots: Mapping[str, Robot], make_parts: Callable[[str], tuple[MissionPart, ...]]
) -> str | None:
    """Return the run id of an unfinished mission with this digest that robots report, or None."""
    replies = [robot.status_reply for robot in robots.values() if robot.status_reply is not None]
    ids = [id for reply in replies for id in (reply.id, *(p.id for p in reply.past))]
    # From the ids of parts, such as 1f2e3d4c.9a8b7c6d.2, the run 9a8b7c6d.
    runs = {m[1] for id in ids if (m := re.match(rf"{digest}\.([0-9a-f]+)\.", id))}
    for run in sorted(runs):
        parts = make_parts(f"{digest}.{run}")
        orders = decide(parts, robots, {})
        if not _is_over(parts, orders):
            return run
    return None


def _is_over(parts: Sequence[MissionPart], orders: Orders) -> bool:
    return len(orders.outcomes) == len(parts) or (orders.failed and not orders.under_way)


class Dispatcher:
    """A loop that polls the robots, assigns parts and reports progress until the mission is over.

    Args:
        report: Function that is called with each progress line.
        patience_s: Time to wait for a robot that is offline or reports no status, counted from the
            first poll without it. A part that no online robot can do also fails only after this
            time, because one poll may miss a robot.
        clock: Clock in seconds.

    Attributes:
        ended_ns: Wall-clock time at which each part ended, by part id.
    """

    def __init__(
        self,
        roster: Roster,
        mission: FleetPlan,
        report: Callable[[str], None],
        patience_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._roster, self._plan, self._print = roster, mission, report
        self._patience_s, self._clock = patience_s, clock
        self._assigned: dict[str, str] = {}  # part id: robot last known to work on it
        self._offline_since: dict[str, float] = {}  # robot: time since it reports no status
        self._lost: dict[str, float] = {}  # part id: time since no online robot can do it
        self._n_refused: Counter[tuple[str, str]] = Counter()  # by (part id, robot)
        self._n_forgot: Counter[tuple[str, str]] = Counter()  # by (part id, robot)
        self._holders: set[tuple[str, str]] = set()  # (part id, robot): accepted or reported
        self._final: dict[str, PartOutcome] = {}  # part id: its final outcome, see `Orders.lost`
        self._given_here: set[tuple[str, str]] = set()  # (part id, robot): given by this dispatcher
        self._printed: dict[str, object] = {}  # key of a progress line: its last text
        self.ended_ns: dict[str, int] = {}

    def run(self) -> Mapping[str, PartOutcome]:
        """Run until the mission is over; return the outcome of each finished part, by id."""
        while True:
            orders = self.step()
            if orders is not None and self._is_over(orders):
                return orders.outcomes
            self._roster.wait(POLL_S)

    def step(self) -> Orders | None:
        """Poll the robots once and carry out the orders; return None if the router is gone."""
        robots = self._roster.complete_list()
        if robots is None:
            self._print_if_changed(
                "router", "the router is gone: robots continue and try to reconnect"
            )
            self._offline_since.clear()
            self._lost.clear()
            return None
        self._print_if_changed("router", None, "the router is back")
        for pair in list(self._n_refused):
            if pair[1] in robots and robots[pair[1]].busy_with:
                del self._n_refused[pair]  # the robot refused because it was busy
        self._count_forgotten(robots)
        orders = decide(
            self._plan.parts, robots, self._find_away(robots), self._n_refused, self._final,
            self._n_forgot,
        )  # fmt: skip
        self._final = {id: o for id, o in orders.outcomes.items() if id not in orders.lost}
        # Provisional failures are no outcomes yet: they are only reported.
        provisional = self._provisional_outcomes(orders)
        outcomes = {id: o for id, o in orders.outcomes.items() if id not in provisional}
        orders = replace(orders, outcomes=outcomes, lost=orders.lost.difference(provisional))
        self._report(orders, robots, provisional)
        self._roster.run_all(
            [*(partial(self._give_part, g) for g in orders.give),
             *(partial(self._cancel_duplicate, c) for c in orders.cancel)]
        )  # fmt: skip
        return orders

    def _is_over(self, orders: Orders) -> bool:
        return _is_over(self._plan.parts, orders)

    def _count_forgotten(self, robots: Mapping[str, Robot]) -> None:
        """Count the robots that had a part and no longer report it.

        Such a robot lost its state in a restart, or reports wrongly. Other robots get the part
        first.
        """
        for part in self._plan.parts:
            for name, robot in robots.items():
                if has_part(part, robot):
                    self._holders.add((part.id, name))
                elif robot.status_reply is not None and (part.id, name) in self._holders:
                    self._holders.remove((part.id, name))
                    self._n_forgot[part.id, name] += 1
                    self._print(f"{_safe(name)} no longer knows its part: {part.english}")

    def _provisional_outcomes(self, orders: Orders) -> dict[str, PartOutcome]:
        """Return the outcomes of parts that have been lost for less than `patience_s`, by id."""
        now_s = self._clock()
        self._lost = {id: self._lost.get(id, now_s) for id in orders.lost}
        return {
            id: orders.outcomes[id]
            for id, since_s in self._lost.items()
            if now_s - since_s < self._patience_s
        }

    def _find_away(self, robots: Mapping[str, Robot]) -> dict[str, str]:
        """Return robots that are offline for less than `patience_s`, by the part that they had."""
        now_s, away = self._clock(), {}
        for name, robot in robots.items():
            if (reply := robot.status_reply) is None:
                continue
            self._offline_since.pop(name, None)
            if reply.phase not in OVER:
                self._assigned[reply.id.partition(AGAIN)[0]] = name  # the part's id
        for id, name in self._assigned.items():
            silent = name not in robots or robots[name].status_reply is None
            if silent and now_s - self._offline_since.setdefault(name, now_s) < self._patience_s:
                away[id] = name
        return away

    # -- progress lines ------------------------------------------------------------------------

    def _report(
        self, orders: Orders, robots: Mapping[str, Robot], provisional: Mapping[str, PartOutcome]
    ) -> None:
        """Print a line for each part whose state changed, and note when each part ended."""
        for k, part in enumerate(self._plan.parts, start=1):
            what = f"part {k} of {len(self._plan.parts)} ({part.english})"
            if part.id not in orders.outcomes:
                self.ended_ns.pop(part.id, None)
            if (outcome := orders.outcomes.get(part.id)) is not None:
                self.ended_ns.setdefault(part.id, time.time_ns())
                line = f"{what}: {outcome.phase} by {_safe(outcome.by)}: {one_line(outcome.reason)}"
            elif (name := orders.under_way.get(part.id)) is not None:
                gave = (part.id, name) in self._given_here
                line = None if gave else f"{what}: {_safe(name)} is working on it"
                if name not in robots:
                    line = (f"{what}: {_safe(name)} is offline; another robot gets the part unless "
                            f"it is back within {self._patience_s:g} s")  # fmt: skip
                elif robots[name].status_reply is None:
                    line = f"{what}: {_safe(name)} reports no status: {robots[name].problem}"
            elif (outcome := provisional.get(part.id)) is not None:
                line = (f"{what}: {one_line(outcome.reason)}; the part fails unless another robot "
                        f"comes online within {self._patience_s:g} s")  # fmt: skip
            else:
                line = None
            self._print_if_changed(part.id, line)
        waits = "; ".join(f"{_safe(name)}: {why}" for name, why in sorted(orders.waits.items()))
        given = len(orders.outcomes) + len(orders.under_way) + len(orders.give)
        n_left = len(self._plan.parts) - given
        self._print_if_changed(
            "waits", f"parts waiting for a free robot: {n_left} ({waits})" if waits else None
        )
        self._print_if_changed("nobody", None if robots else "no robot is online; waiting for one")

    def _print_if_changed(self, about: str, text: str | None, otherwise: str | None = None) -> None:
        """Print `text` if it differs from the last text with the key `about`.

        If `text` is None and the last one was not, print `otherwise`.
        """
        before = self._printed.get(about)
        self._printed[about] = text
        if text != before and (line := text or (otherwise if before else None)):
            self._print(line)

    # -- requests to robots, each on its own thread ----------------------------------------------

    def _give_part(self, give: Assignment) -> None:
        request = {"do": "new", "formula": give.part.formula, "id": give.id, "if_free": True}
        try:
            self._roster.send(give.robot, request, REQUEST_S)
        except RequestError as error:
            # A late robot may still have begun; the next poll shows that.
            self._n_refused[give.part.id, give.robot] += 1
            refused = "" if isinstance(error, RefusedError) else "no answer: "
            self._print(f"{refused}{one_line(error)}")
        else:
            self._given_here.add((give.part.id, give.robot))
            self._holders.add((give.part.id, give.robot))
            self._assigned[give.part.id] = give.robot
            self._print(f"{_safe(give.robot)} gets: {give.part.english}: {give.why}")

    def _cancel_duplicate(self, cancel: Cancellation) -> None:
        request = {"do": "cancel", "id": cancel.id, "why": DUPLICATE_REASON}
        try:
            self._roster.send(cancel.robot, request, REQUEST_S)
        except RequestError as error:
            self._print(one_line(error))
        else:
            self._print(f"{_safe(cancel.robot)} was cancelled: {DUPLICATE_REASON}")


def _safe(name: str) -> str:
    """Return a robot's name for output: printable, and at most 80 characters."""
    return one_line(name, 80)
