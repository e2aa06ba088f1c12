"""Controlled English to LTL, offline: the same sentence always gives the same formula.

    instruction = sentence { ("." | ";") sentence }
    sentence    = sequence { "or" sequence }        ("…; or …" also across a semicolon)
    sequence    = step { "then" step }
    step        = clause { (",", "and", "but", nothing) clause }

Clauses, what may follow their verbs, noun phrases, moods and counts, and the words themselves have
files of their own (`clauses`, `adjuncts`, `things`, `spoken`, `lexicon`). How a clause is read:

- an order ("visit x") is a goal. Every verb of the lexicon means "reach", "see" included; other
  verbs are refused. After an article any words are a name; without one, known names are;
- a duty with a condition ("once you visit x you must visit y") is G(x -> F y); a permission
  ("you can visit x") asks for nothing;
- "do not x until y", and the like with "before", is the weak until `!x W y`: y need not happen.
  ViTL writes U, but its tables II and III hold only under W;
- "x before y" as an order asks for both, and y not before x; or for x only; or merely for x, then
  y. "x only after y" asks for x, and not before y;
- "x while avoiding y" is: x, and no y before it;
- goals without "then" between them may come in any order; a list with commas only that "then"
  ends ("a, b, then c") is in order;
- "in order" is "then" between all; "in exactly this order" also bans each before the one before;
- "n times" means at least n separate visits; in a sequence, "exactly once" and "at most once"
  hold until the next step.

Whatever fits none of this is refused by name, never skipped or guessed.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field

from edge.mission.language.clauses import Bare, starts_clause, take_clause
from edge.mission.language.goals import (
    Every,
    Goal,
    Some,
    Steps,
    Visit,
    at_most,
    at_most_before,
    formula_of,
    held_until,
    last_letters,
    letters,
    never,
    never_after,
    steps,
    visits,
)
from edge.mission.language.meaning import Meaning, meaning_of, permission_of
from edge.mission.language.nouns import is_foreign
from edge.mission.language.spoken import Clause, Condition, Memory
from edge.mission.language.things import Things
from edge.mission.language.words import (
    Reader,
    Token,
    TranslationError,
    not_understood,
    tokenise,
)
from edge.mission.ltl import TRUE, Formula, postorder


def sequence_goal(sequence: Sequence[Meaning], reader: Reader) -> Goal:
    """The goal of steps one after the other, each with its rules."""
    parts: list[Goal] = []
    rules: list[Formula] = []
    for i, meaning in enumerate(sequence):
        after = sequence[i + 1 :]
        parts += _in_order(meaning) if after else meaning.goals and [_together(meaning.goals)]
        rules += meaning.rules
        rules += _banned(meaning, sequence[:i], after)
        rules += _without(meaning, after, reader)
        rules += _limited(meaning, after)
    return Every((steps(parts),) if parts else (), tuple(rules))


def anchored(
    meaning: Meaning, sequence: Sequence[Meaning], asked: Container[str], then: bool
) -> None:
    """Puts a clause's goals after what it says they come after.

    "Go to a, and go to b after that": the visit to a is the one already asked for.

    Args:
        asked: names asked for so far.
        then: the clause comes after all of the sequence anyway.
    """
    for anchor in meaning.anchors:
        said = set(anchor.names)
        if then and all(name in asked for name in said):
            continue
        before: list[Goal] = [visits(anchor)]
        if sequence and not then:
            meant = [goal for goal in sequence[-1].goals if letters(goal) & said]
            if said <= frozenset().union(*map(letters, meant)) and all(
                last_letters(goal) <= said for goal in meant
            ):
                sequence[-1].goals = [g for g in sequence[-1].goals if g not in meant]
                before = [_together(meant)]
        meaning.goals = [steps([*before, _together(meaning.goals)])]


def put_first(meaning: Meaning, sequence: list[Meaning]) -> None:
    """Makes a clause the step before the last one, which it may repeat a part of.

    "Visit the sofa and the desk, but the desk first": that is one visit to the desk.
    """
    said = frozenset(meaning.things.names)
    last = sequence[-1]
    parts = [
        part
        for goal in last.goals
        for part in (goal.goals if isinstance(goal, Every) and not goal.rules else (goal,))
    ]
    rest = [part for part in parts if not letters(part) <= said]
    last.goals = rest or last.goals
    sequence.insert(-1, meaning)


def _split_return(meaning: Meaning, sequence: list[Meaning]) -> None:
    """`visit a, go to b, and return to a`: a comes before b, which comes before a again."""
    said = frozenset(meaning.things.names)
    start = [goal for goal in sequence[0].goals if letters(goal) & said]
    rest = [goal for goal in sequence[0].goals if not letters(goal) & said]
    if start and rest:
        sequence[0].goals = [steps([_together(start), _together(rest)])]


def only_then(before: Meaning, after: Meaning) -> list[Formula]:
    """`x, only then y`: y not before x."""
    return held_until(after.things.names, before.things)


def _together(goals: Sequence[Goal]) -> Goal:
    return goals[0] if len(goals) == 1 else Every(tuple(goals))


def _in_order(meaning: Meaning) -> list[Goal]:
    """A step's goals; "a, b, then …" with no "and" in it is a sequence already."""
    if not meaning.listed:
        return [_together(meaning.goals)] if meaning.goals else []
    return [
        part
        for goal in meaning.goals
        for part in (goal.goals if isinstance(goal, (Every, Steps)) else (goal,))
    ]


def _banned(meaning: Meaning, before: Sequence[Meaning], after: Sequence[Meaning]) -> list[Formula]:
    """A ban lasts for good; until its step is done if that or another step asks for the same."""
    asked = {name for step in (meaning, *after) for goal in step.goals for name in letters(goal)}
    visited = {
        name: visit.times
        for step in before
        for goal in step.goals
        for visit in _visits(goal)
        for name in visit.options
    }
    rules: list[Formula] = []
    for names in meaning.bans:
        for name in names:
            own = Things(tuple(group for group in meaning.things.groups if name not in group))
            if name in visited and own.groups:
                rules += [at_most_before([name], visited[name], end) for end in own.groups]
            elif name in asked and own.groups:
                rules += held_until([name], own)
            elif meaning.follows and not meaning.goals and before:
                rules += never_after([name], before[-1].things)
            else:
                rules += never([name])
    return rules


def _without(meaning: Meaning, after: Sequence[Meaning], reader: Reader) -> list[Formula]:
    """`go to x without y, then to z`: no y before x, or none at all."""
    asked = {name for step in after for goal in step.goals for name in letters(goal)}
    rules: list[Formula] = []
    for names, things, token in meaning.withouts:
        ever = not asked & set(names) and reader.pick(token, 2)
        rules += never(names) if ever else held_until(names, things)
    return rules


def _visits(goal: Goal) -> Iterator[Visit]:
    if isinstance(goal, Visit):
        yield goal
    else:
        for part in goal.goals:
            yield from _visits(part)


def _limited(meaning: Meaning, after: Sequence[Meaning]) -> list[Formula]:
    """A limit lasts until the next step if that is a single visit, else for good."""
    goals = after[0].goals if after else []
    if len(goals) == 1 and isinstance(goals[0], Visit):
        end = goals[0].options
        return [
            at_most(names, n) if set(end) & set(names) else at_most_before(names, n, end)
            for names, n in meaning.limits
        ]
    return [at_most(names, n) for names, n in meaning.limits]


__all__ = ["TranslationError", "readings"]

MAX_READINGS = 12
"""The most ways to read one instruction that anybody is asked to choose from."""
MAX_NODES = 20_000
"""A formula's largest size; "a and b, then c and d, then …" doubles it with every step."""

_MOVES = (
    "go",
    "move",
    "walk",
    "drive",
    "head",
    "travel",
    "come",
    "proceed",
    "enter",
    "continue",
    "pass",
    "navigate",
    "cross",
)
_ONWARD = ("proceed", "continue", "end up", "ends up", "ending up", "end at", "end in", "finish")
_THEN = ("then", "only then")
_JOINTS = ("comma", "and", "but", *_THEN)  # the last one said most about how clauses go together


def readings(text: str) -> tuple[Formula, ...]:
    """The formulas that an instruction may ask for, over canonical names; the usual one first.

    The text is read once for each way to go at each token where English leaves it open.

    Raises:
        TranslationError: it has a part that is not understood, which the message names, or can be
            read in more than `MAX_READINGS` ways.
    """
    tokens = tokenise(text)
    found: list[Formula] = []
    todo: list[dict[int, int]] = [{}]
    for picks in todo:
        reader = Reader(text, tokens, picks)
        try:
            found.append(_Discourse(reader).formula())
        except TranslationError:
            if picks:
                continue  # this way leads nowhere
            if is_foreign(text):
                hint = "instructions are read in English only"
                raise not_understood(text, 1, hint) from None
            raise
        last = max(picks, default=-1)
        todo += [
            {**picks, start: way}
            for start, ways in sorted(reader.forks.items())
            if start > last
            for way in range(1, ways)
        ]
        if len(todo) > MAX_READINGS:
            hint = "it can be read in too many ways; say it in several sentences"
            reader.refuse(hint, tokens[0])
    return tuple(found)


def _size(formula: Formula) -> int:
    """Nodes of the formula as a tree; parts that it shares count each time, as in its text."""
    sizes: dict[int, int] = {}
    for f in postorder(formula):
        sizes[id(f)] = 1 + sum(sizes[id(arg)] for arg in f.args)
    return sizes[id(formula)]


def _both(first: Meaning | None, second: Meaning) -> Meaning:
    if first is None:
        return second
    first.add(second)
    return first


@dataclass(slots=True)
class _Discourse:
    """A cursor on the instruction, and what was said so far.

    Attributes:
        goal: what is to be achieved.
        rules: what holds throughout, whichever alternative is taken.
        times: how often each name was asked for.
        first: the last goal was said to come first, so what follows comes after it.
        clauses: how many there were.
        denied: the last clause forbade something, so a bare "then the bed" could mean either.
        moved: the last clause was a plain order to go somewhere: "go to a go to b" is in order.
        passed: the last clause only went through somewhere.
        permitted: what the last clause allowed, if it asked for nothing.
    """

    reader: Reader
    memory: Memory = field(default_factory=Memory)
    goal: Goal | None = None
    rules: list[Meaning] = field(default_factory=list)
    times: dict[str, int] = field(default_factory=dict)
    first: bool = False
    clauses: int = 0
    permitted: Things | None = None
    denied: bool = False
    moved: bool = False
    passed: bool = False

    def formula(self) -> Formula:
        """Sentence after sentence; "then" at the start of one goes on from the one before."""
        reader = self.reader
        reader.skip("comma", "stop")
        while not reader.sees("end"):
            if self.clauses and reader.sees("any order") and reader.sees("stop", "end", ahead=1):
                reader.take("any order")  # "…; the order does not matter": as it is anyway
            else:
                joint = reader.take(*_THEN, "and", "but")
                reader.skip("comma")
                self._sentence(joint)
            reader.skip("comma", "stop")
        parts = [] if self.goal is None else [self.goal]
        parts += [sequence_goal([rule], reader) for rule in self.rules]
        formula = formula_of(Every(tuple(parts)))
        if _size(formula) > MAX_NODES:
            reader.refuse("its formula would be too large; ask for less at once", reader.tokens[0])
        if formula == TRUE:
            hint = "nothing is asked for; say for example 'visit the bed, then the chair'"
            reader.refuse(hint, reader.tokens[0])
        return formula

    def _sentence(self, joint: Token | None) -> None:
        """Sequences with "or" between them."""
        reader = self.reader
        if reader.sees("either") and reader.sees("verb", "you", "first", ahead=1):
            reader.take("either")
        after = self.first or (joint is not None and joint.kind in _THEN)
        start = reader.peek()
        sequence, loose = self._sequence(joint)
        sequences = [sequence]
        while (ahead := self._alternative_ahead()) is not None:
            reader.at += ahead
            if loose:
                sequences[-1].append(loose)
            sequence, loose = self._sequence(Token("or", "or", 0, 0))
            sequences.append(sequence)
        if loose:
            self.rules.append(loose)
        if len(sequences) > 1 and not all(
            any(step.goals for step in sequence) for sequence in sequences
        ):
            reader.refuse("each alternative needs something to reach", start)
        if not sequence:
            return
        options = tuple(sequence_goal(sequence, reader) for sequence in sequences)
        goal = options[0] if len(options) == 1 else Some(options)
        if self.goal is None:
            self.goal = goal
        else:
            self.goal = steps([self.goal, goal]) if after else Every((self.goal, goal))

    def _alternative_ahead(self) -> int | None:
        """Tokens up to the next alternative ("; or reach …"); None when there is none."""
        ahead = 1 if self.reader.sees("comma", "stop") else 0
        if not self.reader.sees("or", ahead=ahead):
            return None
        ahead += 1
        if self.reader.sees("either", ahead=ahead) and self.reader.sees("verb", ahead=ahead + 1):
            ahead += 1
        return ahead if starts_clause(self.reader, ahead) else None

    def _sequence(self, joint: Token | None) -> tuple[list[Meaning], Meaning | None]:
        """Steps with "then" between them, and the rules that end them."""
        sequence: list[Meaning] = []
        loose: Meaning | None = None
        while True:
            clause, meaning = self._clause(joint, sequence)
            kind = joint.kind if joint else ""
            if meaning.loose and kind != "but" and not meaning.follows:
                loose = _both(loose, meaning)
            else:
                if loose is not None:
                    (sequence[-1] if sequence else meaning).add(loose)
                    loose = None
                self._place(clause, meaning, kind, sequence)
            joint = self._joint()
            if joint is None:
                return sequence, loose

    def _clause(self, joint: Token | None, sequence: list[Meaning]) -> tuple[Clause, Meaning]:
        """The next clause, and what it means after those before it."""
        bare: Bare = "known" if not self.clauses else "no"
        if self.clauses and joint and joint.kind and not self.denied:
            bare = "yes"
        clause = take_clause(self.reader, self.memory, bare)
        if clause.trails:
            self._after_permission(clause, bool(sequence))
        then = clause.trails or (joint is not None and joint.kind in _THEN)
        then = then or (clause.returns and bool(sequence) and not clause.negated)
        moves = clause.verb in _MOVES and not clause.negated and not clause.first
        goes_on = clause.verb.startswith(_ONWARD) and not clause.negated
        then = then or (goes_on and bool(sequence) and not sequence[-1].loose)
        then = then or (moves and self.moved and joint is not None and joint.kind == "")
        then = then or (moves and self.passed and joint is not None)
        if moves and self.moved and not then and joint is not None and joint.kind == "and":
            then = self.reader.pick(joint, 2) == 1  # "go to a and go to b" may be in order
        if clause.through and moves and not then and self.moved and not self.passed:
            self.reader.refuse("before or after that? say 'go through … to …'", clause.token)
        self.moved, self.passed = moves, clause.through and clause.order != "in order"
        meaning = meaning_of(clause, self.reader, self.times, then)
        meaning.follows = then
        anchored(meaning, sequence, self.times, then)
        self.permitted = permission_of(clause)
        self.denied = clause.negated
        self.clauses += 1
        self._count(meaning)
        return clause, meaning

    def _place(self, clause: Clause, meaning: Meaning, joint: str, sequence: list[Meaning]) -> None:
        """Makes a clause a step of its own, or a part of the last one."""
        if clause.returns and len(sequence) == 1:
            _split_return(meaning, sequence)
        if joint == "only then" and sequence:
            meaning.rules += only_then(sequence[-1], meaning)
        if joint == "but" and clause.first and sequence and meaning.goals:
            put_first(meaning, sequence)  # "…, but first go to the sofa"
            clause.first = False
        elif not sequence or meaning.follows or (self.first and not meaning.loose):
            sequence.append(meaning)
        else:
            sequence[-1].add(meaning, joint)
        self.first = clause.first and not meaning.loose

    def _after_permission(self, clause: Clause, started: bool) -> None:
        """`you can visit a, but you must visit b after that`: after a, if ever."""
        if not self.permitted and clause.negated and not started:
            self.permitted = self.memory.asked
        if clause.conditions:
            clause.trails = False  # "once you visit a, you must visit b after that"
        elif self.permitted:
            clause.conditions.append(Condition("after", clause.token, self.permitted))
            clause.trails = False
        elif not self.clauses:
            self.reader.refuse("it comes after nothing", clause.token)

    def _joint(self) -> Token | None:
        """Passes what joins this clause to the next; None at the end of the sequence."""
        reader = self.reader
        if reader.sees("comma") and reader.sees("or", ahead=1):
            return None
        begin, joint = reader.at, reader.peek()
        while token := reader.take(*_JOINTS):
            if _JOINTS.index(token.kind) >= _JOINTS.index(joint.kind):
                joint = token
        if reader.sees("filler") and reader.sees("stop", "end", ahead=1):
            reader.take("filler")  # "…, please."
            return None
        if reader.at > begin:
            if not starts_clause(reader):
                reader.refuse("expected a clause here")
            return joint
        if reader.sees("end", "stop", "or"):
            return None
        if not starts_clause(reader) or not self._begins_well():
            reader.refuse("no word that is known here")
        return Token("", "", joint.start, joint.start)

    def _begins_well(self) -> bool:
        """Whether a clause without a joint before it has a verb of its own."""
        return not self.reader.sees("word", "quoted", "to") or len(self.reader.peek().text) == 1

    def _count(self, meaning: Meaning) -> None:
        """Notes how often things were asked for."""
        for goal in meaning.goals:
            for visit in goal.goals if not isinstance(goal, Visit) else (goal,):
                if isinstance(visit, Visit):
                    self.times |= dict.fromkeys(visit.options, visit.times)
