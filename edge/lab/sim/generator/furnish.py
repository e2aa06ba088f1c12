"""Furnishing of a room of a generated house: objects at their usual places, all reachable."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from edge.lab.sim import assemblies
from edge.lab.sim.generator.contents import CONTENTS, STRAY_P, STRAYS, FurnitureRule
from edge.lab.sim.generator.layout import WALL_M, Door
from edge.lab.sim.generator.rng import QUARTERS, PortableRng, Rect, at_wall, wall_span_m

PASSAGE_M = 0.3
"""Half the width of the passage that is left to every door and object."""
NEAR_M, NEAR_RAISED_M = 0.6, 0.65
"""An object is reachable if the passage comes this near to it. The first distance is for objects on
the floor, the second for those on other objects or on a wall."""
_GAP_M = 0.03  # least gap between two objects on the floor
_OFF_WALL_M = 0.5 * WALL_M + 0.02  # from the middle of a wall to the back of an object
_BEFORE_DOOR_M = 0.7  # length of the free floor on each side of a door
_CELL_M = 0.05  # side of a cell of the raster
_TRIES = 10  # poses to try for an object
_ROOM_TRIES = 50  # furnishings to try for a room
_LOW_M = 1.15
"""Objects that are lower than this may stand below a picture."""
_ROUNDING_M = 0.011
"""Objects may be this much outside the walls, because positions are rounded."""

Pose = tuple[float, float, int]
"""Centre x and y [m], and quarter turns from +x."""


@dataclass(frozen=True, slots=True)
class PlacedItem:
    """An object that was placed in a room.

    Attributes:
        category: key of `assemblies.CATEGORIES`.
        quarter: direction of its front, in quarter turns from +x.
        size_m: depth, width, height, as seen from its front.
        color: r, g, b, each 0 to 255.
        z_m: height of its underside.
    """

    category: str
    x_m: float
    y_m: float
    quarter: int
    size_m: tuple[float, float, float]
    color: tuple[float, float, float]
    z_m: float = 0.0

    @property
    def box(self) -> Rect:
        """The floor that it covers."""
        return _box((self.x_m, self.y_m, self.quarter), self.size_m)

    def local(self, ahead_m: float, left_m: float) -> tuple[float, float]:
        """Return x and y of a place in front of its centre and to its left."""
        a, b = QUARTERS[self.quarter]
        return self.x_m + a * ahead_m - b * left_m, self.y_m + b * ahead_m + a * left_m


def _box(pose: Pose, size_m: tuple[float, float, float]) -> Rect:
    """Return the floor that an object of a size covers at a pose."""
    x, y, quarter = pose
    a, b = (size_m[1], size_m[0]) if quarter % 2 else size_m[:2]
    return Rect(x - 0.5 * a, y - 0.5 * b, x + 0.5 * a, y + 0.5 * b)


class RoomReachability:
    """Checks that a robot can reach all doors and objects of a room.

    It uses a raster of the places for the robot's centre: the floor without a border of
    `PASSAGE_M`. The room's rectangle reaches to the middle of its walls.
    """

    def __init__(self, rect: Rect, doors: list[Door]) -> None:
        self._area = rect.grown(-0.5 * WALL_M - PASSAGE_M)
        width, depth = self._area.width_m, self._area.depth_m
        self._shape = max(1, int(depth / _CELL_M)), max(1, int(width / _CELL_M))
        self._doors = [self._cell(door.x_m, door.y_m) for door in doors]

    def reachable_with(self, objects: list[PlacedItem]) -> np.ndarray | None:
        """Return (rows, columns) bool: cells that a robot can reach from the doors.

        None if it cannot get from each door to all others and to all objects.
        """
        free = np.ones(self._shape, np.uint8)
        boxes = [(o.box, o.z_m > 0) for o in objects if o.category != "rug"]
        for box in (box for box, raised in boxes if not raised):
            free[self._cells(box.grown(PASSAGE_M))] = 0
        _, component = cv2.connectedComponents(free, connectivity=4)
        floor = component[self._doors[0]]  # number of the connected area; 0 for occupied cells
        if floor == 0 or any(component[door] != floor for door in self._doors):
            return None
        reached = component == floor
        for box, raised in boxes:
            if not reached[self._cells(box.grown(NEAR_RAISED_M if raised else NEAR_M))].any():
                return None
        return reached

    def xy_m(self, row: int, col: int) -> tuple[float, float]:
        """Return the centre of a cell."""
        return self._area.x0 + (col + 0.5) * _CELL_M, self._area.y0 + (row + 0.5) * _CELL_M

    def _cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return the nearest cell."""
        rows, cols = self._shape
        row, col = int((y_m - self._area.y0) / _CELL_M), int((x_m - self._area.x0) / _CELL_M)
        return min(max(row, 0), rows - 1), min(max(col, 0), cols - 1)

    def _cells(self, box: Rect) -> tuple[slice, slice]:
        """Return the cells that a box touches."""
        rows, cols = self._shape
        x0, x1 = ((x - self._area.x0) / _CELL_M for x in (box.x0, box.x1))
        y0, y1 = ((y - self._area.y0) / _CELL_M for y in (box.y0, box.y1))
        return (
            slice(min(max(int(y0), 0), rows), min(max(int(y1) + 1, 0), rows)),
            slice(min(max(int(x0), 0), cols), min(max(int(x1) + 1, 0), cols)),
        )


class RoomFurnisher:
    """Places objects in one room.

    Attributes:
        rng: draws sizes, colours and places.
        kind: kind of the room, one of `layout.KINDS`.
        placed: objects placed so far.
        inside: floor between the walls, without the gap between a wall and an object's back.
    """

    def __init__(self, rng: PortableRng, kind: str, rect: Rect, doors: list[Door]) -> None:
        self.rng, self.kind = rng, kind
        self.placed: list[PlacedItem] = []
        self.inside = rect.grown(-_OFF_WALL_M)
        self._reachability = RoomReachability(rect, doors)
        self._doorways = [door.clear_area(_BEFORE_DOOR_M) for door in doors]

    def furnish(self) -> list[PlacedItem]:
        """Place the objects of this kind of room; try again if a necessary one finds no place."""
        # Rules with `by` are left out: their objects need another object first.
        needed = {rule.category for rule in CONTENTS[self.kind] if rule.p == 1.0 and not rule.by}
        for _ in range(_ROOM_TRIES):
            self.placed = []
            self._fill()
            if needed.issubset(item.category for item in self.placed):
                break
        return self.placed

    def _fill(self) -> None:
        """Place objects by all rules of this kind of room, once."""
        floor_m2 = self.inside.width_m * self.inside.depth_m
        for rule in CONTENTS[self.kind]:
            wanted = self.rng.chance(rule.p) and floor_m2 >= rule.from_m2
            # Each object that found a place is followed by another with the probability `more`.
            for _ in range(rule.most):
                wanted = wanted and self._place(rule) and self.rng.chance(rule.more)
        if self.rng.chance(STRAY_P):
            self._place(self.rng.pick(STRAYS))

    def _place(self, rule: FurnitureRule) -> bool:
        """Place an object; return True if there was a place for it."""
        rng, category = self.rng, assemblies.CATEGORIES[rule.category]
        size = tuple(round(v * rng.between(0.93, 1.07), 3) for v in category.size_m)
        shade = rng.between(0.88, 1.1)
        color = tuple(round(min(max(v * shade, 4.0), 250.0), 1) for v in rng.pick(category.colors))
        for pose, z_m in PLACES[rule.where](self, rule, size):
            x, y, quarter = pose
            item = PlacedItem(rule.category, round(x, 3), round(y, 3), quarter, size, color, z_m)
            if self._fits(item):
                self.placed.append(item)
                return True
        return False

    def draw_start(self) -> tuple[float, float, float]:
        """Return x, y and yaw in degrees of a place that a robot can start from."""
        rows, cols = np.nonzero(self._reachability.reachable_with(self.placed))
        k = self.rng.count(0, len(rows) - 1)
        x, y = self._reachability.xy_m(int(rows[k]), int(cols[k]))
        return round(x, 3), round(y, 3), float(self.rng.count(-179, 180))

    def newest(self, categories: tuple[str, ...]) -> PlacedItem | None:
        """Return the newest object of the first of these categories that the room has."""
        for category in categories:
            for item in reversed(self.placed):
                if item.category == category:
                    return item
        return None

    def _fits(self, new: PlacedItem) -> bool:
        """Return True if there is space for the object and all objects stay reachable."""
        if not self._has_space(new):
            return False
        return self._reachability.reachable_with([*self.placed, new]) is not None

    def _has_space(self, new: PlacedItem) -> bool:
        """Return True if the object is within the walls and overlaps nothing."""
        box = new.box
        if not self.inside.grown(_ROUNDING_M).holds(box):
            return False
        if new.category == "rug":
            return not any(o.category == "rug" and o.box.meets(box) for o in self.placed)
        if new.category == "picture":
            high = [o.box for o in self.placed if o.z_m + o.size_m[2] > _LOW_M]
            return not _any_meets([*high, *self._doorways], box.grown(0.15))
        if new.z_m > 0:
            on_top = [o.box for o in self.placed if o.z_m > 0 and o.category != "picture"]
            return not _any_meets(on_top, box)
        standing = [o.box for o in self.placed if o.z_m == 0 and o.category != "rug"]
        return not _any_meets([*standing, *self._doorways], box.grown(_GAP_M))


def _any_meets(boxes: list[Rect], box: Rect) -> bool:
    return any(other.meets(box) for other in boxes)


# The functions below yield poses to try for an object, each with the height of its underside.
# Their arguments are the room, the rule, and the object's size. "The object it belongs to" is an
# object of a category in `FurnitureRule.by`.
PosesToTry = Iterator[tuple[Pose, float]]
Size = tuple[float, float, float]
"""Depth, width, height [m]."""


def _by_wall(
    room: RoomFurnisher, rule: FurnitureRule, size: Size, in_corner: bool = False
) -> PosesToTry:
    """Yield poses with the back to a wall; half of them (or all, in a corner) at the wall's end."""
    rng = room.rng
    for _ in range(_TRIES):
        side = rng.count(0, 3)
        span = wall_span_m(room.inside, side)
        least, most = 0.5 * size[1] + 0.01, span - 0.5 * size[1] - 0.01
        if least > most:
            continue
        at_end = in_corner or rng.chance(0.5)
        along = rng.pick((least, most)) if at_end else rng.between(least, most)
        yield (*at_wall(room.inside, side, along, 0.5 * size[0]), side), 0.0


def _in_corner(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield poses in a corner, then by a wall."""
    yield from _by_wall(room, rule, size, in_corner=True)
    yield from _by_wall(room, rule, size)


def _hung(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield poses on a wall, higher than the furniture and the robot."""
    z_m = round(room.rng.between(1.3, 1.6), 3)
    return ((pose, z_m) for pose, _ in _by_wall(room, rule, size))


def _in_middle(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield poses near the middle of the room."""
    r, rng = room.inside, room.rng
    for _ in range(_TRIES):
        x = 0.5 * (r.x0 + r.x1) + r.width_m * rng.between(-0.15, 0.15)
        y = 0.5 * (r.y0 + r.y1) + r.depth_m * rng.between(-0.15, 0.15)
        yield (x, y, rng.count(0, 3)), 0.0


def _anywhere(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield poses in the entire room."""
    r, rng = room.inside, room.rng
    for _ in range(_TRIES):
        yield (rng.between(r.x0, r.x1), rng.between(r.y0, r.y1), rng.count(0, 3)), 0.0


def _next_to(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield poses to the left and right of the object it belongs to, with their backs in line."""
    other = room.newest(rule.by)
    if other is not None:
        aside = 0.5 * (other.size_m[1] + size[1]) + rule.gap_m
        for left in room.rng.shuffled((aside, -aside)):
            back = 0.5 * (size[0] - other.size_m[0])
            yield (*other.local(back, left), other.quarter), 0.0


def _before(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield the pose in front of the object it belongs to, facing it."""
    other = room.newest(rule.by)
    if other is not None:
        ahead = 0.5 * (other.size_m[0] + size[0]) + rule.gap_m
        yield (*other.local(ahead, 0.0), (other.quarter + 2) % 4), 0.0


def _around(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield free places at a table, facing it: two on each long side, one at each end."""
    table = room.newest(rule.by)
    if table is None:
        return
    ahead = 0.5 * (table.size_m[0] + size[0]) + rule.gap_m
    aside = 0.5 * (table.size_m[1] + size[0]) + rule.gap_m
    along = 0.25 * table.size_m[1]
    # Seats: distance ahead of the table's middle and to its left, quarter turns from the table's.
    seats = [(sign * ahead, left, 1 + sign) for sign in (1, -1) for left in (along, -along)]
    seats += [(0.0, sign * aside, 2 + sign) for sign in (1, -1)]
    for forward, left, turn in room.rng.shuffled(seats):
        yield (*table.local(forward, left), (table.quarter + turn) % 4), 0.0


def _across(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield the pose at the wall that the object it belongs to faces; then at any wall."""
    other = room.newest(rule.by)
    if other is not None:
        side = (other.quarter + 2) % 4
        x, y, r = other.x_m, other.y_m, room.inside
        along = x - r.x0 if side % 2 else y - r.y0
        half = 0.5 * size[1] + 0.01
        along = min(max(along, half), wall_span_m(r, side) - half)
        yield (*at_wall(r, side, along, 0.5 * size[0]), side), 0.0
    yield from _by_wall(room, rule, size)


def _on(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield a pose on top of the object it belongs to, if that is large enough."""
    other = room.newest(rule.by)
    if other is None or size[0] > other.size_m[0] or size[1] > 1.1 * other.size_m[1]:
        return
    slack = max(0.5 * (other.size_m[1] - size[1]), 0.0)
    left = room.rng.between(-slack, slack)
    yield (*other.local(0.0, left), other.quarter), other.size_m[2]


def _on_floor(room: RoomFurnisher, rule: FurnitureRule, size: Size) -> PosesToTry:
    """Yield poses for a rug: before or under the object it belongs to, or in the middle."""
    other = room.newest(rule.by)
    if other is not None:
        ahead = 0.0 if other.category == "coffee table" else 0.5 * other.size_m[0]
        for quarter in (other.quarter, (other.quarter + 1) % 4):
            yield (*other.local(ahead, 0.0), quarter), 0.0
    yield from _in_middle(room, rule, size)


PLACES: dict[str, Callable[[RoomFurnisher, FurnitureRule, Size], PosesToTry]] = {
    "wall": _by_wall,
    "corner": _in_corner,
    "middle": _in_middle,
    "anywhere": _anywhere,
    "beside": _next_to,
    "before": _before,
    "around": _around,
    "across": _across,
    "on": _on,
    "floor": _on_floor,
    "hung": _hung,
}
"""Generators of poses, by their name in `FurnitureRule.where`."""
