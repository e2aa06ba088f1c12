"""Parser of an entire instruction: joins the meanings of its clauses to one formula.

A sentence is one or more sequences with "or" between them. A sequence is a list of steps with
"then" between them. A joint is the token between two clauses, such as "and"; its kind is "" if the
clauses follow each other without a word. A loose meaning has rules only, no goal.

`reader.pick(token, n)` asks for one of n meanings of an ambiguous token. `grammar.readings` parses
the instruction once for each combination of these choices; 0 is the usual meaning.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

from edge.mission.language.grammar.clause_parts import Clause, Condition, Count
from edge.mission.language.grammar.clauses import Bare, starts_clause, take_clause
from edge.mission.language.grammar.flow import ENDING, THEN, Flow
from edge.mission.language.grammar.goal_tree import (
    AllOf,
    AnyOf,
    Goal,
    formula_of,
    held_until,
    names_in,
    steps,
    visits,
)
from edge.mission.language.grammar.joints import Joints
from edge.mission.language.grammar.meaning import ClauseMeaning, meaning_of
from edge.mission.language.grammar.not_commands import refuse_questions
from edge.mission.language.grammar.sequences import (
    anchor_goals,
    chain_waits,
    insert_detour,
    order_before_return,
    put_first,
    put_last,
    remove_last_goals,
    repeat_visit,
    rules_of_each_at_most,
    rules_of_only_then,
    rules_of_strict_order,
    sequence_goal,
    single_visits,
    split_return,
)
from edge.mission.language.words.lexicon import AVOIDING
from edge.mission.language.words.noun_phrases import ONE_OF_A_KIND, Antecedents, NounPhrase
from edge.mission.language.words.tokens import Token, TokenReader
from edge.mission.logic.ltl import TRUE, Formula, postorder

MAX_NODES = 20_000
"""Largest size of a formula. "a and b, then c and d, then …" doubles the size with every step."""


def _tree_size(formula: Formula) -> int:
    """Return the number of nodes of the formula as a tree; shared parts count each time."""
    sizes: dict[int, int] = {}
    for f in postorder(formula):
        sizes[id(f)] = 1 + sum(sizes[id(arg)] for arg in f.args)
    return sizes[id(formula)]


@dataclass(slots=True)
class Discourse:
    """The state of the parser for one instruction."""

    reader: TokenReader
    memory: Antecedents = field(default_factory=Antecedents)
    goal: Goal | None = None  # the goal so far
    # rules that hold throughout, in every alternative
    rules: list[ClauseMeaning] = field(default_factory=list)
    asks: bool = False  # True if something was asked for without an upper limit
    times: dict[str, int] = field(default_factory=dict)  # how often each name was asked for
    last: NounPhrase | None = None  # objects of the last clause with a goal
    first: bool = False  # True if the last clause said "first", so that later goals come after it
    clauses: int = 0  # number of clauses so far
    flow: Flow = field(default_factory=Flow)  # facts about the last clause
    joints: Joints = field(default_factory=Joints)
    # first token of a clause that names only exceptions ("go anywhere but to a")
    elsewhere: Token | None = None
    # token of a sentence that is on the way to the goal of the sentence before
    detour: Token | None = None
    # True if something must be avoided, not only until something else is reached
    shuns: bool = False
    # pairs of names and the objects that must be reached before them
    waits: list[tuple[tuple[str, ...], NounPhrase]] = field(default_factory=list)
    listed: bool = False  # True if an order followed "do not …" and a comma
    # largest number of visits to each place, and the token of that limit
    each: tuple[int, Token] | None = None
    strictly: Token | None = None  # token of a ban on visits out of turn

    def formula(self) -> Formula:
        """Parse all sentences and return the formula.

        A sentence that begins with "then" continues the one before it.
        """
        reader = self.reader
        reader.skip("comma", "stop")
        while not reader.is_at("end"):
            is_filler = reader.is_at("filler") and reader.is_at("comma", "stop", "end", ahead=1)
            if is_filler or reader.is_at("addressed"):  # "Drone, find …", "thanks."
                reader.at += 1
                reader.skip("comma", "stop")
                continue
            if self.clauses and reader.is_at("any order") and reader.is_at("stop", "end", ahead=1):
                reader.take("any order")  # "…; the order does not matter": as it is anyway
            else:
                joint = reader.take(*THEN, "and", "but")
                reader.skip("comma")
                if joint is None:
                    refuse_questions(reader)
                self._take_sentence(joint)
            reader.skip("comma", "stop")
        if self.first and self.clauses > 1:
            firsts = [token for token in reader.tokens if token.kind in ("first", "opener")]
            hint = "say in the same sentence what comes after it"
            reader.refuse(hint, firsts[-1] if firsts else None)
        parts = [] if self.goal is None else [self.goal]
        parts += [sequence_goal([rule], reader) for rule in self.rules]
        if self.goal is None and self.elsewhere:
            reader.refuse("say what is to be reached", self.elsewhere)
        if not self.asks:
            parts += self._goals_of_rules()
        parts += self._rules_for_all(AllOf(tuple(part for part in parts if names_in(part))))
        formula = formula_of(AllOf(tuple(parts)))
        if _tree_size(formula) > MAX_NODES:
            reader.refuse("the formula would be too large; ask for less at once", reader.tokens[0])
        if formula == TRUE:
            hint = "nothing is asked for; say for example 'visit the bed, then the chair'"
            reader.refuse(hint, reader.tokens[0])
        return formula

    def _goals_of_rules(self) -> list[Goal]:
        """Return the goals that an instruction with rules only may ask for.

        `Do not go to b until a` may ask for nothing, for a, or for both.
        """
        if not self.waits:
            return []
        if self.goal is None and not self.shuns and (chain := chain_waits(self.waits)):
            return [chain]
        # 0: it asks for nothing; 1: for a; 2: for a and b.
        way = self.reader.pick(self.reader.tokens[0], 2 if self.shuns else 3)
        asked = [until for _, until in self.waits] if way else []
        if way == 2:
            asked += [NounPhrase(tuple((n,) for n in names)) for names, _ in self.waits]
        return [visits(targets) for targets in asked]

    def _rules_for_all(self, goal: AllOf) -> list[Goal]:
        """Return the rules that apply to all goals of the instruction."""
        rules: list[Formula] = []
        token = self.strictly or (self.each and self.each[1])
        if token and not goal.goals:
            self.reader.refuse("say first what to visit", token)
        if self.strictly:
            rules += rules_of_strict_order(goal, self.strictly, self.reader)
        if self.each:
            rules += rules_of_each_at_most(goal, *self.each, self.reader)
        return [AllOf((), tuple(rules))] if rules else []

    def _take_sentence(self, joint: Token | None) -> None:
        """Parse a sentence: sequences with "or" between them."""
        reader = self.reader
        either = reader.peek()
        self.detour, self.listed = None, False
        if reader.is_at("either") and reader.is_at("verb", "you", "first", ahead=1):
            reader.take("either")
        # True if the sentence comes after all goals so far.
        after = self.first or (joint is not None and joint.kind in THEN)
        start = reader.peek()
        before = self.last
        sequence, loose = self._take_sequence(joint)
        after = after or (bool(sequence) and sequence[0].follows)
        if joint is not None and joint.kind == "only then" and before and sequence:
            sequence[0].rules += held_until(sequence[0].targets.names, before)
        if after and before and sequence and sequence[0].loose:
            sequence[0].ban_after(before)  # "… . Afterwards never go to the bed."
        sequences = [sequence]
        # Joints without a pause ("a or b, then c") leave open what "then" comes after. So does a
        # short alternative, without a verb: "go to a and b, or c, then d".
        no_pause = short = False
        while (ahead := self._alternative_ahead()) is not None:
            short = short or (reader.is_at("comma") and not reader.is_at("verb", ahead=ahead))
            no_pause = no_pause or not reader.is_at("comma", "stop")
            reader.at += ahead
            if loose:
                sequences[-1].append(loose)
            sequence, loose = self._take_sequence(Token("or", "or", 0, 0))
            sequences.append(sequence)
        tokens = reader.tokens[reader.tokens.index(either) : reader.at]
        if either.text == "either" and not any(token.kind == "or" for token in tokens):
            reader.refuse("'either' needs a second choice", either)
        if loose:
            self.rules.append(loose)
        single = all(len(earlier) == 1 for earlier in sequences[:-1])
        pairs = itertools.pairwise(tokens)
        comma_then = any(a.kind == "comma" and b.kind in THEN for a, b in pairs)
        has_either = either.text == "either" and len(sequences) > 1
        unclear = no_pause or (comma_then and (short or has_either))
        if unclear and single and len(sequences[-1]) > 1:
            reader.refuse_finally("unclear what comes after which; use two sentences", start)
        if len(sequences) > 1:
            if any(step.commas for step in sequences[0]):
                hint = "unclear what the alternatives are; say 'either … or …'"
                reader.refuse_finally(hint, start)
            if self.listed or any(step.bans for step in sequences[-1]):
                reader.refuse_finally("unclear what is forbidden; use a separate sentence", start)
            if not all(any(step.goals for step in one) for one in sequences):
                reader.refuse("each alternative needs something to reach", start)
        if not sequence:
            return
        options = tuple(sequence_goal(alternative, reader) for alternative in sequences)
        goal = options[0] if len(options) == 1 else AnyOf(options)
        # The sentence goes before, into, or after the goal so far.
        ahead_of_all = self.first and joint is not None and joint.kind == "but"  # "But first …"
        if self.goal is None:
            self.goal = goal
        elif ahead_of_all and not after and len(sequences) == 1:
            self.goal, self.first = steps([goal, self.goal]), False
        elif self.detour and not after and len(sequences) == 1:
            self.goal = insert_detour(self.goal, goal, self.detour, reader)
        else:
            if after and sequence[0].returns:
                self.goal = order_before_return(self.goal, sequence[0])
            self.goal = steps([self.goal, goal]) if after else AllOf((self.goal, goal))

    def _alternative_ahead(self) -> int | None:
        """Return the number of tokens up to the next alternative ("; or reach …"), or None."""
        ahead = 1 if self.reader.is_at("comma", "stop") else 0
        if not self.reader.is_at("or", ahead=ahead):
            return None
        ahead += 1
        return ahead if starts_clause(self.reader, ahead) else None

    def _take_sequence(
        self, joint: Token | None
    ) -> tuple[list[ClauseMeaning], ClauseMeaning | None]:
        """Parse a sequence of steps with "then" between them.

        Returns:
            The steps, and the rules at the end that belong to no step; None if there are none.
        """
        sequence: list[ClauseMeaning] = []
        loose: ClauseMeaning | None = None
        order_token: Token | None = None
        while True:
            self.joints.check_number(self.reader, joint, bool(self.clauses))
            clause, meaning = self._take_clause(joint, sequence)
            kind = joint.kind if joint else ""
            # Rules without a goal wait until the next step, or the end, shows where they belong.
            if meaning.loose and kind != "but" and not meaning.follows:
                if loose is not None:
                    loose.add(meaning)
                loose = loose or meaning
            else:
                if loose is not None:
                    forbidden = {name for names in loose.bans for name in names}
                    if not sequence and kind == "and" and forbidden & set(meaning.targets.names):
                        hint = "the same object is forbidden and asked for"
                        self.reader.refuse(hint, clause.token)
                    if not sequence:
                        loose.limit_for_good()
                    (sequence[-1] if sequence else meaning).add(loose)
                    loose = None
                self._add_to_sequence(clause, meaning, kind, sequence)
            has_order = clause.order in ("in order", "strict order")
            if has_order and clause.targets and len(clause.targets.groups) + len(clause.route) < 2:
                order_token = clause.token
            joint = self.joints.take(self.reader, self.flow, bool(self.clauses))
            if joint is None:
                if order_token:
                    hint = "an order goes with a list: 'visit a, then b'"
                    self.reader.refuse(hint, order_token)
                return sequence, loose

    def _count_return(
        self, clause: Clause, meaning: ClauseMeaning, sequence: list[ClauseMeaning]
    ) -> None:
        """Turn "…, and later visit it again" into a second visit."""
        again = clause.targets and self.last and clause.targets.groups == self.last.groups
        revisits = clause.again and clause.verb and meaning.follows and not clause.returns
        revisits = revisits and not clause.conditions
        if not revisits or clause.negated or not meaning.goals or not again or not sequence:
            return
        count = clause.count or Count(1)
        most = None if count.most is None else count.most + 1
        count = Count(count.least + 1, most)
        repeat_visit(sequence[-1], self.last, count, clause.token, self.reader)
        meaning.repeats = True

    def _take_clause(
        self, joint: Token | None, sequence: list[ClauseMeaning]
    ) -> tuple[Clause, ClauseMeaning]:
        """Parse the next clause; return it and its meaning after the clauses before it."""
        # If a clause without a verb may come: after "and" or "then" it may.
        bare: Bare = "known" if not self.clauses else "no"
        if self.clauses and joint and joint.kind and not self.flow.denied:
            bare = "yes"
        if self.joints.halted:
            self.reader.refuse(
                "the mission ends where the robot stops; say this last", self.joints.halted
            )
        clause = take_clause(self.reader, self.memory, bare)
        self.listed = self.listed or self.flow.lists(clause, joint)
        then = self._comes_after(clause, joint, sequence)
        self.flow.refuse_joined(clause, joint, bool(self.clauses), self.reader)
        self._resolve(clause, joint.kind if joint else "", then, sequence)
        meaning = meaning_of(clause, self.reader, self.times)
        meaning.follows, meaning.returns = then, clause.returns
        self._relate(clause, meaning, sequence)
        # Refuse a goal in the plural, such as "the chairs".
        for name in {name for goal in meaning.goals for name in names_in(goal)}:
            if several := self.memory.several.get(name):
                self.reader.refuse_finally(ONE_OF_A_KIND, several)
        if then and self.flow.barred and meaning.goals and not sequence and joint:
            self.reader.refuse_finally("unclear what is forbidden; use two sentences", clause.token)
        self.flow.note(clause, meaning)
        self._remember(clause, meaning)
        return clause, meaning

    def _comes_after(
        self, clause: Clause, joint: Token | None, sequence: list[ClauseMeaning]
    ) -> bool:
        """Return True if a clause comes after everything that was asked for before it."""
        if self.flow.permitted and not clause.conditions and clause.mood == "must":
            goes_on = joint is not None and joint.kind in THEN
            clause.trails = clause.trails or clause.next_step or goes_on
        if clause.trails:
            self._after_permission(clause, bool(sequence))
        asked = self.goal is not None
        then = self.flow.comes_after(clause, joint, sequence, asked, self.reader)
        if clause.again and clause.targets and not (clause.negated or clause.count):
            then = then or bool(self.times.keys() & set(clause.targets.names))
        if clause.ends:  # it comes after all other goals
            if clause.negated:
                self.reader.refuse("say it in one sentence, with 'then'", clause.token)
            self.joints.halted, then = clause.token, then or bool(sequence) or asked
        stays = clause.returns and then and not clause.negated
        if stays and clause.targets == self.last:
            hint = "the robot is already there at that time; say where to go"
            self.reader.refuse_finally(hint, clause.token)
        return then

    def _resolve(
        self, clause: Clause, joint_kind: str, then: bool, sequence: list[ClauseMeaning]
    ) -> None:
        """Resolve what a clause leaves open, from the clauses before it."""
        if clause.elsewhere:
            self.elsewhere = clause.token
        single = clause.targets is not None and len(clause.targets.groups) + len(clause.route) == 1
        if single and sequence and clause.order == "strict order" and not clause.negated:
            clause.order, self.strictly = "", clause.token  # "a, then b in this exact order"
        if clause.separate_count and sequence:
            hint = "unclear: this number for all, or for the last one? use two sentences"
            self.reader.refuse_finally(hint, clause.token)
        allowed = then and clause.mood == "can" and not clause.negated
        if allowed and (joint_kind == "only then" or self.reader.pick(clause.token, 2) == 0):
            clause.mood = "do"  # "visit a, then you can go to b" may ask for b
        limits = joint_kind == "but" and clause.verb == "" and bool(clause.conditions)
        named = {*self.times, *(self.last.names if self.last else ())}
        repeats = clause.targets is not None and set(clause.targets.names) <= named
        if limits and all(c.only for c in clause.conditions) and repeats:
            clause.mood = "can"  # "visit a or b, but b only after c"

    def _relate(
        self, clause: Clause, meaning: ClauseMeaning, sequence: list[ClauseMeaning]
    ) -> None:
        """Relate the meaning of a clause to the goals before it."""
        then = meaning.follows
        if then and meaning.bans and not meaning.goals and not clause.targets.every:
            if self.last is None:
                self.reader.refuse_finally("say first what comes before this", clause.token)
            meaning.ban_after(self.last)  # "…. After that, avoid b and go to c"
        if then and clause.negated and clause.conditions:
            self.reader.refuse_finally("use a separate sentence, without 'then'", clause.token)
        ends = clause.ends or (clause.verb.startswith(ENDING) and not clause.negated)
        if ends and meaning.goals and sequence:
            put_last(meaning, sequence)
        elif ends and meaning.goals and self.goal is not None:
            self.goal = remove_last_goals(self.goal, meaning)
        if then and meaning.goals and self.flow.until and not sequence:
            meaning.goals = [steps([visits(self.flow.until), *meaning.goals])]
        anchored = meaning.anchors and not (then or self.first)
        if anchored and self.times.keys() & set(meaning.targets.names):
            hint = "this was already asked for; give the order in one sentence"
            self.reader.refuse(hint, clause.token)
        anchor_goals(meaning, sequence, self.times, then or self.first)
        plain = not (clause.count or clause.again or clause.conditions or clause.avoiding)
        meaning.repeats = plain and bool(meaning.goals) and clause.targets == self.last
        if meaning.repeats and then:  # "a, then b, then b and c": is b meant twice?
            meaning.repeats = self.reader.pick(clause.token, 2) == 1
        self._count_return(clause, meaning, sequence)

    def _remember(self, clause: Clause, meaning: ClauseMeaning) -> None:
        """Store what later clauses may refer to."""
        if meaning.each:
            self.each = (meaning.each, clause.token)
        self.strictly = clause.token if meaning.strictly else self.strictly
        limited = clause.count is not None and clause.count.most is not None
        self.asks = self.asks or (bool(meaning.goals) and not limited)
        self.last = clause.targets if meaning.goals else self.last
        self.waits += meaning.waits
        self.shuns = self.shuns or clause.verb in AVOIDING
        self.clauses += 1
        for goal in meaning.goals:
            for visit in single_visits(goal):
                self.times |= dict.fromkeys(visit.options, visit.times)
                self.memory.note([visit.options])

    def _add_to_sequence(
        self, clause: Clause, meaning: ClauseMeaning, joint_kind: str, sequence: list[ClauseMeaning]
    ) -> None:
        """Add a clause as a new step, or as a part of the last step."""
        if clause.returns and len(sequence) == 1:
            split_return(meaning, sequence)
        if joint_kind == "only then" and sequence:
            meaning.rules += rules_of_only_then(sequence[-1], meaning)
        if clause.enroute and not sequence:
            if self.goal is None:
                self.reader.refuse_finally("unclear where to; say 'on the way to …'", clause.token)
            self.detour = clause.token  # "go to a. on the way, go to b"
        ends = len(sequence) == 1 and not meaning.follows and self.reader.is_at("stop", "end")
        first = clause.first and (joint_kind == "but" or ends)  # "visit a, visit b first"
        if (first or clause.enroute) and sequence and meaning.goals:
            put_first(meaning, sequence, clause.first)  # "…, but first go to the sofa"
            clause.first = False
        elif meaning.repeats and sequence:
            pass
        elif not sequence or meaning.follows or (self.first and not meaning.loose):
            sequence.append(meaning)
        else:
            sequence[-1].add(meaning, joint_kind)
        self.first = clause.first and not meaning.loose

    def _after_permission(self, clause: Clause, started: bool) -> None:
        """Apply `you can visit a, but you must visit b after that`: b only after a."""
        if not self.flow.permitted and clause.negated and not started:
            self.flow.permitted = self.memory.asked
        if clause.conditions:
            clause.trails = False  # "once you visit a, you must visit b after that"
        elif self.flow.permitted:
            clause.conditions.append(Condition("after", clause.token, self.flow.permitted))
            clause.trails = False
        elif not self.clauses:
            self.reader.refuse("no step comes before this one", clause.token)
