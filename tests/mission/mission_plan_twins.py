"""References for the planners' tests: plain graphs and random automata."""

from __future__ import annotations

import heapq
import math

import networkx as nx
import numpy as np
from hypothesis import strategies as st

from edge.mission.logic.automaton import NOTHING, Automaton, compile_formula
from edge.mission.logic.ltl import TRUE, parse
from edge.mission.planning.plan import MissionKnowledge

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


def knowing(detected=(), reached=(), failed=(), distance_m=None) -> MissionKnowledge:
    return MissionKnowledge(frozenset(detected), frozenset(reached), frozenset(failed), distance_m)


def table_automaton(delta: list[list[int]], accepting: list[bool]) -> Automaton:
    """Build an automaton from a transition table over the propositions a, b, c and so on."""
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
def automata(draw, max_states: int = 7, max_propositions: int = 4) -> Automaton:
    n, k = draw(st.integers(1, max_states)), draw(st.integers(0, max_propositions))
    row = st.lists(st.integers(0, n - 1), min_size=k + 1, max_size=k + 1)
    delta = draw(st.lists(row, min_size=n, max_size=n))
    return table_automaton(delta, draw(st.lists(st.booleans(), min_size=n, max_size=n)))


@st.composite
def knowledge_of(draw, propositions: tuple[str, ...]) -> MissionKnowledge:
    sets: dict[str, set[str]] = {"detected": set(), "reached": set(), "failed": set()}
    for proposition in propositions:
        kind = draw(st.sampled_from([None, *sets]))
        if kind is not None:
            sets[kind].add(proposition)
    return knowing(**sets)


def eq_1(proposition: str, k: MissionKnowledge, w_det: float) -> float:
    """Return the weight of a proposition; inf if it failed."""
    if proposition == NOTHING:
        return W_NOTHING
    if proposition in k.failed:
        return math.inf
    return w_det if proposition in k.detected | k.reached else 1.0


def shortest(automaton: Automaton, state: int, weight) -> tuple[float, int]:
    """Least cost and, among those paths, fewest steps to acceptance, by networkx.

    Args:
        automaton: of the mission.
        state: first state.
        weight: (proposition before or None, proposition) -> float, inf = not to be taken.
    """
    graph, start = nx.DiGraph(), (state, None)
    graph.add_node(start)
    queue, seen = [start], {start}
    while queue:
        node = queue.pop()
        for proposition, t in automaton.edges(node[0]):
            w = weight(node[1], proposition)
            if math.isinf(w) or t == node[0]:
                continue
            after = (t, node[1] if proposition == NOTHING else proposition)
            w = round(w * 1e6) + 1e-4  # one more step costs least
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
