"""Random houses whose images the small detector is trained on and evaluated with.

    house, appearances = random_house(seed)

The same seed gives the same house. Seeds from `HELD_OUT` on are for evaluation only.

The houses vary more than real homes (for those see `edge.lab.sim.generator`). A detector must know
an object by its looks, at any place and angle and in any colour. The project's published weights
depend on these draws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.lab.sim import assemblies
from edge.lab.sim.generator.contents import FLOOR_COLORS, ON_TOP, SUPPORTS, USUAL_ON, WALL_COLORS
from edge.lab.sim.generator.rng import Rect, at_wall, wall_span_m
from edge.lab.sim.house import FLOORS, House, HouseObject, Opening, Room, Wall
from exporters.training.mini import looks

HELD_OUT = 100_000
"""Smaller seeds are for training, the others for evaluation."""

# Categories of the furniture of a room, by its kind.
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
_FREE_STANDING = {"coffee table", "table", "chair", "stool", "ball", "box", "suitcase", "backpack",
        "trash can", "plant", "pillar", "rug", "armchair", "lamp"}  # fmt: skip
"""Furniture that may also stand away from the walls, at any angle."""
_EXTRA = (
    *assemblies.CATEGORIES,
    *("sofa", "bed", "bathtub", "wardrobe", "tv stand", "backpack", "pillar", "microwave") * 4,
    *("table", "suitcase", "box", "television", "refrigerator", "dresser", "vase", "coffee table",
      "washing machine", "toilet", "oven", "ball") * 2,
)  # fmt: skip
"""Categories of random objects in any room; a category that rooms rarely have is repeated."""
_NEARLY_SQUARE = 0.6
"""If the shorter of depth and width is at least this share of the longer one, the words "wide" and
"narrow" change both: a person cannot tell the depth of such an object from its width."""

_GAP_M = 0.05  # smallest gap between objects
_UNDER_CEILING_M = 0.05  # smallest gap between an object and the ceiling
_TRIES = 12  # places to try for an object
_FACING_DEG = (0.0, 90.0, 180.0, -90.0)  # yaw of an object at each wall of a room
_SPLIT_FROM_M = 4.8
"""A room whose longer side is shorter than this is not halved."""


@dataclass(frozen=True, slots=True)
class Appearance:
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


class _Drawn(NamedTuple):
    """Size, colour and size word that were drawn for an object.

    Attributes:
        size: depth, width, height [m].
        color: r, g, b, each 0 to 255.
        size_word: key of `looks.STYLES`; None for the usual size.
    """

    size: tuple[float, float, float]
    color: tuple[float, float, float]
    size_word: str | None


class _Builder:
    """Places objects in the rooms of a house without overlap.

    Attributes:
        rng: draws everything, so the order of the calls decides the house.
        objects: objects placed so far.
        appearances: their appearances, in the same order.
    """

    def __init__(self, rng: np.random.Generator, height_m: float) -> None:
        self.rng, self.height_m = rng, height_m
        self.objects: list[HouseObject] = []
        self.appearances: list[Appearance] = []
        # Discs (x, y, radius) [m] of the occupied floor, and of the rugs.
        self._occupied: list[tuple[float, float, float]] = []
        self._rugs: list[tuple[float, float, float]] = []

    def chance(self, p: float) -> bool:
        """Draw True with the probability `p`."""
        return bool(self.rng.random() < p)

    def pick(self, choices):
        """Draw one of the choices."""
        return choices[int(self.rng.integers(len(choices)))]

    def draw_look(self, category: str, z_m: float = 0.0) -> _Drawn:
        """Draw size and colour of an object with its underside at `z_m`; it fits in the room."""
        rng, kind = self.rng, assemblies.CATEGORIES[category]
        size = np.array(kind.size_m) * rng.uniform(0.94, 1.06, 3)
        size_word = None
        if not self.chance(0.45):
            size_word = self.pick(looks.styles_of(category))
            w0, w1, h0, h1 = looks.STYLES[size_word]
            wide, high = rng.uniform(w0, w1), rng.uniform(h0, h1)
            ratio = min(size[0] / size[1], size[1] / size[0])
            is_uniform = size_word in ("large", "small")  # one factor for all three sides
            deep = wide if is_uniform or ratio >= _NEARLY_SQUARE else 1.0
            # Factors on depth, width and height.
            factors = np.array([deep, wide, wide if is_uniform else high])
            if size[2] * factors[2] + z_m > self.height_m - _UNDER_CEILING_M:
                size_word = None  # too high: keep the usual size
            else:
                size = size * factors
        size[2] = min(size[2], self.height_m - _UNDER_CEILING_M - z_m)
        usual = self.chance(0.5)
        base = self.pick(kind.colors) if usual else looks.PALETTE[self.pick(looks.COLORS)]
        jitter = rng.uniform(0.88, 1.12) + rng.uniform(-0.05, 0.05, 3)
        color = np.clip(np.array(base) * jitter + rng.uniform(-6, 6), 4, 250)
        return _Drawn(tuple(map(float, size)), tuple(map(float, color)), size_word)

    def _add(
        self,
        category: str,
        at: tuple[float, float],
        yaw_deg: float,
        drawn: _Drawn,
        z_m: float = 0.0,
    ) -> None:
        """Add an object without a check, and the words that apply to it."""
        size, color, size_word = drawn
        self.objects.append(
            HouseObject(category=category, at=at, z_m=z_m, yaw_deg=yaw_deg, size=size, color=color)
        )
        colors = looks.color_answers(color) if looks.has_color(category) else looks.unsure_color()
        index = list(assemblies.CATEGORIES).index(category) + 1
        self.appearances.append(Appearance(index, colors, looks.size_answers(size_word, category)))

    def _is_free(self, x: float, y: float, radius: float) -> bool:
        """Return True if a disc on the floor overlaps no occupied one."""
        return all(math.hypot(x - a, y - b) > radius + r for a, b, r in self._occupied)

    def occupy(self, x: float, y: float, radius: float) -> None:
        """Keep further objects out of a disc on the floor."""
        self._occupied.append((x, y, radius))

    def _place_by_wall(self, category: str, room: Rect, carried: str | None = None) -> bool:
        """Place an object at a random wall, facing into the room; see `_place_at` for `carried`."""
        drawn = self.draw_look(category)
        depth, width, _ = drawn.size
        for _ in range(_TRIES):
            side = int(self.rng.integers(4))
            span = wall_span_m(room, side)
            if width > span - 0.3:
                continue
            along = self.rng.uniform(0.5 * width + 0.1, span - 0.5 * width - 0.1)
            off = 0.5 * depth + 0.07 + self.rng.uniform(0, 0.08)
            x, y = at_wall(room, side, along, off)
            yaw_deg = _FACING_DEG[side] + self.rng.uniform(-4, 4)
            if self._place_at(category, x, y, yaw_deg, drawn, carried):
                return True
        return False

    def _place_in_middle(self, category: str, room: Rect) -> bool:
        """Place an object away from the walls, at any angle; return True if there was space."""
        drawn = self.draw_look(category)
        half = 0.5 * max(drawn.size[:2])
        if min(room.x1 - room.x0, room.y1 - room.y0) < 2 * half + 0.6:
            return False
        for _ in range(_TRIES):
            x = self.rng.uniform(room.x0 + half + 0.15, room.x1 - half - 0.15)
            y = self.rng.uniform(room.y0 + half + 0.15, room.y1 - half - 0.15)
            if self._place_at(category, x, y, self.rng.uniform(-180, 180), drawn):
                return True
        return False

    def _place_at(
        self,
        category: str,
        x: float,
        y: float,
        yaw_deg: float,
        drawn: _Drawn,
        carried: str | None = None,
    ) -> bool:
        """Place an object; return False if there is no space.

        `carried` is the category of the object on top of it; with None there is a random one or
        none.
        """
        depth, width, height = drawn.size
        if category == "rug":  # objects may stand on rugs, but rugs do not overlap
            half = 0.5 * max(depth, width)
            if any(math.hypot(x - a, y - b) < half + r for a, b, r in self._rugs):
                return False
            self._rugs.append((x, y, half))
            self._add(category, (x, y), yaw_deg, drawn)
            return True
        # An object occupies a row of discs along its width.
        count = max(1, math.ceil(width / max(0.3, depth)))
        radius = max(0.5 * depth, 0.5 * width / count) + _GAP_M
        yaw = math.radians(yaw_deg)
        discs = []
        for k in range(count):
            off = ((k + 0.5) / count - 0.5) * width
            discs.append((x - math.sin(yaw) * off, y + math.cos(yaw) * off, radius))
        if not all(self._is_free(*disc) for disc in discs):
            return False
        for disc in discs:
            self.occupy(*disc)
        self._add(category, (x, y), yaw_deg, drawn)
        if category in SUPPORTS and height < 1.5 and (carried or self.chance(0.65)):
            self._place_on(carried or self._draw_load(category), x, y, yaw_deg, drawn.size)
        return True

    def _draw_load(self, support: str) -> str:
        """Draw the category of an object on top of a piece of furniture."""
        usual = USUAL_ON.get(support)
        return usual if usual and self.chance(0.6) else self.pick(ON_TOP)

    def _place_on(
        self,
        category: str,
        x: float,
        y: float,
        yaw_deg: float,
        support_size: tuple[float, float, float],
    ) -> None:
        """Put an object on top of one with this pose and size, if it fits."""
        support_depth, support_width, support_height = support_size
        drawn = self.draw_look(category, support_height)
        depth, width, height = drawn.size
        if depth > support_depth * 1.3 or width > support_width * 1.1 or height > 1.2:
            return
        slack = max(0.0, 0.5 * (support_width - width))
        off, yaw = self.rng.uniform(-slack, slack), math.radians(yaw_deg)
        at = (x - math.sin(yaw) * off, y + math.cos(yaw) * off)
        turn = self.rng.uniform(-25, 25) if category != "vase" else 0.0
        self._add(category, at, yaw_deg + turn, drawn, z_m=support_height)

    def _hang_picture(self, room: Rect) -> None:
        """Hang a picture on a random wall, if the wall is long enough."""
        drawn = self.draw_look("picture", 1.6)
        depth, width, _ = drawn.size
        side = int(self.rng.integers(4))
        span = wall_span_m(room, side)
        if width > span - 0.4:
            return
        along = self.rng.uniform(0.5 * width + 0.1, span - 0.5 * width - 0.1)
        x, y = at_wall(room, side, along, 0.06 + 0.5 * depth + 0.01)
        z_m = float(self.rng.uniform(1.0, 1.55))
        self._add("picture", (x, y), _FACING_DEG[side], drawn, z_m=z_m)

    def place(self, category: str, room: Rect) -> None:
        """Place an object where its kind usually stands."""
        if category == "picture":
            self._hang_picture(room)
        elif category in ("rug", "pillar") or (category in _FREE_STANDING and self.chance(0.6)):
            self._place_in_middle(category, room)
        elif category in ("laptop", "microwave", "television", "vase") and self.chance(0.85):
            self._place_by_wall(self.pick(SUPPORTS), room, carried=category)
        else:
            self._place_by_wall(category, room)

    def place_door(self, x: float, y: float, along_deg: float, width_m: float) -> None:
        """Place the leaf of a door in its frame: shut, or turned open about one edge.

        Args:
            x: x of the doorway's middle [m].
            y: y of the doorway's middle [m].
            along_deg: direction of the wall.
            width_m: width of the doorway.
        """
        (depth, width, height), color, size_word = self.draw_look("door")
        # A leaf that is called wide, narrow, large or small keeps its width, to fit the word.
        if size_word in (None, "tall", "short"):
            width = width_m
        size = (depth, width, height)
        open_deg = 0.0 if self.chance(0.35) else float(self.rng.uniform(50, 115))
        turn = open_deg * self.pick((1.0, -1.0))
        a, t = math.radians(along_deg), math.radians(along_deg + turn)
        hinge = (x - 0.5 * width_m * math.cos(a), y - 0.5 * width_m * math.sin(a))
        at = (hinge[0] + 0.5 * width * math.cos(t), hinge[1] + 0.5 * width * math.sin(t))
        # The leaf's width runs along its own y, so its front looks along the wall's normal.
        self._add("door", at, math.degrees(t) - 90.0, _Drawn(size, color, size_word))


def random_house(seed: int) -> tuple[House, list[Appearance]]:
    """Return a house with a corner at 0, 0, and the appearance of each of its objects."""
    rng = np.random.default_rng([7, seed])
    height_m = float(rng.uniform(2.45, 3.0))
    b = _Builder(rng, height_m)
    x1, y1 = float(rng.uniform(6, 12)), float(rng.uniform(5.5, 10))
    rects, walls = _split(b, Rect(0.0, 0.0, x1, y1))
    walls += _outer_walls(b, x1, y1)
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
        start=(0.5 * x1, 0.5 * y1, 0.0),
        wall_height_m=height_m,
        rooms=tuple(rooms),
        walls=tuple(walls),
        objects=tuple(b.objects),
    )
    return house, b.appearances


def extent_m(house: House) -> tuple[float, float]:
    """Return width (x) and depth (y) of a random house."""
    return max(room.rect[2] for room in house.rooms), max(room.rect[3] for room in house.rooms)


def _fill(b: _Builder, rect: Rect, kind: str) -> None:
    """Place furniture of the kind of room, and random objects, widest first."""
    wanted = list(ROOMS[kind])
    b.rng.shuffle(wanted)
    area = (rect.x1 - rect.x0) * (rect.y1 - rect.y0)
    wanted = wanted[: max(3, int(area / 2.6))]
    wanted += [b.pick(_EXTRA) for _ in range(int(b.rng.integers(3, 9)))]
    wanted.sort(key=lambda category: -assemblies.CATEGORIES[category].size_m[1])
    for category in wanted:
        b.place(category, rect)
        if b.chance(0.4) and category != "picture":
            b.place(category, rect)  # another of the same kind, with another appearance


def _wall_color(b: _Builder) -> tuple[float, float, float]:
    """Draw the colour of a wall: mostly a usual one, at times one of the palette."""
    color = np.array(b.pick(WALL_COLORS)) * b.rng.uniform(0.8, 1.06)
    if b.chance(0.12):
        color = np.array(looks.PALETTE[b.pick(looks.COLORS)])
    return tuple(float(c) for c in np.clip(color + b.rng.uniform(-6, 6, 3), 5, 250))


def _split(b: _Builder, full: Rect) -> tuple[list[Rect], list[Wall]]:
    """Halve the largest room one to four times, with a doorway in each new wall."""
    rects, walls = [full], []
    for _ in range(int(b.rng.integers(1, 5))):
        rects.sort(key=lambda r: (r.x1 - r.x0) * (r.y1 - r.y0))
        r = rects.pop()
        span_x, span_y = r.width_m, r.depth_m
        if max(span_x, span_y) < _SPLIT_FROM_M:
            rects.append(r)
            break
        f = float(b.rng.uniform(0.38, 0.62))  # the new wall's place along the longer side
        door_w = float(b.rng.uniform(0.8, 1.2))
        if span_x >= span_y:
            x = r.x0 + f * span_x
            start, end, length, along_deg = (x, r.y0), (x, r.y1), span_y, 90.0
            rects += [Rect(r.x0, r.y0, x, r.y1), Rect(x, r.y0, r.x1, r.y1)]
        else:
            y = r.y0 + f * span_y
            start, end, length, along_deg = (r.x0, y), (r.x1, y), span_x, 0.0
            rects += [Rect(r.x0, r.y0, r.x1, y), Rect(r.x0, y, r.x1, r.y1)]
        at = float(b.rng.uniform(door_w, length - door_w))
        opening = Opening(at_m=at, width_m=door_w, height_m=float(b.rng.uniform(2.0, 2.2)))
        walls.append(Wall(start=start, end=end, color=_wall_color(b), openings=(opening,)))
        place = (start[0], start[1] + at) if along_deg else (start[0] + at, start[1])
        if b.chance(0.6):
            b.place_door(*place, along_deg, door_w - 0.06)
        b.occupy(*place, 0.5 * door_w + 0.25)
    return rects, walls


def _outer_walls(b: _Builder, x1: float, y1: float) -> list[Wall]:
    """Return the walls from (0, 0) to (x1, y1) [m], some with a window."""
    corners = ((0.0, 0.0), (x1, 0.0), (x1, y1), (0.0, y1))
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
        walls.append(Wall(start=start, end=end, color=_wall_color(b), openings=tuple(openings)))
    return walls
