"""Generated outdoor world: a street with sidewalks, houses, cars, trees, poles, bins and benches.

    drawn = street(7)

The street has its own frame along the road. The origin of `map` is the robot's start pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from edge.config import Config, WorldStreet
from edge.geometry import SE2
from edge.lab.sim import kernels, shading
from edge.lab.sim.base import WorldObject
from edge.lab.sim.boxworld import BoxWorld, Primitive
from edge.lab.sim.generator.rng import PortableRng, Rect

RGB = tuple[float, float, float]
BEHIND_M, AHEAD_M = 14.0, 50.0  # length of the street behind and ahead of the origin
SLAB_M = 0.1  # thickness of the ground
_RNG_KEY = 16  # separates these random numbers from others with the same seed
_APART_M = 0.6  # least distance between objects, except between parked cars

CAR_COLOURS: dict[str, RGB] = {
    "red": (190, 40, 36), "blue": (40, 82, 170), "white": (236, 236, 234),
    "black": (34, 34, 38), "silver": (176, 180, 186), "green": (40, 110, 66),
    "yellow": (228, 190, 40),
}  # fmt: skip
BIN_COLOURS: dict[str, RGB] = {
    "green": (46, 120, 60), "blue": (44, 90, 170), "yellow": (226, 188, 44), "black": (40, 40, 44),
}  # fmt: skip
HOUSE_COLOURS: dict[str, RGB] = {
    "white": (232, 230, 224), "yellow": (226, 202, 140), "red": (168, 84, 66),
    "grey": (150, 152, 156),
}  # fmt: skip
GROUND_COLOURS: dict[str, RGB] = {
    "road": (78, 80, 86), "sidewalk": (176, 174, 168), "parking": (116, 116, 122),
}  # fmt: skip
_LAWN, _LEAF, _BARK, _STEEL = (96, 132, 74), (62, 128, 56), (104, 78, 54), (120, 124, 130)
_WINDOW, _TYRE, _WOOD = (58, 70, 82), (28, 28, 32), (150, 104, 62)
# Smallest and largest length, width and height.
_CAR_M = (4.0, 1.7, 1.4), (4.7, 1.85, 1.6)
_VAN_M = (4.8, 1.95, 2.1), (5.4, 2.05, 2.4)


@dataclass(frozen=True, slots=True)
class GroundArea:
    """A rectangle of drivable ground, in the road's frame.

    Areas with the same id form one region. `label` is a key of `GROUND_COLOURS`.
    """

    id: int
    label: str
    rect: Rect


@dataclass(frozen=True, slots=True)
class StreetObject:
    """An object in the street.

    Attributes:
        colour: colour word; "" if it has no single colour.
        x_m: position in the road's frame.
        y_m: position in the road's frame.
        yaw_rad: heading in the road's frame.
        size_m: extents along its heading, across it, and up, of the part on the ground (a tree's
            trunk).
        parts: primitives in its own frame: x along its heading, origin on the ground.
    """

    label: str
    colour: str
    x_m: float
    y_m: float
    yaw_rad: float
    size_m: tuple[float, float, float]
    parts: tuple[Primitive, ...]

    @property
    def rect(self) -> Rect:
        """Ground that it covers; its heading is along the road or across it."""
        along, across = 0.5 * self.size_m[0], 0.5 * self.size_m[1]
        if abs(math.sin(self.yaw_rad)) > 0.5:
            along, across = across, along
        return Rect(self.x_m - along, self.y_m - across, self.x_m + along, self.y_m + across)


@dataclass(frozen=True, slots=True)
class Street:
    """A street in the road's frame: x along its middle, y left.

    Attributes:
        start: the robot's start pose in the road's frame.
        width_m: from the farthest house on the right to the farthest on the left; centred.
        grounds: areas of the ground; later ones are on top of earlier ones.
        objects: objects on the street and next to it, in the order of placing.
    """

    name: str
    start: SE2
    width_m: float
    grounds: tuple[GroundArea, ...]
    objects: tuple[StreetObject, ...]

    def to_map(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> SE2:
        """Transform a pose from the road's frame to `map`, whose origin is the start."""
        c, s = math.cos(self.start.yaw_rad), math.sin(self.start.yaw_rad)
        dx, dy = x_m - self.start.x_m, y_m - self.start.y_m
        return SE2(c * dx + s * dy, -s * dx + c * dy, yaw_rad - self.start.yaw_rad)

    def ground_at(self, xy_m: np.ndarray) -> np.ndarray:
        """Return the ids of the ground at points (…, 2) in `map`, uint8; 0: no ground."""
        x_m, y_m = np.moveaxis(self.to_road(xy_m), -1, 0)
        found = np.zeros(x_m.shape, np.uint8)
        for ground in self.grounds:
            r = ground.rect
            found[(x_m >= r.x0) & (x_m < r.x1) & (y_m >= r.y0) & (y_m < r.y1)] = ground.id
        return found

    def to_road(self, xy_m: np.ndarray) -> np.ndarray:
        """Transform points (…, 2) from `map` to the road's frame."""
        c, s = math.cos(self.start.yaw_rad), math.sin(self.start.yaw_rad)
        return xy_m @ np.array([[c, s], [-s, c]]) + (self.start.x_m, self.start.y_m)


Break = tuple[int, float, float]
"""Part of the street at which no object may stand: side (-1 right, 1 left), from x, to x [m]."""


def street(*key: int) -> Street:
    """Return a street, the same on every computer for a key (a seed, or several integers).

    It has a road of two lanes with a sidewalk on each side, and by chance a side road or a parking
    area. Houses stand behind, cars at the kerbs and sometimes in the lane, and trees, poles, bins
    and benches. The robot starts in its lane or on a sidewalk, turned by up to 12 degrees.
    """
    rng = PortableRng(_RNG_KEY, *key)
    # Half the road's width, width of a sidewalk, and distance from it to the houses.
    half_m, walk_m, yard_m = rng.between(3.6, 4.4), rng.between(2.2, 3.2), rng.between(3.0, 6.0)
    outer_m = half_m + walk_m  # from the road's middle to the far side of a sidewalk
    grounds = [
        GroundArea(1, "road", Rect(-BEHIND_M, -half_m, AHEAD_M, half_m)),
        GroundArea(2, "sidewalk", Rect(-BEHIND_M, half_m, AHEAD_M, outer_m)),
        GroundArea(3, "sidewalk", Rect(-BEHIND_M, -outer_m, AHEAD_M, -half_m)),
    ]
    breaks: list[Break] = []
    # A side road, then a parking area that keeps clear of it; side: -1 right, 1 left.
    if rng.chance(0.5):
        side, x_m, width_m = rng.pick((-1, 1)), rng.between(16.0, 30.0), rng.between(5.5, 7.0)
        grounds.append(GroundArea(1, "road", _strip(side, x_m, x_m + width_m, half_m, 40.0)))
        breaks.append((side, x_m, x_m + width_m))
    if rng.chance(0.4):
        side, x_m = rng.pick((-1, 1)), rng.between(4.0, 12.0)
        park = _strip(side, x_m, x_m + 9.0, outer_m, outer_m + 6.0)
        if not any(park.meets(ground.rect.grown(1.0)) for ground in grounds[3:]):
            grounds.append(GroundArea(4, "parking", park))
            breaks.append((side, x_m, x_m + 9.0))
    start = _draw_start(rng, half_m, walk_m)
    placed = _PlacedObjects(rng, start, breaks)
    for side in (-1, 1):
        _place_houses(placed, side, outer_m + yard_m)
        _place_parked_cars(placed, side, half_m - 1.1)
        _place_at_sidewalk(placed, side, half_m, outer_m)
    if rng.chance(0.6):
        placed.place(_car(rng, rng.between(11.0, 24.0), -0.5 * half_m, 0.0))
    name = "street-" + "-".join(map(str, key))
    # Houses are up to 10 m deep.
    return Street(
        name, start, 2 * (outer_m + yard_m + 10.0), tuple(grounds), tuple(placed.accepted)
    )


def solids(drawn: Street) -> tuple[list[Primitive], list[tuple[StreetObject, list[Primitive]]]]:
    """Return the ground, and each object with its primitives, in `map`; z = 0 on the ground."""
    length_m, middle_m = AHEAD_M + BEHIND_M, 0.5 * (AHEAD_M - BEHIND_M)
    lawn = drawn.to_map(middle_m, 0.0)
    slab = Primitive(
        kernels.BOX, (0.0, 0.0, -0.5 * SLAB_M), (length_m, drawn.width_m, SLAB_M), _LAWN
    )
    floor = [slab.placed(lawn.x_m, lawn.y_m, 0.0, lawn.yaw_rad)]
    for k, ground in enumerate(drawn.grounds, start=1):
        rect = ground.rect
        at = drawn.to_map(0.5 * (rect.x0 + rect.x1), 0.5 * (rect.y0 + rect.y1))
        # Each one is a film higher, so that later ones are visible.
        high_m = 0.001 * k
        colour = GROUND_COLOURS[ground.label]
        film = Primitive(
            kernels.BOX, (0.0, 0.0, 0.5 * high_m), (rect.width_m, rect.depth_m, high_m), colour
        )
        floor.append(film.placed(at.x_m, at.y_m, 0.0, at.yaw_rad))
    objects = []
    for item in drawn.objects:
        at = drawn.to_map(item.x_m, item.y_m, item.yaw_rad)
        parts = [part.placed(at.x_m, at.y_m, 0.0, at.yaw_rad) for part in item.parts]
        objects.append((item, parts))
    return floor, objects


def load_street(section: WorldStreet, config: Config) -> BoxWorld:
    """Return the street of a seed, for the configured robot and camera."""
    drawn = street(section.seed)
    floor, objects = solids(drawn)
    furniture = []
    for k, (item, parts) in enumerate(objects, start=1):
        at = drawn.to_map(item.x_m, item.y_m, item.yaw_rad)
        center = (at.x_m, at.y_m, 0.5 * item.size_m[2])
        name = f"{item.colour} {item.label} {k}".strip()
        world_object = WorldObject(k, name, item.label, item.label, center, item.size_m, at.yaw_rad)
        furniture.append((world_object, parts))
    camera = config.sensors.camera
    return BoxWorld(
        drawn.name,
        floor,
        furniture,
        SE2(0.0, 0.0, 0.0),
        config.robot.height_m,
        (camera.depth_min_m, camera.depth_max_m),
    )


class _PlacedObjects:
    """Objects placed so far; refuses overlaps, breaks, and the surroundings of the start."""

    def __init__(self, rng: PortableRng, start: SE2, breaks: list[Break]) -> None:
        self.rng, self._breaks = rng, breaks
        self.accepted: list[StreetObject] = []
        self._taken = [Rect(start.x_m - 2.0, start.y_m - 1.5, start.x_m + 4.0, start.y_m + 1.5)]

    def place(self, item: StreetObject, apart_m: float = _APART_M) -> None:
        """Place an object if nothing is nearer to it than `apart_m`; leave it out otherwise."""
        side = 1 if item.y_m > 0 else -1
        rect = item.rect
        in_break = any(s == side and rect.x0 < x1 and rect.x1 > x0 for s, x0, x1 in self._breaks)
        if in_break or any(rect.grown(apart_m).meets(taken) for taken in self._taken):
            return
        self._taken.append(rect)
        self.accepted.append(item)


def _strip(side: int, x0: float, x1: float, inner_m: float, outer_m: float) -> Rect:
    """Return a rectangle on one side of the road (-1 right, 1 left), from `x0` to `x1`.

    `inner_m` and `outer_m` are the distances of its long sides from the road's middle.
    """
    low, high = sorted((side * inner_m, side * outer_m))
    return Rect(x0, low, x1, high)


def _draw_start(rng: PortableRng, half_m: float, walk_m: float) -> SE2:
    """Return a start pose in the right lane or on a sidewalk."""
    lane = rng.chance(0.6)
    y_m = -0.5 * half_m if lane else rng.pick((-1, 1)) * (half_m + 0.5 * walk_m)
    return SE2(0.0, y_m, math.radians(rng.between(-12.0, 12.0)))


def _place_houses(placed: _PlacedObjects, side: int, y_m: float) -> None:
    """Place a row of houses with their fronts at a distance `y_m` from the road's middle."""
    rng, x_m = placed.rng, -BEHIND_M
    while x_m < AHEAD_M - 8.0:
        size = rng.between(8.0, 13.0), rng.between(7.0, 9.5), rng.between(4.5, 8.0)
        colour = rng.pick(tuple(HOUSE_COLOURS))
        parts = (
            _box((0, 0, 0.5 * size[2]), size, HOUSE_COLOURS[colour]),
            *(  # two rows of three windows in the front
                _box((u * size[0], -side * 0.5 * size[1], z * size[2]), (1.2, 0.04, 1.3), _WINDOW)
                for u in (-0.3, 0.0, 0.3) for z in (0.3, 0.72)
            ),
        )  # fmt: skip
        at = x_m + 0.5 * size[0], side * (y_m + 0.5 * size[1])
        placed.place(StreetObject("house", colour, *at, 0.0, size, parts))
        x_m += size[0] + rng.between(3.0, 7.0)


def _place_parked_cars(placed: _PlacedObjects, side: int, y_m: float) -> None:
    """Place parked cars in a row, with gaps."""
    rng, x_m = placed.rng, -BEHIND_M + 4.0
    while x_m < AHEAD_M - 6.0:
        if rng.chance(0.45):
            placed.place(_car(rng, x_m, side * y_m, math.pi if side > 0 else 0.0), 0.8)
        x_m += rng.between(5.8, 8.0)


def _place_at_sidewalk(placed: _PlacedObjects, side: int, half_m: float, outer_m: float) -> None:
    """Place poles at the kerb, and trees, bins and benches on the far side of the sidewalk."""
    rng = placed.rng
    for x_m in np.arange(-6.0, AHEAD_M - 4.0, 14.0).tolist():
        placed.place(_pole(x_m + rng.between(-2.0, 2.0), side * (half_m + 0.25)))
    for _ in range(rng.count(2, 4)):
        placed.place(_tree(rng, rng.between(4.0, 42.0), side * (outer_m + 0.7)))
    for _ in range(rng.count(1, 3)):
        make = rng.pick((_bin, _bin, _bench))
        placed.place(make(rng, rng.between(5.0, 40.0), side * (outer_m - 0.45), side))


def _car(rng: PortableRng, x_m: float, y_m: float, yaw_rad: float) -> StreetObject:
    """Return a car or a van; a van is a closed box behind a short bonnet."""
    is_van = rng.chance(0.2)
    low, high = _VAN_M if is_van else _CAR_M
    size = tuple(rng.between(a, b) for a, b in zip(low, high, strict=True))
    length, width, height = size
    colour = rng.pick(tuple(CAR_COLOURS))
    # Heights of the body's upper side and of the windows' middle; the cabin's length and its x.
    paint, belt, glass = CAR_COLOURS[colour], 0.55 * height, 0.72 * height
    cabin, back = (0.78 * length, -0.1 * length) if is_van else (0.5 * length, -0.06 * length)
    parts = (
        _box((0, 0, 0.5 * (belt + 0.18)), (length, width, belt - 0.18), paint),
        _box((back, 0, 0.5 * (belt + height)), (cabin, 0.92 * width, height - belt), paint),
        _box((back, 0, glass), (0.99 * cabin, 0.94 * width, 0.2 * height), _WINDOW),
        *(
            _box((x * length, y * width, 0.3), (0.62, 0.2, 0.6), _TYRE)
            for x in (-0.31, 0.31) for y in (-0.41, 0.41)
        ),
    )  # fmt: skip
    return StreetObject("van" if is_van else "car", colour, x_m, y_m, yaw_rad, size, parts)


def _tree(rng: PortableRng, x_m: float, y_m: float) -> StreetObject:
    """Return a tree: a trunk and a crown."""
    height, crown = rng.between(4.5, 7.5), rng.between(2.4, 3.6)
    trunk = Primitive(kernels.CYLINDER, (0, 0, 0.3 * height), (0.4, 0.4, 0.6 * height), _BARK)
    middle = (0.0, 0.0, height - 0.55 * crown)
    leaves = Primitive(
        kernels.ELLIPSOID, middle, (crown, crown, 1.1 * crown), _LEAF, shading.FOLIAGE
    )
    return StreetObject("tree", "", x_m, y_m, 0.0, (0.4, 0.4, height), (trunk, leaves))


def _pole(x_m: float, y_m: float) -> StreetObject:
    post = Primitive(kernels.CYLINDER, (0, 0, 2.5), (0.18, 0.18, 5.0), _STEEL)
    return StreetObject("pole", "", x_m, y_m, 0.0, (0.18, 0.18, 5.0), (post,))


def _bin(rng: PortableRng, x_m: float, y_m: float, side: int) -> StreetObject:
    """Return a bin with a lid; `side` is only there for the same arguments as `_bench`."""
    colour, size = rng.pick(tuple(BIN_COLOURS)), (0.6, 0.6, 1.1)
    lid = _box((0, 0, 1.06), (0.64, 0.64, 0.08), _TYRE)
    body = _box((0, 0, 0.51), (0.6, 0.6, 1.02), BIN_COLOURS[colour])
    return StreetObject("trash can", colour, x_m, y_m, 0.0, size, (body, lid))


def _bench(rng: PortableRng, x_m: float, y_m: float, side: int) -> StreetObject:
    """Return a bench that faces the road."""
    parts = (
        _box((0, 0, 0.43), (0.45, 1.6, 0.06), _WOOD),
        _box((-0.2, 0, 0.68), (0.06, 1.6, 0.4), _WOOD),
        *(_box((0, y, 0.2), (0.4, 0.08, 0.4), _STEEL) for y in (-0.7, 0.7)),
    )
    return StreetObject("bench", "", x_m, y_m, -side * 0.5 * math.pi, (0.45, 1.6, 0.88), parts)


def _box(center: tuple, size: tuple, colour: RGB) -> Primitive:
    """Return a box in an object's own frame."""
    return Primitive(kernels.BOX, tuple(map(float, center)), tuple(map(float, size)), colour)
