"""The expected-cost planner in metres: known objects are driven to, others are searched for.

What ways and searches cost comes from the survey of the map (`edge.mission.planning.belief`); the
plan with the least expected metres under that model is found exactly.
"""

from __future__ import annotations

import numpy as np

from edge.config import PlannerExpected, PlannerVitl
from edge.mission.automaton import NOTHING, Automaton
from edge.mission.planning import plan_kernels as kernels
from edge.mission.planning.belief import SIGHT_M
from edge.mission.planning.expected import MAX_LETTERS, PlannerError
from edge.mission.planning.plan import ACCEPTED, DEAD, Knowledge, Plan, explain, explain_kept
from edge.mission.planning.vitl import W_NOTHING, VitlPlanner, no_detours, working_order

MAX_VALUES = 1 << 17
"""Entries of the table of values: a MiB. The largest, seven objects in any order, takes about 5 ms
to solve, which a tick can bear: it comes with each survey, and gets less with each object seen."""
_LEAST_M = 1e-3
"""No way and no search is shorter: going round in circles must not be free."""


class ExpectedMetresPlanner:
    """Least expected metres to acceptance.

    The robot is where it is now, or at an object. Going to a known object costs the way to it.
    While the robot searches for an object, every one that is not known is seen at a rate of its
    own, 1 / `Knowledge.search_m`, whichever comes first; then the robot is near that one, and
    chooses anew. What is searched for decides where the search goes first, and so how soon each is
    seen. Only what would bring the mission on is searched for; an object whose reaching would make
    success impossible never is. Known are D and R; failed objects are neither available nor seen.

    Without a survey every way and every search takes `explore_m`. What was seen after the survey is
    near the robot. The current target is kept while what another one would save is in doubt: a
    known one unless another known one is better by more than `replan_margin_m`, any unless a
    search is better by more than `search_margin_m`; a search gives way to what is known and better
    at all. One thread at a time.
    """

    def __init__(self, config: PlannerExpected, automaton: Automaton) -> None:
        """
        Raises:
            PlannerError: the table of values would be too large.
        """
        k, n = len(automaton.letters), automaton.n_states
        values = n * (k + 1) << k
        if k > MAX_LETTERS or values > MAX_VALUES:
            raise PlannerError(
                f"mission.planner: 'expected' cannot take on a formula with {k} objects and {n} "
                f"states: {values} values by state, place and known objects (at most {MAX_VALUES} "
                f"and {MAX_LETTERS} objects); choose weights: constant, or kind: vitl"
            )
        self.config = config
        self.automaton = automaton
        self._order = working_order(automaton)
        self._value = np.empty((1 << k, k + 1, n))
        self._total = np.empty(n)
        self._first = np.empty(k + 1)

    def plan(self, state: int, knowledge: Knowledge, current: str | None = None) -> Plan:
        """See `Planner.plan`. `steps` is the way if every search finds its target first.

        Raises:
            ValueError: `distance_m` or `search_m` does not have the letters' shape.
        """
        a, here = self.automaton, len(self.automaton.letters)
        if a.accepting[state]:
            return ACCEPTED
        if a.steps_left[state] < 0:
            return DEAD
        usable = [i for i, x in enumerate(a.letters) if x not in knowledge.failed]
        seen = knowledge.detected | knowledge.reached
        known = np.array([i for i in usable if a.letters[i] in seen], np.int64)
        sought = np.array([i for i in usable if a.letters[i] not in seen], np.int64)
        value = self._value[: 1 << sought.size]
        model = sought, known, *self._metres(knowledge, known), W_NOTHING, value, self._total
        kernels.metre_costs(a.delta, a.accepting, self._order, *model)
        if not value[0, here, state] < np.inf:
            return VitlPlanner(PlannerVitl(), a).plan(state, knowledge, current)
        kernels.metre_first(a.delta, *model, state, here, 0, self._first)
        names = (*a.letters, NOTHING)
        cost = self._first.tolist()
        ranked = sorted((c for c in range(len(names)) if cost[c] < np.inf), key=cost.__getitem__)
        tied = [c for c in ranked if cost[c] <= cost[ranked[0]] + kernels.TOLERANCE]
        ways = {c: self._follow(model, state, c) for c in tied}
        tied.sort(key=lambda c: (len(ways[c]), names[c] != current, c))
        ranked[: len(tied)] = tied
        options = tuple((names[c], cost[c]) for c in ranked)
        first = best = ranked[0]
        reason = explain(names[best], options, knowledge, _text)
        for c in ranked[1:]:
            gain_m, margin_m = cost[c] - cost[best], self._margin_m(c in sought, best in sought)
            if names[c] == current and gain_m <= margin_m:
                first = c
                gain = _text(gain_m)
                reason = explain_kept(names[c], names[best], gain, f"{margin_m:.1f} m")
        steps = ways.get(first) or self._follow(model, state, first)
        return Plan(names[first] or None, steps, cost[first], True, (), reason, options)

    def _follow(self, model: tuple, state: int, first: int) -> tuple[str, ...]:
        """The way that begins with a letter; ties go to the first letter."""
        a, sought = self.automaton, model[0].tolist()
        letter, place, found, steps = first, len(a.letters), 0, []
        names, out = (*a.letters, NOTHING), np.empty_like(self._first)
        while True:
            steps.append(names[letter])
            state = a.delta[state, letter]
            if letter < len(a.letters):
                place = letter
                found |= 1 << sought.index(letter) if letter in sought else 0
            if a.accepting[state]:
                return tuple(steps)
            kernels.metre_first(a.delta, *model, state, place, found, out)
            letter = int(np.flatnonzero(out <= out.min() + kernels.TOLERANCE)[0])

    def _margin_m(self, searching: bool, for_a_search: bool) -> float:
        """By how much the best letter must be better than the current target's."""
        if for_a_search:
            return self.config.search_margin_m
        return 0.0 if searching else self.config.replan_margin_m

    def _metres(self, knowledge: Knowledge, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ways and searches of the model, all finite and over 0."""
        k, c = len(self.automaton.letters), self.config
        metres = []
        for name, shape in (("distance_m", (k + 1, k)), ("search_m", (k + 1, k, k))):
            given = getattr(knowledge, name)
            if given is None:
                given = np.full(shape, c.explore_m)
            if given.shape != shape:
                raise ValueError(f"{name}: expected shape {shape}, got {given.shape}")
            metres.append(np.maximum(np.where(np.isfinite(given), given, c.explore_m), _LEAST_M))
        way_m, search_m = metres
        np.fill_diagonal(way_m, np.minimum(way_m.diagonal(), SIGHT_M))
        if knowledge.distance_m is not None:
            new = known[knowledge.distance_m.diagonal()[known] == SIGHT_M]
            way_m[-1, new] = np.minimum(way_m[-1, new], SIGHT_M)
        no_detours(way_m)
        return way_m, search_m


def _text(cost_m: float) -> str:
    return f"about {cost_m:.1f} m"
