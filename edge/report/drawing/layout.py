"""Layered drawing of a small directed graph, after Sugiyama, Tagawa and Toda (1981).

Every edge goes from left to right through columns; labels have columns of their own between those
of the nodes, so that no label can lie on a node or on another label. Pure geometry: sizes in,
places out, both in px with y downwards.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

SWEEPS = 24
GAP_PX = 22.0  # between columns, where edges bend
STRAIGHT = 8.0  # how much more an edge's own bends pull at each other than its ends do


class Size(NamedTuple):
    """Room around a centre: half the height on either side of it, and `below` more under that."""

    width: float
    height: float
    below: float = 0.0


class Link(NamedTuple):
    """An edge to lay out; `weight` pulls its ends to the same height."""

    source: int
    target: int
    label: Size
    weight: float = 1.0


class Route(NamedTuple):
    """The way of an edge from its source's column to its target's.

    Attributes:
        points: (x, y) pairs in the direction of the edge; the first lies on the rim of the source's
            column, the last on that of the target's; each second stretch is level.
        label: centre of the label.
    """

    points: tuple[tuple[float, float], ...]
    label: tuple[float, float]


class Layout(NamedTuple):
    """Places in [0, width] x [0, height].

    Attributes:
        centres: (x, y) of each node.
        columns: (left, right) of each node's column.
    """

    width: float
    height: float
    centres: tuple[tuple[float, float], ...]
    columns: tuple[tuple[float, float], ...]
    routes: tuple[Route, ...]


@dataclass(slots=True)
class _Cell:
    """A node, a label, or a place where a long edge passes through a column."""

    rank: int
    size: Size
    near: list[tuple[int, float]]  # neighbours in the columns beside, with weights
    y: float = 0.0


def layered(sizes: Sequence[Size], links: Sequence[Link]) -> Layout:
    """Lay out a graph whose node 0 is where it begins.

    Args:
        sizes: room that each node takes.
        links: no self loops; several between the same nodes are allowed.
    """
    if not sizes:
        return Layout(0.0, 0.0, (), (), ())
    backward = _backward(len(sizes), links)
    ranks = _ranks(len(sizes), links, backward)
    cells = [_Cell(2 * rank, size, []) for rank, size in zip(ranks, sizes, strict=True)]
    chains = [_chain(cells, link, back) for link, back in zip(links, backward, strict=True)]
    columns = _order(cells)
    _heights(cells, columns)
    return _places(cells, columns, chains, links, len(sizes))


def _backward(n: int, links: Sequence[Link]) -> list[bool]:
    """Which links to turn round so that no cycle is left: those back to an open node of a
    depth-first search."""
    out: list[list[int]] = [[] for _ in range(n)]
    for k, link in enumerate(links):
        out[link.source].append(k)
    backward, state = [False] * len(links), [0] * n  # 0 new, 1 open, 2 done
    for root in range(n):
        if state[root]:
            continue
        state[root] = 1
        stack = [(root, iter(out[root]))]
        while stack:
            node, ways = stack[-1]
            k = next(ways, None)
            if k is None:
                state[node] = 2
                stack.pop()
                continue
            to = links[k].target
            backward[k] = state[to] == 1
            if state[to] == 0:
                state[to] = 1
                stack.append((to, iter(out[to])))
    return backward


def _ranks(n: int, links: Sequence[Link], backward: Sequence[bool]) -> list[int]:
    """The length of the longest way to each node, so that every link goes to a higher rank."""
    ranks = [0] * n
    for _ in range(n):  # Bellman-Ford: without cycles it settles after n rounds
        changed = False
        for link, back in zip(links, backward, strict=True):
            a, b = (link.target, link.source) if back else (link.source, link.target)
            if ranks[b] <= ranks[a]:
                ranks[b], changed = ranks[a] + 1, True
        if not changed:
            break
    return ranks


def _chain(cells: list[_Cell], link: Link, back: bool) -> list[int]:
    """Put a cell in each column that the link passes; the first after its source is its label.

    Returns:
        The link's cells from left to right, its ends included.
    """
    left, right = (link.target, link.source) if back else (link.source, link.target)
    first, last = cells[left].rank, cells[right].rank
    labelled = last - 1 if back else first + 1
    chain = [left]
    for rank in range(first + 1, last):
        cells.append(_Cell(rank, link.label if rank == labelled else Size(0.0, 2.0), []))
        chain.append(len(cells) - 1)
    chain.append(right)
    for a, b in pairwise(chain):
        inner = a not in (left, right) and b not in (left, right)
        weight = link.weight * (STRAIGHT if inner else 1.0)
        cells[a].near.append((b, weight))
        cells[b].near.append((a, weight))
    return chain


def _order(cells: Sequence[_Cell]) -> list[list[int]]:
    """The order within columns: barycentre sweeps to and fro, the one with fewest crossings."""
    columns: list[list[int]] = [[] for _ in range(1 + max(cell.rank for cell in cells))]
    for i, cell in enumerate(cells):
        columns[cell.rank].append(i)
    best, fewest = [list(c) for c in columns], _crossings(cells, columns)
    for sweep in range(SWEEPS):
        if not fewest:
            break
        step = 1 if sweep % 2 == 0 else -1
        inner = range(1, len(columns)) if step == 1 else range(len(columns) - 2, -1, -1)
        for rank in inner:
            place = {i: at for at, i in enumerate(columns[rank - step])}
            columns[rank] = _by_barycentre(cells, columns[rank], place)
        crossings = _crossings(cells, columns)
        if crossings < fewest:
            best, fewest = [list(c) for c in columns], crossings
    return best


def _by_barycentre(
    cells: Sequence[_Cell], column: Sequence[int], place: dict[int, int]
) -> list[int]:
    """Sorted by the mean place of the neighbours; cells without any keep their place."""
    keys = {}
    for at, i in enumerate(column):
        theirs = [place[j] for j, _ in cells[i].near if j in place]
        keys[i] = sum(theirs) / len(theirs) if theirs else float(at)
    return sorted(column, key=lambda i: keys[i])


def _crossings(cells: Sequence[_Cell], columns: Sequence[Sequence[int]]) -> int:
    """Pairs of lines that cross, as inversions between neighbouring columns."""
    total = 0
    for left, right in pairwise(columns):
        place = {i: at for at, i in enumerate(right)}
        seen: list[int] = []
        for i in left:
            ends = sorted(place[j] for j, _ in cells[i].near if j in place)
            total += sum(len(seen) - bisect_left(seen, end + 1) for end in ends)
            for end in ends:
                insort(seen, end)
    return total


def _heights(cells: Sequence[_Cell], columns: Sequence[Sequence[int]]) -> None:
    """Set `y`: each cell as near to its neighbours as order and distances within a column allow."""
    for column in columns:
        for i, y in zip(column, _spread(cells, column, [0.0] * len(column)), strict=True):
            cells[i].y = y
    for sweep in range(SWEEPS):
        for column in columns if sweep % 2 == 0 else reversed(columns):
            wanted = []
            for i in column:
                pull = sum(w for _, w in cells[i].near)
                mean = sum(w * cells[j].y for j, w in cells[i].near) / pull if pull else cells[i].y
                wanted.append(mean)
            for i, y in zip(column, _spread(cells, column, wanted), strict=True):
                cells[i].y = y


def _spread(cells: Sequence[_Cell], column: Sequence[int], wanted: Sequence[float]) -> list[float]:
    """Least squares to `wanted` under the distances between neighbours.

    With the distances taken off it is isotonic regression: pool adjacent violators.
    """
    offsets, at = [], 0.0
    for a, b in pairwise([column[0], *column]):
        at += _distance(cells[a], cells[b]) if a != b else 0.0
        offsets.append(at)
    blocks: list[tuple[float, float, int]] = []  # mean, weight, cells
    for i, y, offset in zip(column, wanted, offsets, strict=True):
        weight = sum(w for _, w in cells[i].near) or 1.0
        mean, n = y - offset, 1
        while blocks and blocks[-1][0] > mean:
            other, its_weight, its_n = blocks.pop()
            mean = (mean * weight + other * its_weight) / (weight + its_weight)
            weight, n = weight + its_weight, n + its_n
        blocks.append((mean, weight, n))
    levels = [mean for mean, _, n in blocks for _ in range(n)]
    return [level + offset for level, offset in zip(levels, offsets, strict=True)]


def _distance(a: _Cell, b: _Cell) -> float:
    gap = 5.0 if a.rank % 2 else 12.0
    return (a.size.height + b.size.height) / 2 + a.size.below + gap


def _places(
    cells: Sequence[_Cell],
    columns: Sequence[Sequence[int]],
    chains: Sequence[Sequence[int]],
    links: Sequence[Link],
    n: int,
) -> Layout:
    top = min(cell.y - cell.size.height / 2 for cell in cells)
    bottom = max(cell.y + cell.size.height / 2 + cell.size.below for cell in cells)
    spans, x = [], 0.0
    for column in columns:
        width = max(cells[i].size.width for i in column)
        spans.append((x, x + width))
        x += width + GAP_PX

    def centre(i: int) -> tuple[float, float]:
        left, right = spans[cells[i].rank]
        return (left + right) / 2, cells[i].y - top

    routes = []
    for chain, link in zip(chains, links, strict=True):
        points = [(spans[cells[chain[0]].rank][1], centre(chain[0])[1])]
        for i in chain[1:-1]:
            left, right = spans[cells[i].rank]
            points += [(left, centre(i)[1]), (right, centre(i)[1])]
        points.append((spans[cells[chain[-1]].rank][0], centre(chain[-1])[1]))
        back = chain[0] != link.source
        label = centre(chain[-2] if back else chain[1])
        routes.append(Route(tuple(reversed(points) if back else points), label))
    return Layout(
        x - GAP_PX,
        bottom - top,
        tuple(centre(i) for i in range(n)),
        tuple(spans[cells[i].rank] for i in range(n)),
        tuple(routes),
    )
