"""The exact optimum of the paper's executor against policy iteration on the model written out."""

from __future__ import annotations

import math
from itertools import chain, combinations

import networkx as nx
import numpy as np
import pytest

from edge.lab.eval.planning.executor import DONE, PlannerInput, PlanningProblem
from edge.lab.eval.planning.executor import NOTHING as WAIT
from edge.lab.eval.planning.optimum import Optimum
from edge.mission.logic.automaton import NOTHING, compile_formula
from edge.mission.logic.ltl import parse

CASE_2 = (
    "(F(couch & F(toilet & F(bed & F chair))) | F(bed & F(plant | toilet))"
    " | F(tv & F(plant & F couch))) & (!couch W toilet) & (!bed W tv) & (!plant W chair)"
)


class Exploration:
    """The executor of ViTL V-C as a Markov decision process, written out.

    A node is (state, known propositions, objects outside the formula that were not met).
    """

    def __init__(self, automaton, p_obs, extra=0):
        self.a, self.p_obs = automaton, p_obs
        self.propositions = automaton.propositions
        subsets = chain.from_iterable(
            combinations(self.propositions, r) for r in range(len(self.propositions) + 1)
        )
        known = [frozenset(x) for x in subsets]
        self.nodes = [
            (s, k, e) for s in range(automaton.n_states) for k in known for e in range(extra + 1)
        ]

    def outcomes(self, node, proposition):
        """(cost, [(probability, next node)])."""
        s, known, extra = node
        after = self.a.step(s, proposition)
        if proposition == NOTHING:
            return 1e-6, [(1.0, (after, known, extra))]
        if proposition in known:
            return 1e-5, [(1.0, (after, known, extra))]
        others = [x for x in self.propositions if x not in known and x != proposition]
        n = len(others) + extra
        out = [(self.p_obs, (after, known | {proposition}, extra))]
        if n == 0:
            return 1.0, [*out, (1 - self.p_obs, node)]
        out += [((1 - self.p_obs) / n, (s, known | {x}, extra)) for x in others]
        if extra:
            out.append(((1 - self.p_obs) * extra / n, (s, known, extra - 1)))
        return 1.0, out

    def evaluate(self, policy):
        """Return the expected cost by node of a proper policy; acceptance is free."""
        index = {node: i for i, node in enumerate(policy)}
        matrix, cost = np.eye(len(index)), np.zeros(len(index))
        for node, i in index.items():
            cost[i], outcomes = self.outcomes(node, policy[node])
            for p, after in outcomes:
                if not self.a.accepting[after[0]]:
                    matrix[i, index[after]] -= p
        return dict(zip(index, np.linalg.solve(matrix, cost), strict=True))

    def optimum(self):
        """Policy iteration from a policy that comes nearer to acceptance with each success."""
        policy = {}
        for node in self.nodes:
            s = node[0]
            steps = [(self._left(self.a.step(s, x)), x) for x in (*self.propositions, NOTHING)]
            if not self.a.accepting[s] and self._left(s) < math.inf:
                policy[node] = min(steps)[1]
        while policy:
            value = self.evaluate(policy)
            better = dict(policy)
            for node in policy:
                best = value[node] - 1e-9
                for x in (*self.propositions, NOTHING):
                    q = self.cost(node, x, value)
                    if q < best:
                        best, better[node] = q, x
            if better == policy:
                return value
            policy = better
        return {}

    def cost(self, node, proposition, value):
        """Return the expected cost of one step and then of `value`; inf for a dead end."""
        cost, outcomes = self.outcomes(node, proposition)
        return cost + sum(
            p * (0.0 if self.a.accepting[after[0]] else value.get(after, math.inf))
            for p, after in outcomes
            if p > 0.0
        )

    def _left(self, state):
        if not hasattr(self, "_steps"):
            graph = nx.DiGraph()
            graph.add_nodes_from(range(self.a.n_states))
            for s in range(self.a.n_states):
                graph.add_edges_from((self.a.step(s, x), s) for x in (*self.propositions, NOTHING))
            goals = set(np.flatnonzero(self.a.accepting).tolist())
            self._steps = (
                nx.multi_source_dijkstra_path_length(graph, goals, weight=None) if goals else {}
            )
        return self._steps.get(state, math.inf)


def problem_of(text: str, others: int = 0) -> PlanningProblem:
    return PlanningProblem.of(compile_formula(parse(text)), others)


@pytest.mark.parametrize(("text", "best"), [("true", DONE), ("F a & G !a", DONE), ("X a", WAIT)])
def test_nothing_to_go_to(text, best):
    assert Optimum(problem_of(text), 0.5).choose(PlannerInput(0)) == best


def test_searching_for_another_object_can_be_the_better_choice():
    """At p_obs = 0.1 the tv's attempt, which serves nothing else, shows the chair 9 times of 10."""
    problem = problem_of("F chair & (F tv | true)")
    propositions = problem.automaton.propositions
    assert propositions[Optimum(problem, 0.1).choose(PlannerInput(0))] == "tv"
    assert propositions[Optimum(problem, 0.5).choose(PlannerInput(0))] == "chair"


@pytest.mark.parametrize(
    ("text", "others", "p_obs"),
    [
        *(
            (text, others, p_obs)
            for text in ("F a & F b & F c", "F((chair | couch) & F tv)", "F a & F b & G !c", "X a",
                         "(!b W a) & F b", "F(a & X(b & F a))", "G(a -> X F b) & F a")
            for others, p_obs in ((0, 0.35), (2, 0.1), (2, 1.0))
        ),
        (CASE_2, 0, 0.35),
    ],
)  # fmt: skip
def test_optimal_costs_agree_with_policy_iteration(text, others, p_obs):
    problem = problem_of(text, others)
    propositions = problem.automaton.propositions
    found = Optimum(problem, p_obs).value
    exact = Exploration(problem.automaton, p_obs, others).optimum()
    assert len(exact) > 0 or problem.accepting[0]
    for (state, known, extra), cost in exact.items():
        place = sum(1 << propositions.index(x) for x in known), extra, state
        assert found[place] == pytest.approx(cost, abs=1e-6)
