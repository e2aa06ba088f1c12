"""Random houses for training and evaluation: layouts, furniture, colours and sizes.

    house, appearances = random_house(seed)

The same seed gives the same house. Seeds from `HELD_OUT` on are for evaluation only.

The houses vary more than real homes (for those see `edge.lab.sim.generator`). A detector must know
an object by its looks, at any place and angle and in any colour. The project's published weights
depend on these draws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge.lab.sim import assemblies
from edge.lab.sim.generator.contents import FLOOR_COLORS, ON_TOP, SUPPORTS, USUAL_ON, WALL_COLORS
from edge.lab.sim.generator.rng import Rect, at_wall, wall_span_m
from edge.lab.sim.house import FLOORS, House, HouseObject, Opening, Room, Wall
from exporters.training.mini import looks

HELD_OUT = 100_000
"""Smaller seeds are for training, the others for evaluation."""

ROOMS: dict[str, tuple[str, ...]] = {
    "living room": (
        "sofa", "armchair", "coffee table", "tv stand", "bookshelf", "rug", "plant", "lamp",
        "picture", "cabinet",
    ),
    "kitchen": ("table", "chair", "chair", "refrigerator", "oven", "sink", "cabinet", "trash can"),
    "bedroom": ("bed", "nightstand", "wardrobe", "dresser", "rug", "lamp", "picture", "armchair"),
    "bathroom": ("toilet", "bathtub", "sink", "washing machine", "cabinet", "trash can"),
    "office": ("desk", "chair", "bookshelf", "desk", "lamp", "cabinet", "trash can", "stool"),
}  # fmt: skip
FREE = {"coffee table", "table", "chair", "stool", "ball", "box", "suitcase", "backpack",
        "trash can", "plant", "pillar", "rug", "armchair", "lamp"}  # fmt: skip
"""Furniture that may also stand away from the walls, at any angle."""
EXTRA = (
    *assemblies.CATEGORIES,
    *("sofa", "bed", "bathtub", "wardrobe", "tv stand", "backpack", "pillar", "microwave") * 4,
    *("table", "suitcase", "box", "television", "refrigerator", "dresser", "vase", "coffee table",
      "washing machine", "toilet", "oven", "ball") * 2,
)  # fmt: skip
"""Categories for random objects; those that rooms seldom have come more often."""
SQUARE = 0.6
"""If depth and width have at least this ratio, "wide" and "narrow" change both. Depth and width of
such an object look alike at any angle."""

_GAP_M = 0.05  # between objects
_FACING_DEG = (0.0, 90.0, 180.0, -90.0)  # yaw of an object at each side of a room
_SPLIT_FROM_M = 4.8
"""A room with a shorter longer side is not halved."""


@dataclass(frozen=True, slots=True)
class Look:
    """Words that apply to one object of a house.

    Attributes:
        category: index into `looks.CATEGORIES`, from 1.
        color: (1 + colours,) int8, answer for each of `looks.COLORS`: `looks.YES` (1), `NO` (0) or
            `UNSURE` (-1). Entry 0, no colour word, is YES.
        size: (1 + sizes,) int8, the same for `looks.SIZES`.
    """

    category: int
    color: np.ndarray
    size: np.ndarray


class _Builder:
    """Places objects in rooms without overlap."""

    def __init__(self, rng: np.random.Generator, height_m: float) -> None:
        self.rng, self.height_m = rng, height_m
        self.things: list[HouseObject] = []
        self.appearances: list[Look] = []
        self._taken: list[tuple[float, float, float]] = []
        self._rugs: list[tuple[float, float, float]] = []

    def chance(self, p: float) -> bool:
        return bool(self.rng.random() < p)

    def pick(self, choices):
        return choices[int(self.rng.integers(len(choices)))]

    def look(self, category: str, z_m: float = 0.0):
        """Return (size, colour, style) of a new object that fits under the ceiling."""
        rng, kind = self.rng, assemblies.CATEGORIES[category]
        size = np.array(kind.size_m) * rng.uniform(0.94, 1.06, 3)
        style = None
        if not self.chance(0.45):
            style = self.pick(looks.styles_of(category))
            w0, w1, h0, h1 = looks.STYLES[style]
            wide, high = rng.uniform(w0, w1), rng.uniform(h0, h1)
            ratio = min(size[0] / size[1], size[1] / size[0])
            alike = style in ("large", "small")
            factors = np.array(
                [wide if alike or ratio >= SQUARE else 1.0, wide, wide if alike else high]
            )
            if size[2] * factors[2] + z_m > self.height_m - 0.05:
                style = None
            else:
                size = size * factors
        size[2] = min(size[2], self.height_m - 0.05 - z_m)
        usual = self.chance(0.5)
        base = self.pick(kind.colors) if usual else looks.PALETTE[self.pick(looks.COLORS)]
        jitter = rng.uniform(0.88, 1.12) + rng.uniform(-0.05, 0.05, 3)
        color = np.clip(np.array(base) * jitter + rng.uniform(-6, 6), 4, 250)
        return tuple(map(float, size)), tuple(map(float, color)), style

    def add(self, category: str, at, yaw_deg: float, look, z_m: float = 0.0) -> None:
        size, color, style = look
        self.things.append(
            HouseObject(category=category, at=at, z_m=z_m, yaw_deg=yaw_deg, size=size, color=color)
        )
        colors = looks.color_answers(color) if looks.has_color(category) else looks.unsure_color()
        index = list(assemblies.CATEGORIES).index(category) + 1
        self.appearances.append(Look(index, colors, looks.size_answers(style, category)))

    def free(self, x: float, y: float, reach: float) -> bool:
        return all(math.hypot(x - a, y - b) > reach + r for a, b, r in self._taken)

    def take(self, x: float, y: float, reach: float) -> None:
        self._taken.append((x, y, reach))

    def by_wall(self, category: str, room: Rect, carried: str | None = None) -> bool:
        """Place an object at a random wall, facing into the room; see `_place` for `carried`."""
        look = self.look(category)
        depth, width = look[0][0], look[0][1]
        for _ in range(12):
            side = int(self.rng.integers(4))
            span = wall_span_m(room, side)
            if width > span - 0.3:
                continue
            along = self.rng.uniform(0.5 * width + 0.1, span - 0.5 * width - 0.1)
            off = 0.5 * depth + 0.07 + self.rng.uniform(0, 0.08)
            x, y = at_wall(room, side, along, off)
            if self._place(
                category, x, y, _FACING_DEG[side] + self.rng.uniform(-4, 4), look, carried
            ):
                return True
        return False

    def in_middle(self, category: str, room: Rect) -> bool:
        look = self.look(category)
        reach = 0.5 * max(look[0][0], look[0][1])
        if min(room.x1 - room.x0, room.y1 - room.y0) < 2 * reach + 0.6:
            return False
        for _ in range(12):
            x = self.rng.uniform(room.x0 + reach + 0.15, room.x1 - reach - 0.15)
            y = self.rng.uniform(room.y0 + reach + 0.15, room.y1 - reach - 0.15)
            if self._place(category, x, y, self.rng.uniform(-180, 180), look):
                return True
        return False

    def _place(
        self, category: str, x: float, y: float, yaw_deg: float, look, carried: str | None = None
    ) -> bool:
        """Place an object; return False if there is no room.

        `carried` is the object on top of it; None for a random one or none.
        """
        size = look[0]
        if category == "rug":  # objects may stand on rugs, but rugs do not overlap
            reach = 0.5 * max(size[:2])
            if any(math.hypot(x - a, y - b) < reach + r for a, b, r in self._rugs):
                return False
            self._rugs.append((x, y, reach))
            self.add(category, (x, y), yaw_deg, look)
            return True
        # Long things are a row of discs along their width.
        radius = 0.5 * size[0] + _GAP_M
        steps = max(1, math.ceil(size[1] / max(0.3, size[0])))
        yaw = math.radians(yaw_deg)
        spots = []
        for k in range(steps):
            off = ((k + 0.5) / steps - 0.5) * size[1]
            reach = max(radius, 0.5 * size[1] / steps + _GAP_M)
            spots.append((x - math.sin(yaw) * off, y + math.cos(yaw) * off, reach))
        if not all(self.free(*spot) for spot in spots):
            return False
        for spot in spots:
            self.take(*spot)
        self.add(category, (x, y), yaw_deg, look)
        if category in SUPPORTS and size[2] < 1.5 and (carried or self.chance(0.65)):
            self.on_top(carried or self.usual_load(category), x, y, yaw_deg, size)
        return True

    def usual_load(self, support: str) -> str:
        usual = USUAL_ON.get(support)
        return usual if usual and self.chance(0.6) else self.pick(ON_TOP)

    def on_top(self, category: str, x: float, y: float, yaw_deg: float, size) -> None:
        """Put an object on one of this size, if it fits."""
        look = self.look(category, size[2])
        need = look[0]
        if need[0] > size[0] * 1.3 or need[1] > size[1] * 1.1 or need[2] > 1.2:
            return
        slack = max(0.0, 0.5 * (size[1] - need[1]))
        off, yaw = self.rng.uniform(-slack, slack), math.radians(yaw_deg)
        at = (x - math.sin(yaw) * off, y + math.cos(yaw) * off)
        turn = self.rng.uniform(-25, 25) if category != "vase" else 0.0
        self.add(category, at, yaw_deg + turn, look, z_m=size[2])

    def hang(self, room: Rect) -> None:
        """Hang a picture on a wall."""
        look = self.look("picture", 1.6)
        side = int(self.rng.integers(4))
        span = wall_span_m(room, side)
        if look[0][1] > span - 0.4:
            return
        along = self.rng.uniform(0.5 * look[0][1] + 0.1, span - 0.5 * look[0][1] - 0.1)
        off = 0.06 + 0.5 * look[0][0] + 0.01
        x, y = at_wall(room, side, along, off)
        self.add("picture", (x, y), _FACING_DEG[side], look, z_m=float(self.rng.uniform(1.0, 1.55)))

    def put(self, category: str, room: Rect) -> None:
        """Place an object where its kind usually stands."""
        if category == "picture":
            self.hang(room)
        elif category in ("rug", "pillar") or (category in FREE and self.chance(0.6)):
            self.in_middle(category, room)
        elif category in ("laptop", "microwave", "television", "vase") and self.chance(0.85):
            self.by_wall(self.pick(SUPPORTS), room, carried=category)
        else:
            self.by_wall(category, room)

    def leaf(self, x: float, y: float, along_deg: float, width_m: float) -> None:
        """Place a door in its frame: shut, or open about one edge."""
        size, color, style = self.look("door")
        fits = style in (None, "tall", "short")
        size = (size[0], width_m if fits else size[1], size[2])
        open_deg = 0.0 if self.chance(0.35) else float(self.rng.uniform(50, 115))
        turn = open_deg * self.pick((1.0, -1.0))
        a, t = math.radians(along_deg), math.radians(along_deg + turn)
        hinge = (x - 0.5 * width_m * math.cos(a), y - 0.5 * width_m * math.sin(a))
        at = (hinge[0] + 0.5 * size[1] * math.cos(t), hinge[1] + 0.5 * size[1] * math.sin(t))
        # The leaf's width runs along its own y, so its front looks along the wall's normal.
        self.add("door", at, math.degrees(t) - 90.0, (size, color, style))


def random_house(seed: int) -> tuple[House, list[Look]]:
    """Return a house with a corner at 0, 0, and the looks of its objects, in their order."""
    rng = np.random.default_rng([7, seed])
    height = float(rng.uniform(2.45, 3.0))
    b = _Builder(rng, height)
    w, h = float(rng.uniform(6, 12)), float(rng.uniform(5.5, 10))
    rects, walls = _split(b, Rect(0.0, 0.0, w, h))
    walls += _outer_walls(b, w, h)
    rooms = []
    for k, rect in enumerate(rects):
        kind = b.pick(tuple(ROOMS))
        paint = np.array(b.pick(FLOOR_COLORS)) * rng.uniform(0.75, 1.15) + rng.uniform(-10, 10, 3)
        color = tuple(float(c) for c in np.clip(paint, 5, 250))
        floor = b.pick(tuple(FLOORS))
        rooms.append(
            Room(name=f"{kind} {k}", rect=(rect.x0, rect.y0, rect.x1, rect.y1), floor=floor,
                 color=color)
        )  # fmt: skip
        _fill(b, rect, kind)
    house = House(
        name=f"random-{seed}",
        start=(0.5 * w, 0.5 * h, 0.0),
        wall_height_m=height,
        rooms=tuple(rooms),
        walls=tuple(walls),
        objects=tuple(b.things),
    )
    return house, b.appearances


def extent_m(house: House) -> tuple[float, float]:
    """Return width (x) and depth (y) of a random house."""
    return max(room.rect[2] for room in house.rooms), max(room.rect[3] for room in house.rooms)


def _fill(b: _Builder, rect: Rect, kind: str) -> None:
    wanted = list(ROOMS[kind])
    b.rng.shuffle(wanted)
    area = (rect.x1 - rect.x0) * (rect.y1 - rect.y0)
    wanted = wanted[: max(3, int(area / 2.6))]
    wanted += [b.pick(EXTRA) for _ in range(int(b.rng.integers(3, 9)))]
    wanted.sort(key=lambda category: -assemblies.CATEGORIES[category].size_m[1])
    for category in wanted:
        b.put(category, rect)
        if b.chance(0.4) and category != "picture":
            b.put(category, rect)  # another of the same kind, with other looks


def _paint(b: _Builder) -> tuple[float, float, float]:
    color = np.array(b.pick(WALL_COLORS)) * b.rng.uniform(0.8, 1.06)
    if b.chance(0.12):
        color = np.array(looks.PALETTE[b.pick(looks.COLORS)])
    return tuple(float(c) for c in np.clip(color + b.rng.uniform(-6, 6, 3), 5, 250))


def _split(b: _Builder, whole: Rect) -> tuple[list[Rect], list[Wall]]:
    """Halve the largest room one to four times, with a doorway in each new wall."""
    rects, walls = [whole], []
    for _ in range(int(b.rng.integers(1, 5))):
        rects.sort(key=lambda r: (r.x1 - r.x0) * (r.y1 - r.y0))
        r = rects.pop()
        span_x, span_y = r.width_m, r.depth_m
        if max(span_x, span_y) < _SPLIT_FROM_M:
            rects.append(r)
            break
        f = float(b.rng.uniform(0.38, 0.62))
        door_w = float(b.rng.uniform(0.8, 1.2))
        if span_x >= span_y:
            x = r.x0 + f * span_x
            start, end, length, along = (x, r.y0), (x, r.y1), span_y, 90.0
            rects += [Rect(r.x0, r.y0, x, r.y1), Rect(x, r.y0, r.x1, r.y1)]
        else:
            y = r.y0 + f * span_y
            start, end, length, along = (r.x0, y), (r.x1, y), span_x, 0.0
            rects += [Rect(r.x0, r.y0, r.x1, y), Rect(r.x0, y, r.x1, r.y1)]
        at = float(b.rng.uniform(door_w, length - door_w))
        opening = Opening(at_m=at, width_m=door_w, height_m=float(b.rng.uniform(2.0, 2.2)))
        walls.append(Wall(start=start, end=end, color=_paint(b), openings=(opening,)))
        place = (start[0], start[1] + at) if along else (start[0] + at, start[1])
        if b.chance(0.6):
            b.leaf(*place, along, door_w - 0.06)
        b.take(*place, 0.5 * door_w + 0.25)
    return rects, walls


def _outer_walls(b: _Builder, w: float, h: float) -> list[Wall]:
    corners = ((0.0, 0.0), (w, 0.0), (w, h), (0.0, h))
    walls = []
    for k in range(4):
        start, end = corners[k], corners[(k + 1) % 4]
        length = math.dist(start, end)
        openings = []
        if b.chance(0.6):
            width = float(b.rng.uniform(0.9, 1.8))
            at = float(b.rng.uniform(width, length - width))
            sill = float(b.rng.uniform(0.8, 1.2))
            height = float(b.rng.uniform(0.9, 1.2))
            openings.append(Opening(at_m=at, width_m=width, height_m=height, sill_m=sill))
        walls.append(Wall(start=start, end=end, color=_paint(b), openings=tuple(openings)))
    return walls
