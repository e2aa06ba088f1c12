"""Missions over the objects of a world, and the shortest path to complete them."""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated import simulated

from edge.lab.eval import missions
from edge.lab.eval.missions import cost_to_go_cells, draw_missions
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse, propositions
from edge.mission.spec import prepare

OBJECTS = ("bed", "chair", "house plant", "sofa", "television", "toilet", "oven", "armchair")


@pytest.mark.parametrize("count", [2, 3, 8])
def test_missions_name_two_to_four_objects(count):
    drawn = draw_missions(OBJECTS[:count], 40, 1)
    assert len(drawn) > 5
    assert drawn == draw_missions(OBJECTS[:count], 40, 1)
    assert len({mission.formula for mission in drawn}) == len(drawn)
    for mission in drawn:
        named = propositions(mission.formula)
        assert 2 <= len(named) <= 4
        assert "" not in named


def test_the_service_reads_each_sentence_as_its_formula():
    drawn = draw_missions(OBJECTS, 60, 2)
    assert {mission.family for mission in drawn} == {f.name for f in missions.FAMILIES}
    for mission in drawn:
        spec = prepare(simulated({"mission": {"instruction": mission.sentence}}).mission)
        assert spec.translation.formula == mission.formula, mission.sentence


# --- the shortest way, against Dijkstra over (place, state) ---


def shortest(automaton, near, free, start):
    best = {(*start, 0): 0.0}
    heap = [(0.0, *start, 0)]
    while heap:
        d, r, c, s = heapq.heappop(heap)
        if d > best[r, c, s]:
            continue
        if automaton.accepting[s]:
            return d
        after = [(d, r, c, automaton.step(s, ""))]
        after += [(d, r, c, automaton.step(s, x)) for x in automaton.propositions if near[x][r, c]]
        for dr, dc in itertools.product((-1, 0, 1), repeat=2):
            q, p = r + dr, c + dc
            if 0 <= q < free.shape[0] and 0 <= p < free.shape[1] and free[q, p]:
                after.append((d + math.hypot(dr, dc), q, p, s))
        for node in after:
            if node[0] < best.get(node[1:], math.inf) - 1e-12:
                best[node[1:]] = node[0]
                heapq.heappush(heap, node)
    return math.inf


FORMULAS = [
    "F a", "F a & F b", "F (a & F b)", "F ((a | b) & F c)", "F a & F b & !b W c",
    "F (a & F b) | F c", "F (a & F (b & F a))", "F a & !a W b & F c", "X F a",
]  # fmt: skip


@given(data=st.data(), text=st.sampled_from(FORMULAS))
def test_the_shortest_path_is_that_of_the_best_order(data, text):
    automaton = compile_formula(parse(text))
    cells = data.draw(st.lists(st.sampled_from("....#abc"), min_size=30, max_size=30))
    plan = np.array(cells).reshape(5, 6)
    free = plan != "#"
    near = {x: plan == x for x in automaton.propositions}
    mine = cost_to_go_cells(automaton, near, free)
    for start in zip(*np.nonzero(free), strict=True):
        start = tuple(map(int, start))
        assert mine[start] == pytest.approx(shortest(automaton, near, free, start))
    assert np.isinf(mine[~free]).all()
