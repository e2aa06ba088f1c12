"""Floor plans of generated houses: rooms that fill a footprint, and the doors between them.

Large homes have a hallway with rooms on both sides; in small ones, rooms open into each other. Part
of the footprint may be missing. Doors follow real homes: every room opens to the hallway or the
living room if possible, and no path leads through a bathroom.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

from edge.lab.sim.generator.rng import PortableRng, Rect

MOST_ROOMS = 10  # of a house
FEWEST_ROOMS = 4
DOOR_M = (0.8, 1.0)  # smallest and largest width of a door
WALL_M = 0.12  # thickness of a wall

LIVING, KITCHEN, BEDROOM, BATHROOM, OFFICE, HALLWAY = KINDS = (
    "living room", "kitchen", "bedroom", "bathroom", "office", "hallway",
)  # fmt: skip
# Smallest and largest area of a room.
AREA_M2 = {
    LIVING: (17, 29), KITCHEN: (9, 15), BEDROOM: (10.5, 17), BATHROOM: (4.8, 8), OFFICE: (7.5, 12),
}  # fmt: skip
# Shortest side of a room.
LEAST_SIDE_M = {
    LIVING: 3.2, KITCHEN: 2.4, BEDROOM: 2.8, BATHROOM: 1.8, OFFICE: 2.4, HALLWAY: 1.1,
}  # fmt: skip
MOST_OF_A_KIND = {LIVING: 2, BEDROOM: 4, BATHROOM: 3, OFFICE: 2}  # rooms in a house
_MORE = (BEDROOM, BEDROOM, BEDROOM, BATHROOM, BATHROOM, OFFICE, OFFICE, LIVING)
"""Kinds of the rooms beyond the first four; a frequent kind is repeated."""
_MAX_RATIO = 2.6
"""Largest ratio of length to width of a room other than the hallway."""
_OUTSIDE = "outside"  # kind of a part of the footprint that is missing

_DOOR_COST = {
    frozenset(pair): cost
    for pair, cost in (
        ((HALLWAY, LIVING), 0.0), ((HALLWAY, KITCHEN), 0.2), ((HALLWAY, BEDROOM), 0.0),
        ((HALLWAY, BATHROOM), 0.0), ((HALLWAY, OFFICE), 0.0), ((LIVING, KITCHEN), 1.0),
        ((LIVING,), 1.0), ((LIVING, OFFICE), 2.0), ((LIVING, BEDROOM), 2.0),
        ((LIVING, BATHROOM), 2.5), ((BEDROOM, BATHROOM), 3.0), ((KITCHEN, OFFICE), 4.0),
        ((KITCHEN, BEDROOM), 4.0), ((KITCHEN, BATHROOM), 5.0), ((OFFICE, BEDROOM), 5.0),
        ((OFFICE,), 6.0), ((OFFICE, BATHROOM), 7.0), ((BEDROOM,), 8.0), ((BATHROOM,), 12.0),
    )
}  # fmt: skip
"""Cost of a door between two kinds of room; one kind alone stands for two rooms of this kind. The
rooms are joined by the set of doors with the least sum of costs."""
_SECOND_DOOR = {
    frozenset(pair): p
    for pair, p in (
        ((LIVING, KITCHEN), 0.6), ((HALLWAY, LIVING), 0.5), ((HALLWAY, KITCHEN), 0.4),
        ((LIVING,), 0.6), ((BEDROOM, BATHROOM), 0.2), ((LIVING, OFFICE), 0.15),
    )
}  # fmt: skip
"""Probability of a further door between two kinds of room, so that some paths form loops."""
# Kinds of two rooms that may be joined by a wide opening.
_WIDE = {frozenset((LIVING, KITCHEN)), frozenset((LIVING, HALLWAY)), frozenset((LIVING,))}
_WIDE_M = (1.2, 1.8)  # smallest and largest width of a wide opening
_BESIDE_DOOR_M = 0.12  # least length of wall on each side of a door


@dataclass(frozen=True, slots=True)
class PlannedRoom:
    """A room; `kind` is one of `KINDS`, and `rect` reaches to the middle of its walls."""

    kind: str
    rect: Rect


@dataclass(frozen=True, slots=True)
class Door:
    """A gap in the wall between two rooms.

    Attributes:
        upright: True if the wall runs along y (upright on the plan).
    """

    rooms: tuple[int, int]
    x_m: float
    y_m: float
    width_m: float
    upright: bool

    def clear_area(self, deep_m: float) -> Rect:
        """Return the doorway and `deep_m` of floor on both sides."""
        wide = 0.5 * self.width_m + 0.05
        a, b = (deep_m, wide) if self.upright else (wide, deep_m)
        return Rect(self.x_m - a, self.y_m - b, self.x_m + a, self.y_m + b)


@dataclass(frozen=True, slots=True)
class WallSegment:
    """A piece of wall along x or y, with its door if it has one.

    x0, y0 is the end with the smaller coordinate, x1, y1 the other one, in metres.
    """

    x0: float
    y0: float
    x1: float
    y1: float
    door: Door | None = None


@dataclass(frozen=True, slots=True)
class HouseLayout:
    """Floor plan of a house; the walls include those with doors."""

    rooms: tuple[PlannedRoom, ...]
    doors: tuple[Door, ...]
    walls: tuple[WallSegment, ...]


def draw_layout(rng: PortableRng) -> HouseLayout:
    """Return a plan with rooms of usual sizes, all connected by doors.

    Draws that come out badly are drawn again.
    """
    kinds = draw_kinds(rng)
    while True:
        rooms = _draw_rooms(rng, kinds)
        if rooms is None:
            continue
        shared = _shared_walls(rooms)
        joined = _choose_doors(rng, rooms, shared)
        if joined is None:
            continue
        doors = {pair: _draw_door(rng, rooms, pair, shared[pair]) for pair in joined}
        walls = [WallSegment(s.x0, s.y0, s.x1, s.y1, doors.get(pair)) for pair, s in shared.items()]
        walls += _outer_walls(rooms, list(shared.values()))
        return HouseLayout(tuple(rooms), tuple(doors.values()), tuple(walls))


def draw_kinds(rng: PortableRng) -> list[str]:
    """Return the kinds of a home's rooms."""
    count = rng.count(FEWEST_ROOMS, MOST_ROOMS)
    kinds = [LIVING, KITCHEN, BEDROOM, BATHROOM]
    if count >= 6 or (count == 5 and rng.chance(0.5)):
        kinds.append(HALLWAY)
    while len(kinds) < count:
        kind = rng.pick(_MORE)
        if kinds.count(kind) < MOST_OF_A_KIND[kind]:
            kinds.append(kind)
    return kinds


def _draw_rooms(rng: PortableRng, kinds: Sequence[str]) -> list[PlannedRoom] | None:
    """Return the rooms; None if one came out too small or too slim."""
    wanted = [(kind, rng.between(*AREA_M2[kind])) for kind in kinds if kind != HALLWAY]
    if rng.chance(0.3):
        wanted.append((_OUTSIDE, rng.between(5.0, 12.0)))
    placed = _along_hallway(rng, wanted) if HALLWAY in kinds else _in_block(rng, wanted)
    turn, rooms = rng.chance(0.5), []  # with `turn`, x and y are exchanged
    for kind, r in placed:
        rect = Rect(r.y0, r.x0, r.y1, r.x1) if turn else r
        rect = Rect(*(round(v, 2) for v in (rect.x0, rect.y0, rect.x1, rect.y1)))
        short, long = sorted((rect.width_m, rect.depth_m))
        if kind == _OUTSIDE:
            continue
        if short < LEAST_SIDE_M[kind] or (kind != HALLWAY and long > _MAX_RATIO * short):
            return None
        rooms.append(PlannedRoom(kind, rect))
    return rooms


Wanted = Sequence[tuple[str, float]]
"""Kind and area [m²] of each room."""


def _in_block(rng: PortableRng, wanted: Wanted) -> list[tuple[str, Rect]]:
    """Return rooms that fill one rectangle."""
    area = sum(a for _, a in wanted)
    width = math.sqrt(area * rng.between(1.0, 1.7))
    return _cut(Rect(0.0, 0.0, width, area / width), rng.shuffled(wanted))


def _along_hallway(rng: PortableRng, wanted: Wanted) -> list[tuple[str, Rect]]:
    """Return rooms on both sides of a hallway; sometimes the living room is across its end."""
    wanted = list(wanted)
    across = wanted.pop(0) if rng.chance(0.5) else None  # the living room is the first
    sides: tuple[list, list] = ([], [])  # rooms below the hallway (smaller y), and above it
    for item in rng.shuffled(wanted):
        lighter = min(sides, key=lambda side: sum(a for _, a in side))
        lighter.append(item)
    areas = [sum(a for _, a in side) for side in sides]
    length = sum(areas) / (2 * rng.between(3.2, 4.6))
    wide = rng.between(1.15, 1.6)
    # y of the hallway's two sides, and of the upper end of the house.
    low, high = areas[0] / length, areas[0] / length + wide
    top = high + areas[1] / length
    placed = [(HALLWAY, Rect(0.0, low, length, high))]
    placed += _cut(Rect(0.0, 0.0, length, low), sides[0])
    placed += _cut(Rect(0.0, high, length, top), sides[1])
    if across is not None:
        placed.append((across[0], Rect(-across[1] / top, 0.0, 0.0, top)))
    return placed


def _cut(rect: Rect, wanted: Wanted) -> list[tuple[str, Rect]]:
    """Divide a rectangle into rooms of the wanted areas: in two across its longer side, and so on.

    The first cut is where the two parts are most nearly of the same area.
    """
    if len(wanted) <= 1:
        return [(kind, rect) for kind, _ in wanted]
    total = sum(a for _, a in wanted)
    # Share of the area in the first 1, 2, … rooms; cut where it is nearest to one half.
    parts = [sum(a for _, a in wanted[:k]) / total for k in range(1, len(wanted))]
    k = min(range(len(parts)), key=lambda i: abs(parts[i] - 0.5))
    if rect.width_m >= rect.depth_m:
        x = rect.x0 + parts[k] * rect.width_m
        first, second = Rect(rect.x0, rect.y0, x, rect.y1), Rect(x, rect.y0, rect.x1, rect.y1)
    else:
        y = rect.y0 + parts[k] * rect.depth_m
        first, second = Rect(rect.x0, rect.y0, rect.x1, y), Rect(rect.x0, y, rect.x1, rect.y1)
    return _cut(first, wanted[: k + 1]) + _cut(second, wanted[k + 1 :])


def _shared_walls(rooms: list[PlannedRoom]) -> dict[tuple[int, int], WallSegment]:
    """Map each pair of rooms that touch to the piece of wall between them."""
    shared = {}
    for i, j in combinations(range(len(rooms)), 2):
        a, b = rooms[i].rect, rooms[j].rect
        low, high = max(a.y0, b.y0), min(a.y1, b.y1)
        left, right = max(a.x0, b.x0), min(a.x1, b.x1)
        if (left == right and low < high) or (low == high and left < right):
            shared[i, j] = WallSegment(left, low, right, high)
    return shared


def _choose_doors(
    rng: PortableRng, rooms: list[PlannedRoom], shared: dict[tuple[int, int], WallSegment]
) -> list[tuple[int, int]] | None:
    """Return the pairs of rooms with a door: a spanning tree of the cheapest ones, and some more.

    The tree is Kruskal's. None if there is no tree, because a room has no wall that is long enough
    for a door.
    """
    least_m = DOOR_M[1] + 2 * _BESIDE_DOOR_M + WALL_M
    pairs = [pair for pair, wall in shared.items() if _length(wall) >= least_m]
    kinds = {pair: frozenset(rooms[i].kind for i in pair) for pair in pairs}
    # The random part varies the choice. Pairs that are not in the table cost nothing.
    cost = {pair: _DOOR_COST.get(kinds[pair], 0.0) + 0.9 * rng.unit() for pair in pairs}
    group = list(range(len(rooms)))  # rooms that are joined so far have the same number
    joined = []
    for pair in sorted(pairs, key=cost.__getitem__):
        a, b = (group[i] for i in pair)
        if a != b:
            group = [a if g == b else g for g in group]
            joined.append(pair)
        elif rng.chance(_SECOND_DOOR.get(kinds[pair], 0.0)):
            joined.append(pair)
    return joined if len(set(group)) == 1 else None


def _draw_door(
    rng: PortableRng, rooms: list[PlannedRoom], pair: tuple[int, int], wall: WallSegment
) -> Door:
    """Return a door, or a wide opening, at a random place of the wall between two rooms."""
    width, space_m = rng.between(*DOOR_M), _length(wall) - WALL_M - 2 * _BESIDE_DOOR_M
    wide = frozenset(rooms[i].kind for i in pair) in _WIDE and rng.chance(0.4)
    if wide and space_m >= _WIDE_M[1]:
        width = rng.between(*_WIDE_M)
    # Least and largest distance of the door's middle from the wall's end.
    least = 0.5 * (WALL_M + width) + _BESIDE_DOOR_M
    most = _length(wall) - least
    # Most doors are near a corner, so that a wall is left for furniture.
    at = rng.pick((least, most)) if rng.chance(0.6) else rng.between(least, most)
    upright = wall.x0 == wall.x1
    x, y = (wall.x0, wall.y0 + at) if upright else (wall.x0 + at, wall.y0)
    return Door(pair, round(x, 2), round(y, 2), round(width, 2), upright)


def _length(wall: WallSegment) -> float:
    return (wall.x1 - wall.x0) + (wall.y1 - wall.y0)


def _outer_walls(rooms: list[PlannedRoom], shared: list[WallSegment]) -> list[WallSegment]:
    """Return the parts of each room's sides that are not shared walls."""
    walls = []
    for r in (room.rect for room in rooms):
        for side in (
            WallSegment(r.x0, r.y0, r.x0, r.y1), WallSegment(r.x1, r.y0, r.x1, r.y1),
            WallSegment(r.x0, r.y0, r.x1, r.y0), WallSegment(r.x0, r.y1, r.x1, r.y1),
        ):  # fmt: skip
            walls += _parts_outside(side, shared)
    return walls


def _parts_outside(side: WallSegment, shared: list[WallSegment]) -> list[WallSegment]:
    """Return the parts of a room's side that no shared wall covers."""
    upright = side.x0 == side.x1
    taken = []  # (start, end) of each covered part, as y of an upright side, else as x
    for s in shared:
        on_it = (s.x0 == s.x1 == side.x0) if upright else (s.y0 == s.y1 == side.y0)
        low, high = (s.y0, s.y1) if upright else (s.x0, s.x1)
        if on_it:
            taken.append((low, high))
    start, end = (side.y0, side.y1) if upright else (side.x0, side.x1)
    edges = [(start, start), *sorted(t for t in taken if t[0] < end and t[1] > start), (end, end)]
    parts = []
    for (_, low), (high, _) in pairwise(edges):  # from the end of one to the start of the next
        if high > low:
            ends = (side.x0, low, side.x0, high) if upright else (low, side.y0, high, side.y0)
            parts.append(WallSegment(*ends))
    return parts
