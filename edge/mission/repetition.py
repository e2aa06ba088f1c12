"""Repetition of a mission in rounds, such as a patrol, without an end or with one.

The formula describes one round. The automaton starts again after each round, so the number of
rounds does not change its size.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated

from pydantic import ConfigDict, Field

from edge import number_words
from edge.errors import UserError
from edge.mission.destinations import DURATION, Seconds, duration_s
from edge.mission.language.words.spans import shown_s
from edge.mission.logic import ltl
from edge.mission.logic.ltl import Formula
from edge.text import bounded_repr

MAX_ROUNDS = 10_000
"""Largest number of rounds that may be asked for."""
_PHRASE = re.compile(
    rf"[,;.]?\s*\brepeat\s+(?:(?P<rounds>\w+)\s+times|for\s+(?P<time>{DURATION})|until\s+told)"
    r"[\s.!]*$",
    re.I,
)


@dataclass(frozen=True, slots=True)
class Repetition:
    """The end of a mission that repeats.

    With neither attribute, the mission repeats until a person ends it.

    Attributes:
        rounds: number of rounds; None: no limit.
        limit_s: time after which the mission ends, in whichever round it is; None: no limit.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    rounds: Annotated[int, Field(ge=1, le=MAX_ROUNDS)] | None = None
    limit_s: Seconds | None = None

    @property
    def endless(self) -> bool:
        """True if only a person ends the mission."""
        return self.rounds is None and self.limit_s is None

    def __str__(self) -> str:
        """Return the end as text.

        >>> str(Repetition(3)), str(Repetition(limit_s=1200.0)), str(Repetition())
        ('3 times', 'for 20 min', 'until told')
        """
        ends = [] if self.rounds is None else [f"{self.rounds} times"]
        ends += [] if self.limit_s is None else [f"for {shown_s(self.limit_s)}"]
        return ", at most ".join(ends) or "until told"

    def shown_round(self, round_number: int, elapsed_s: float) -> str:
        """Return the progress as text, such as `round 2 of 3`."""
        text = f"round {round_number}" + (f" of {self.rounds}" if self.rounds else "")
        if self.limit_s is None:
            return text
        return f"{text}, {shown_s(max(0, math.ceil(self.limit_s - elapsed_s)))} left"


def split_repetition(instruction: str) -> tuple[str, Repetition | None]:
    """Return an instruction without the phrase at its end that repeats it, and the repetition.

    The canonical phrases are `repeat 12 times`, `repeat for 20 min` and `repeat until told`.

    Raises:
        UserError: the number of rounds or the time cannot be used.

    Example:
        >>> split_repetition("go to the dock, then to the shelf; repeat 12 times")
        ('go to the dock, then to the shelf', Repetition(rounds=12, limit_s=None))
    """
    found = _PHRASE.search(instruction)
    if found is None:
        return instruction, None
    rest = instruction[: found.start()]
    if found["time"] is not None:
        return rest, Repetition(limit_s=duration_s(found["time"].lower()))
    if found["rounds"] is None:
        return rest, Repetition()
    rounds = number_words.number([found["rounds"].lower()])
    if rounds is None or not 1 <= rounds <= MAX_ROUNDS:
        raise UserError(
            f"instruction: to repeat {bounded_repr(found['rounds'], 40)} times: expected a number "
            f"from 1 to {MAX_ROUNDS}"
        )
    return rest, Repetition(rounds)


def recurrence(formula: Formula, given: bool) -> tuple[Formula, bool]:
    """Return one round of a formula of recurrence, `G F a & G F b`, and True.

    Return any other formula unchanged, and False.

    On a finite trace, two such parts contradict each other, and one means that the trace ends with
    it. So one part alone is a recurrence only if a repetition is given. A round visits the parts in
    the order of the formula. Parts `G !x` stay as they are.

    Args:
        formula: a formula.
        given: True if a repetition is given with the formula.
    """
    parts = formula.args if formula.op == "&" else (formula,)
    goals = [goal for part in parts for goal in _recurring_goals(part)]
    bans = [part for part in parts if part.op == "G" and part.args[0].op == "!"]
    others = [part for part in parts if not _recurring_goals(part) and part not in bans]
    if others or len(goals) < (1 if given else 2):
        return formula, False
    chain = ltl.eventually(goals[-1])
    for goal in reversed(goals[:-1]):
        chain = ltl.eventually(ltl.conj(goal, chain))
    return ltl.conj(chain, *bans), True


def _recurring_goals(part: Formula) -> list[Formula]:
    """Return the propositions that `G F a` or `G (F a & F b)` asks for again and again."""
    if part.op != "G":
        return []
    inner = part.args[0]
    recurring = inner.args if inner.op == "&" else (inner,)
    goals = [operand.args[0] for operand in recurring if operand.op == "F"]
    simple = len(goals) == len(recurring) and all(goal.op == "ap" for goal in goals)
    return goals if simple else []
