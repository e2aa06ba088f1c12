"""Layered layout: nothing covers anything, and every edge goes where it should."""

from __future__ import annotations

from itertools import combinations, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.report.drawing.layout import Layout, Link, Size, layered

NODE = Size(30.0, 34.0)


def boxes(layout: Layout, sizes: list[Size], links: list[Link]) -> list[tuple[float, ...]]:
    places = [*zip(layout.centres, sizes, strict=True)]
    places += [(r.label, k.label) for r, k in zip(layout.routes, links, strict=True)]
    return [(x - w / 2, y - h / 2, x + w / 2, y + h / 2 + b) for (x, y), (w, h, b) in places]


def overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] - 1e-6 and b[1] < a[3] - 1e-6


@st.composite
def graphs(draw: st.DrawFn) -> tuple[list[Size], list[Link]]:
    n = draw(st.integers(1, 12))
    length, below = st.sampled_from((2.0, 14.0, 30.0, 90.0)), st.sampled_from((0.0, 25.0))
    size = st.builds(Size, length, length, below)
    sizes = draw(st.lists(size, min_size=n, max_size=n))
    node, weight = st.integers(0, n - 1), st.sampled_from((1.0, 6.0))
    link = st.builds(Link, node, node, st.builds(Size, length, length, st.just(0.0)), weight)
    links = draw(st.lists(link, max_size=24))
    return sizes, [link for link in links if link.source != link.target]


def test_nothing():
    assert layered([], []) == Layout(0.0, 0.0, (), (), ())


def test_one_node():
    layout = layered([NODE], [])
    assert (layout.width, layout.height) == (30.0, 34.0)
    assert layout.centres == ((15.0, 17.0),)


@given(graphs())
@settings(max_examples=150)
def test_nothing_covers_anything(graph):
    sizes, links = graph
    layout = layered(sizes, links)
    everything = boxes(layout, sizes, links)
    assert not any(overlap(a, b) for a, b in combinations(everything, 2))
    for x0, y0, x1, y1 in everything:
        assert -1e-6 <= x0 <= x1 <= layout.width + 1e-6
        assert -1e-6 <= y0 <= y1 <= layout.height + 1e-6


@given(graphs())
@settings(max_examples=150)
def test_routes_go_from_source_to_target_and_are_level_inside_columns(graph):
    sizes, links = graph
    layout = layered(sizes, links)
    assert len(layout.routes) == len(links)
    for link, route in zip(links, layout.routes, strict=True):
        xs = [x for x, _ in route.points]
        forward = xs[0] < xs[-1]
        assert xs == sorted(xs, reverse=not forward)
        assert xs[0] == layout.columns[link.source][forward]
        assert xs[-1] == layout.columns[link.target][not forward]
        assert route.points[0][1] == layout.centres[link.source][1]
        assert route.points[-1][1] == layout.centres[link.target][1]
        inner = route.points[1:-1]
        assert all(a[1] == b[1] for a, b in zip(inner[::2], inner[1::2], strict=True))
        assert any(min(a[0], b[0]) <= route.label[0] <= max(a[0], b[0]) and a[1] == route.label[1]
                   for a, b in pairwise(inner))  # fmt: skip


@given(st.integers(2, 12))
def test_a_chain_is_a_straight_line(n):
    layout = layered([NODE] * n, [Link(i, i + 1, Size(20.0, 12.0)) for i in range(n - 1)])
    assert {y for _, y in layout.centres} == {17.0}
    xs = [x for x, _ in layout.centres]
    assert xs == sorted(set(xs))


def test_edges_of_a_graph_without_cycles_go_right():
    links = [Link(a, b, NODE) for a, b in ((0, 1), (0, 2), (1, 3), (2, 3), (0, 3), (3, 4))]
    layout = layered([NODE] * 5, links)
    for link in links:
        assert layout.centres[link.source][0] < layout.centres[link.target][0]


@pytest.mark.parametrize("way", [[(0, 1), (1, 0)], [(0, 1), (1, 2), (2, 0)]])
def test_a_cycle_goes_back_once(way):
    n = len({a for a, _ in way})
    layout = layered([NODE] * n, [Link(a, b, Size(20.0, 12.0)) for a, b in way])
    assert sum(r.points[0][0] > r.points[-1][0] for r in layout.routes) == 1


def test_two_lines_that_need_not_cross_do_not():
    links = [Link(0, 1, NODE), Link(0, 2, NODE), Link(1, 4, NODE), Link(2, 3, NODE)]
    layout = layered([NODE] * 5, links)
    y = [y for _, y in layout.centres]
    assert (y[1] < y[2]) == (y[4] < y[3])
