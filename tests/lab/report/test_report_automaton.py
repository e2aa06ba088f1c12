"""Drawings of automata: each part is drawn once, nothing else, and any name is safe."""

from __future__ import annotations

import re
from collections import defaultdict
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.transforms import Bbox

from edge.lab.report import canvas
from edge.lab.report.automaton_graph import CURRENT, RADIUS, draw, lay_out
from edge.live.automaton_graph import MAX_ARROWS, MAX_PART, MAX_WHOLE, make_automaton_graph
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.ltl import parse

CASE_1 = (
    "(F(toilet & F bed) | F(couch & F chair) | F(plant & F tv)) "
    "& (!tv W bed) & (!toilet W couch) & (!couch W tv)"
)
CASE_2 = (
    "(F(couch & F(toilet & F(bed & F chair))) | F(bed & F(plant | toilet)) "
    "| F(tv & F(plant & F couch))) & (!couch W toilet) & (!bed W tv) & (!plant W chair)"
)
BAD = "<script>alert(1)</script>"
FORMULAS = {
    "true": "true",
    "false": "a & !a",
    "one": "F chair",
    "choice": "F((chair | couch) & F tv)",
    "case 1": CASE_1,
    "case 2": CASE_2,
    "twice": "F(a & X F a) & G(a -> WX !b)",
    "cycle": "G(a -> X F b) & F c",
    "twelve": "F(" + " | ".join(f"thing_{i}" for i in range(12)) + ")",
    "forty": "F(" + " | ".join(f'"some object number {i}"' for i in range(40)) + ") & !a",
    "hostile": f'F("{BAD}" & F "{"x" * 200}") & G !"$a^ & b"',
}


def automaton(name: str) -> Automaton:
    return compile_formula(parse(FORMULAS.get(name, name)))


def unordered(n: int) -> Automaton:
    return compile_formula(parse(" & ".join(f"F {chr(97 + i)}" for i in range(n))))


@st.composite
def automata(draw: st.DrawFn) -> Automaton:
    n, k = draw(st.integers(1, 10)), draw(st.integers(0, 4))
    state = st.integers(0, n - 1)
    rows = st.lists(st.lists(state, min_size=k + 1, max_size=k + 1), min_size=n, max_size=n)
    delta = np.array(draw(rows), np.int32)
    accepting = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    left = np.where(accepting, 0, 1000)
    for _ in range(n):
        left = np.minimum(left, left[delta].min(axis=1) + 1)
    propositions = tuple("abcd"[:k])
    return Automaton(parse("true"), propositions, delta, accepting, np.where(left > n, -1, left))


def draw_svg(*shown) -> bytes:
    return canvas.svg(draw(make_automaton_graph(*shown)))


def texts(svg: bytes) -> list[str]:
    return [e.text or "" for e in ElementTree.fromstring(svg).iter() if e.tag.endswith("}text")]


def boxes(axes: Axes) -> list[Bbox]:
    """Return the boxes of labels and states, in px of the screen."""
    renderer = axes.figure.canvas.get_renderer()
    labels = [text.get_window_extent(renderer) for text in axes.texts if text.get_bbox_patch()]
    circles = [patch for patch in axes.patches if isinstance(patch, Circle)]
    discs = [disc.get_window_extent(renderer) for disc in circles if disc.radius == RADIUS]
    return [box.padded(-0.5) for box in (*labels, *discs)]


# -- the drawing -------------------------------------------------------------------------------


@given(automata())
def test_the_titles_say_all_that_the_automaton_does(automaton):
    """Rebuilt from the drawing's words alone, every step of a state with hope is right."""
    scene = make_automaton_graph(automaton)
    steps: dict[int, dict[str, int]] = defaultdict(dict)
    for arrow in scene.arrows:
        source, target, propositions = re.fullmatch(r"(\d+) to (\d+): (.*)", arrow.title).groups()
        steps[int(source)].update(dict.fromkeys(propositions.split(", "), int(target)))
    for node in scene.nodes:
        if node.dead:
            continue
        fatal = re.search(r"; not ([a-d, nothing]+)", node.title)
        lost = set(fatal.group(1).split(", ")) if fatal else set()
        for proposition, to in automaton.edges(node.state):
            word = proposition or "nothing"
            if word in lost:
                assert automaton.is_dead(to)
                assert word not in steps[node.state]
            else:
                assert steps[node.state].get(word, node.state) == to
    shown = {node.state for node in scene.nodes}
    assert shown == {0, *np.flatnonzero(automaton.steps_left >= 0).tolist()}


def test_the_path_and_the_plan_are_drawn():
    drawn = make_automaton_graph(automaton("case 1"), 2, ("plant", "tv"), ("bed",))
    roles = {a.role: [] for a in drawn.arrows}
    for arrow in drawn.arrows:
        roles[arrow.role].append(arrow.lines)
    assert roles["visited"] == [("bed",)]
    assert roles["plan"] == [("plant",), ("tv",)]
    assert [node.state for node in drawn.nodes if node.current] == [2]


@pytest.mark.parametrize("n", [6, 8])
@pytest.mark.parametrize("reached", [0, 2, 5])
def test_a_large_automaton_is_drawn_in_part(n, reached):
    a = unordered(n)
    path, plan = a.propositions[:reached], a.propositions[reached:]
    scene = make_automaton_graph(a, a.run(path), plan, path)
    states = [node.state for node in scene.nodes]
    on_the_way = {a.run(a.propositions[:k]) for k in range(n + 1)}
    assert len(states) == len(set(states)) <= MAX_PART < MAX_WHOLE
    assert set(states) >= on_the_way
    assert f"{len(states)} of {a.n_states} states shown" in scene.note
    out = {
        node.state: len({t for _, t in a.edges(node.state)} - {node.state}) for node in scene.nodes
    }
    for i, node in enumerate(scene.nodes):
        drawn = sum(arrow.source == i for arrow in scene.arrows)
        assert drawn + node.hidden == out[node.state]


@pytest.mark.parametrize(("n", "k"), [(20, 30), (40, 8), (60, 40)])
@pytest.mark.parametrize("ahead", [0, 20])
def test_a_dense_automaton_is_drawn_with_few_arrows(n, k, ahead):
    delta = np.random.default_rng(n).integers(0, n, (n, k + 1)).astype(np.int32)
    accepting, left = np.arange(n) == n - 1, np.ones(n, np.int32)
    propositions = tuple(f"object {i}" for i in range(k))
    dense = Automaton(parse("true"), propositions, delta, accepting, left)
    scene = make_automaton_graph(dense, 3, propositions[:ahead], propositions[:ahead])
    assert 5 < len(scene.nodes) <= MAX_PART
    assert len(scene.arrows) <= MAX_ARROWS
    assert any(node.current for node in scene.nodes)
    assert f"{len(scene.nodes)} of {n} states shown" in scene.note


# -- pictures -----------------------------------------------------------------------------------


@given(automata())
def test_arrows_run_column_by_column_without_overlaps(automaton):
    scene = make_automaton_graph(automaton)
    layout = lay_out(scene)
    places = [*layout.nodes, *(stop for route in layout.routes for stop in route)]
    assert len(places) == len(set(places))
    for arrow, route in zip(scene.arrows, layout.routes, strict=True):
        ends = [layout.nodes[i][0] for i in (arrow.source, arrow.target)]
        xs = [ends[0], *(x for x, _ in route), ends[1]]
        assert xs == sorted(xs, reverse=ends[0] > ends[1])
    for x, y in places:
        assert 0 < x < layout.width
        assert 0 < y < layout.height


@pytest.mark.parametrize("name", FORMULAS)
def test_no_label_covers_another_or_a_state(name):
    a = automaton(name)
    placed = boxes(draw(make_automaton_graph(a, 0, a.propositions[:1])))
    assert not any(one.overlaps(other) for one, other in combinations(placed, 2))


@pytest.mark.parametrize("name", FORMULAS)
def test_svg_is_whole_safe_and_always_the_same(name):
    a = automaton(name)
    svg = draw_svg(a, 0, a.propositions[:1])
    tags = {e.tag.rpartition("}")[2] for e in ElementTree.fromstring(svg).iter()}
    assert not tags & {"script", "image", "foreignObject", "a"}
    assert not re.search(rb'href="[^#]|url\([^#]|<script', svg)
    assert CURRENT.encode() in svg
    assert all(len(text) < 60 for text in texts(svg) if "x" * 9 in text)
    assert len(svg) < 200_000
    assert svg == draw_svg(a, 0, a.propositions[:1])


@pytest.mark.parametrize("name", ["true", "false", "choice", "hostile", "case 1"])
def test_png(name):
    a = automaton(name)
    png = canvas.png(draw(make_automaton_graph(a, 0, a.propositions[:1])))
    assert png.startswith(b"\x89PNG")
    assert png != canvas.png(draw(make_automaton_graph(a, None)))
