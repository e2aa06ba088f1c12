"""Houses read from our JSON format: rooms, walls with openings, and furniture.

`houses/demo.json` shows every field. `edge.lab.sim.generator` makes such houses from a seed, and
`build_house` makes a world of them. Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, field_validator

from edge import names
from edge.config import Config, Section, WorldHouse
from edge.config.section import Positive
from edge.geometry import SE2
from edge.host import resources
from edge.host.files import read_regular
from edge.lab.sim import assemblies, kernels, shading
from edge.lab.sim.base import WorldError, WorldObject
from edge.lab.sim.boxworld import BoxWorld, Primitive, room_slabs
from edge.text import bounded_repr

HOUSES = Path(__file__).resolve().parent / "houses"
FLOORS = {
    "wood": shading.PLANKS,
    "tiles": shading.TILES,
    "carpet": shading.FABRIC,
    "plain": shading.PLAIN,
}
"""Texture of a floor by its name in the file."""
_SKIRTING = (232.0, 230.0, 224.0)  # colour of the board along the foot of a wall

Point = tuple[float, float]
Channel = Annotated[float, Field(ge=0, le=255)]
Color = tuple[Channel, Channel, Channel]


class Room(Section):
    """A rectangular room: its floor and ceiling.

    Attributes:
        name: unique name: the kind of room, with a number if there are several.
        rect: x0, y0, x1, y1.
    """

    name: str
    rect: tuple[float, float, float, float]
    floor: Literal["wood", "tiles", "carpet", "plain"] = "wood"
    color: Color = (176, 132, 88)


class Opening(Section):
    """A door, or a window if it has a sill.

    Attributes:
        at_m: distance of its middle from the wall's start.
        height_m: height of the gap, above the sill.
        sill_m: height of the wall below it.
    """

    at_m: float
    width_m: Positive = 0.95
    height_m: Positive = 2.05
    sill_m: float = 0.0


class Wall(Section):
    """A straight wall from floor to ceiling; `start` and `end` are x and y of its ends."""

    start: Point
    end: Point
    color: Color = (226, 222, 212)
    openings: tuple[Opening, ...] = ()


class HouseObject(Section):
    """An object in the house.

    Attributes:
        category: key of `edge.lab.sim.assemblies.CATEGORIES`, which gives the shape.
        at: x and y of its centre.
        z_m: height of its underside above the floor.
        yaw_deg: direction of its front; 0 is +x.
        size: depth, width, height; by default the category's usual size.
        color: by default the category's first colour.
    """

    category: str
    at: Point
    z_m: float = 0.0
    yaw_deg: float = 0.0
    size: tuple[Positive, Positive, Positive] | None = None
    color: Color | None = None

    @field_validator("category")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in assemblies.CATEGORIES:
            choices = ", ".join(assemblies.CATEGORIES)
            raise ValueError(f"unknown category (choices: {choices})")
        return value


class House(Section):
    """Content of a house file; `start` is the robot's x, y and yaw in degrees."""

    name: str
    start: tuple[float, float, float]
    wall_height_m: Positive = 2.6
    wall_thickness_m: Positive = 0.12
    ceiling: bool = True
    rooms: tuple[Room, ...] = ()
    walls: tuple[Wall, ...] = ()
    objects: tuple[HouseObject, ...] = ()


def read_house(path: Path) -> House:
    """Read and validate a house file.

    Raises:
        WorldError: one line with file, place and fault.
    """
    try:
        data = json.loads(read_regular(path))
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise WorldError(f"{path}: not a JSON file: {error}") from None
    try:
        return House.model_validate(data)
    except ValidationError as error:
        fault, more = error.errors()[0], error.error_count() - 1
        place = ".".join(str(part) for part in fault["loc"]) or "top"
        message = fault["msg"].removeprefix("Value error, ")
        rest = f" ({more} more faults)" if more else ""
        raise WorldError(
            f"{path}: {place}: {message}, got {bounded_repr(fault.get('input'), 60)}{rest}"
        ) from None


def load_house(section: WorldHouse, config: Config) -> BoxWorld:
    """Load a built-in house by name, or a house from a JSON file.

    Raises:
        WorldError: no such house, or a fault in its file.
    """
    built_in = HOUSES / f"{section.house}.json"
    path = built_in if built_in.is_file() else resources.expand(section.house)
    if not path.is_file():
        choices = ", ".join(sorted(p.stem for p in HOUSES.glob("*.json")))
        raise WorldError(
            f"{config.locate('sim.world.house')}: no file {path}; give a house file, or a "
            f"built-in house ({choices})"
        )
    return build_house(read_house(path), config)


def build_house(house: House, config: Config) -> BoxWorld:
    """Return the world of a validated house."""
    ceiling_m = house.wall_height_m if house.ceiling else None
    structure = [
        part
        for room in house.rooms
        for part in room_slabs(room.rect, room.color, FLOORS[room.floor], ceiling_m)
    ]
    structure += [part for wall in house.walls for part in _wall_parts(wall, house)]
    furniture = [_object_parts(k + 1, item) for k, item in enumerate(house.objects)]
    camera = config.sensors.camera
    x_m, y_m, yaw_deg = house.start
    return BoxWorld(
        house.name,
        structure,
        furniture,
        SE2(x_m, y_m, math.radians(yaw_deg)),
        config.robot.height_m,
        (camera.depth_min_m, camera.depth_max_m),
        tuple((room.rect,) for room in house.rooms),
        tuple(room.name.rstrip("0123456789 ") for room in house.rooms),
    )


def _wall_parts(wall: Wall, house: House) -> list[Primitive]:
    """Return the solid parts of a wall: between, above and below its openings."""
    (x0, y0), (x1, y1) = wall.start, wall.end
    length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
    parts: list[Primitive] = []

    def add_part(a: float, b: float, z0: float, z1: float) -> None:
        """Add the part from `a` to `b` along the wall, between two heights."""
        if b - a < 1e-6 or z1 - z0 < 1e-6:
            return
        mid = (0.5 * (a + b), 0.0, 0.5 * (z0 + z1))
        size = (b - a, house.wall_thickness_m, z1 - z0)
        parts.append(Primitive(kernels.BOX, mid, size, wall.color, shading.PAINT))
        if z0 == 0.0:
            foot = (b - a, house.wall_thickness_m + 0.02, 0.08)
            parts.append(Primitive(kernels.BOX, (mid[0], 0.0, 0.04), foot, _SKIRTING))

    # The ends extend by half a thickness, so that corners close.
    at = -0.5 * house.wall_thickness_m
    for opening in sorted(wall.openings, key=lambda o: o.at_m):
        left, right = opening.at_m - 0.5 * opening.width_m, opening.at_m + 0.5 * opening.width_m
        add_part(at, left, 0.0, house.wall_height_m)
        add_part(left, right, 0.0, opening.sill_m)
        add_part(left, right, opening.sill_m + opening.height_m, house.wall_height_m)
        at = right
    add_part(at, length + 0.5 * house.wall_thickness_m, 0.0, house.wall_height_m)
    return [part.placed(x0, y0, 0.0, yaw) for part in parts]


def _object_parts(object_id: int, item: HouseObject) -> tuple[WorldObject, list[Primitive]]:
    """Return the object of the world that a file's entry describes, with its primitives."""
    category = assemblies.CATEGORIES[item.category]
    size = item.size or category.size_m
    yaw = math.radians(item.yaw_deg)
    parts = assemblies.build(item.category, size, item.color or category.colors[0])
    world_object = WorldObject(
        id=object_id,
        name=f"{item.category}-{object_id}",
        label=names.canonical(item.category),
        category=item.category,
        center_m=(*item.at, item.z_m + 0.5 * size[2]),
        size_m=size,
        yaw_rad=yaw,
    )
    return world_object, [part.placed(*item.at, item.z_m, yaw) for part in parts]
