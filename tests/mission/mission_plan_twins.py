"""What the planners' tests measure against: plain graphs, policy iteration, random automata."""

from __future__ import annotations

import heapq
import math
from itertools import chain, combinations

import networkx as nx
import numpy as np
from hypothesis import strategies as st

from edge.mission.automaton import NOTHING, Automaton, compile_formula
from edge.mission.ltl import TRUE, parse
from edge.mission.planning.plan import Knowledge

W_NOTHING = 1e-6
CHOICE = "F((chair | couch) & F tv)"
CASE_1 = (
    "(F(toilet & F bed) | F(couch & F chair) | F(plant & F tv))"
    " & (!tv W bed) & (!toilet W couch) & (!couch W tv)"
)
CASE_2 = (
    "(F(couch & F(toilet & F(bed & F chair))) | F(bed & F(plant | toilet))"
    " | F(tv & F(plant & F couch))) & (!couch W toilet) & (!bed W tv) & (!plant W chair)"
)


def compiled(text: str) -> Automaton:
    return compile_formula(parse(text))


def knowing(detected=(), reached=(), failed=(), distance_m=None) -> Knowledge:
    return Knowledge(frozenset(detected), frozenset(reached), frozenset(failed), distance_m)


def table_automaton(delta: list[list[int]], accepting: list[bool]) -> Automaton:
    """An automaton of a transition table; its letters are a, b, c …"""
    delta, accepting = np.array(delta, np.int32), np.array(accepting)
    n, k = delta.shape[0], delta.shape[1] - 1
    graph = nx.DiGraph()
    graph.add_nodes_from(range(n))
    for s in range(n):
        for c in range(k + 1):
            t, w = int(delta[s, c]), int(c < k)
            if not graph.has_edge(t, s) or graph[t][s]["weight"] > w:
                graph.add_edge(t, s, weight=w)
    goals = set(np.flatnonzero(accepting).tolist())
    left = nx.multi_source_dijkstra_path_length(graph, goals) if goals else {}
    steps_left = np.array([left.get(s, -1) for s in range(n)], np.int32)
    return Automaton(TRUE, tuple("abcdefgh"[:k]), delta, accepting, steps_left)


@st.composite
def automata(draw, max_states: int = 7, max_letters: int = 4) -> Automaton:
    n, k = draw(st.integers(1, max_states)), draw(st.integers(0, max_letters))
    row = st.lists(st.integers(0, n - 1), min_size=k + 1, max_size=k + 1)
    delta = draw(st.lists(row, min_size=n, max_size=n))
    return table_automaton(delta, draw(st.lists(st.booleans(), min_size=n, max_size=n)))


@st.composite
def knowledge_of(draw, letters: tuple[str, ...]) -> Knowledge:
    sets: dict[str, set[str]] = {"detected": set(), "reached": set(), "failed": set()}
    for letter in letters:
        kind = draw(st.sampled_from([None, *sets]))
        if kind is not None:
            sets[kind].add(letter)
    return knowing(**sets)


def eq_1(letter: str, k: Knowledge, w_det: float, known_reached: bool) -> float:
    """The weight of a letter; inf if it failed."""
    if letter == NOTHING:
        return W_NOTHING
    if letter in k.failed:
        return math.inf
    return w_det if letter in k.detected or (known_reached and letter in k.reached) else 1.0


def shortest(automaton: Automaton, state: int, weight) -> tuple[float, int]:
    """Least cost and, among those paths, fewest steps to acceptance, by networkx.

    Args:
        weight: (letter before or None, letter) -> float, inf = not to be taken.
    """
    graph, start = nx.DiGraph(), (state, None)
    graph.add_node(start)
    queue, seen = [start], {start}
    while queue:
        node = queue.pop()
        for letter, t in automaton.edges(node[0]):
            w = weight(node[1], letter)
            if math.isinf(w) or t == node[0]:
                continue
            after = (t, node[1] if letter == NOTHING else letter)
            w = round(w * 1e6) + 1e-4  # one step more is dearer than nothing else
            if not graph.has_edge(node, after) or graph[node][after]["weight"] > w:
                graph.add_edge(node, after, weight=w)
            if after not in seen:
                seen.add(after)
                queue.append(after)
    far = nx.single_source_dijkstra_path_length(graph, start)
    best = min((d for (s, _), d in far.items() if automaton.accepting[s]), default=math.inf)
    return (
        (math.inf, 0) if math.isinf(best) else (int(best) / 1e6, round((best - int(best)) / 1e-4))
    )


class Exploration:
    """The executor of ViTL V-C as a Markov decision process, written out.

    A node is (state, known letters, objects outside the formula that were not met).
    """

    def __init__(self, automaton, p_obs, w_det, extra=0, failed=()):
        self.a, self.p_obs, self.w_det = automaton, p_obs, w_det
        self.letters = [x for x in automaton.letters if x not in failed]
        subsets = chain.from_iterable(
            combinations(self.letters, r) for r in range(len(self.letters) + 1)
        )
        known = [frozenset(x) for x in subsets]
        self.nodes = [
            (s, k, e) for s in range(automaton.n_states) for k in known for e in range(extra + 1)
        ]

    def actions(self, node):
        return (*self.letters, NOTHING)

    def outcomes(self, node, letter):
        """(cost, [(probability, next node)])."""
        s, known, extra = node
        after = self.a.step(s, letter)
        if letter == NOTHING:
            return W_NOTHING, [(1.0, (after, known, extra))]
        if letter in known:
            return self.w_det, [(1.0, (after, known, extra))]
        others = [x for x in self.letters if x not in known and x != letter]
        n = len(others) + extra
        out = [(self.p_obs, (after, known | {letter}, extra))]
        if n == 0:
            return 1.0, [*out, (1 - self.p_obs, node)]
        out += [((1 - self.p_obs) / n, (s, known | {x}, extra)) for x in others]
        if extra:
            out.append(((1 - self.p_obs) * extra / n, (s, known, extra - 1)))
        return 1.0, out

    def evaluate(self, policy):
        """Expected cost by node of a proper policy; acceptance is free."""
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
            steps = [(self._left(self.a.step(s, x)), x) for x in (*self.letters, NOTHING)]
            if not self.a.accepting[s] and self._left(s) < math.inf:
                policy[node] = min(steps)[1]
        while policy:
            value = self.evaluate(policy)
            better = dict(policy)
            for node in policy:
                best = value[node] - 1e-9
                for x in self.actions(node):
                    q = self.cost(node, x, value)
                    if q < best:
                        best, better[node] = q, x
            if better == policy:
                return value
            policy = better
        return {}

    def cost(self, node, letter, value):
        """Expected cost of one step and then of `value`; inf where that leads nowhere."""
        cost, outcomes = self.outcomes(node, letter)
        return cost + sum(
            p * (0.0 if self.a.accepting[after[0]] else value.get(after, math.inf))
            for p, after in outcomes
            if p > 0.0
        )

    def _left(self, state):
        """Steps to acceptance with the usable letters."""
        if not hasattr(self, "_steps"):
            graph = nx.DiGraph()
            graph.add_nodes_from(range(self.a.n_states))
            for s in range(self.a.n_states):
                graph.add_edges_from((self.a.step(s, x), s) for x in (*self.letters, NOTHING))
            goals = set(np.flatnonzero(self.a.accepting).tolist())
            self._steps = (
                nx.multi_source_dijkstra_path_length(graph, goals, weight=None) if goals else {}
            )
        return self._steps.get(state, math.inf)


class Search(Exploration):
    """The robot: whatever it searches for, unknown objects are seen as the first of independent
    exponential waits, of mean 1 / p. "?x" searches for x and does not go there when it is seen."""

    def actions(self, node):
        s, known, _ = node
        may = [x for x in self.letters if self._left(self.a.step(s, x)) < math.inf]
        return (*may, NOTHING, *(f"?{x}" for x in may if x not in known))

    def outcomes(self, node, letter):
        s, known, extra = node
        if letter == NOTHING or letter in known:
            return super().outcomes(node, letter)
        target, goes = letter.lstrip("?"), not letter.startswith("?")
        rate = {x: self.rate(x, known) for x in self.letters if x not in known}
        total = sum(rate.values())
        after = {x: self.a.step(s, x) if goes and x == target else s for x in rate}
        return 1.0 / total, [(r / total, (after[x], known | {x}, extra)) for x, r in rate.items()]

    def rate(self, letter, known):
        return self.p_obs


HERE = "here"


class MetreSearch(Exploration):
    """The robot, in metres: a node is (state, known letters, place, 0), places are letters and
    `HERE`; a search ends near whatever is seen first.

    Args:
        way_m, search_m: by place, and letter; by place, target and letter.
    """

    def __init__(self, automaton, way_m, search_m, known=(), failed=()):
        super().__init__(automaton, 1.0, 0.0, 0, failed)
        self.way_m, self.search_m = way_m, search_m
        sets = {k | frozenset(known) for _, k, _ in self.nodes}
        self.nodes = [
            (s, k, place)
            for s in range(automaton.n_states) for k in sets for place in (HERE, *k)
        ]  # fmt: skip

    def actions(self, node):
        s, known, _ = node
        useful = [x for x in self.letters if self.a.step(s, x) != s]
        hopeful = [x for x in useful if self._left(self.a.step(s, x)) < math.inf]
        return (*(x for x in self.letters if x in known or x in hopeful), NOTHING)

    def outcomes(self, node, letter):
        s, known, place = node
        if letter == NOTHING:
            return W_NOTHING, [(1.0, (self.a.step(s, letter), known, place))]
        if letter in known:
            return self.way_m[place, letter], [(1.0, (self.a.step(s, letter), known, letter))]
        left = [x for x in self.letters if x not in known]
        rate = {x: 1.0 / self.search_m[place, letter, x] for x in left}
        total = sum(rate.values())
        return 1.0 / total, [(r / total, (s, known | {x}, x)) for x, r in rate.items()]


def plain_tours(way_m, between_m, worth, behind, start_m):
    """Of `belief.tours`, the tours by sorting what is left."""
    k, n = worth.shape
    out = np.zeros((len(way_m), k, k))
    for p, target in np.ndindex(len(way_m), k):
        left, at, walked_m = list(range(n)), way_m[p], 0.0
        while left:
            nearest = max(left, key=lambda i: (worth[target, i] / (start_m + at[i]), -i))
            walked_m += at[nearest]
            out[p, target] += behind[:, nearest] * walked_m
            left.remove(nearest)
            at = between_m[nearest]
    return out


def grid_dijkstra(state, step, starts):
    """Distances of `distances.wavefront`, with a heap."""
    h, w = state.shape
    out = np.full((h, w), np.iinfo(np.int32).max, np.int64)
    heap = [(int(cost), *divmod(int(c), w)) for c, cost in starts]
    for cost, r, c in heap:
        out[r, c] = min(out[r, c], cost)
    heapq.heapify(heap)
    while heap:
        d, r, c = heapq.heappop(heap)
        if d > out[r, c]:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                q, p = r + dr, c + dc
                if (dr, dc) == (0, 0) or state[q, p] == 0:
                    continue
                if dr and dc and (state[r, p] == 0 or state[q, c] == 0):
                    continue
                there = d + int(step[int(bool(dr and dc)), state[q, p]])
                if there < out[q, p]:
                    out[q, p] = there
                    heapq.heappush(heap, (there, q, p))
    return out
