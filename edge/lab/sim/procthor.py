"""Houses of the ProcTHOR data set (Apache-2.0) as worlds, each a line of a JSON lines file.

Objects are plain boxes: the file has only their categories, positions and sizes.
"""

from __future__ import annotations

import colorsys
import gzip
import json
import math
import zlib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from edge import names
from edge.config import Config, WorldProcthor
from edge.geometry import SE2
from edge.host import resources
from edge.host.files import open_regular
from edge.lab.sim import kernels, shading
from edge.lab.sim.base import WorldError, WorldObject
from edge.lab.sim.boxworld import BoxWorld, Primitive, room_slabs

_WALL_M = 0.1  # thickness of a wall
# Colour and texture of the floor by the kind of room; other rooms have wooden planks.
_FLOORS = {
    "bathroom": ((196.0, 200.0, 204.0), shading.TILES),
    "kitchen": ((206.0, 198.0, 184.0), shading.TILES),
    "bedroom": ((168.0, 150.0, 130.0), shading.FABRIC),
}
_WOOD = ((176.0, 132.0, 88.0), shading.PLANKS)  # colour and texture


def read_houses(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the houses of a `.jsonl` or `.jsonl.gz` file, one by one.

    Raises:
        WorldError: the file cannot be read, or a line is not JSON.
    """
    number = 0
    try:
        with open_regular(path) as content:
            for line in gzip.GzipFile(fileobj=content) if path.suffix == ".gz" else content:
                number += 1
                yield json.loads(line)
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, EOFError) as error:
        raise WorldError(
            f"{path}: line {number}: not JSON: {error}; fetch the file again"
        ) from None


def load_procthor(section: WorldProcthor, config: Config) -> BoxWorld:
    """Load one house of a file, by name.

    Raises:
        WorldError: no such file or house, or a house that lacks a field.
    """
    path, first_name, count = resources.expand(section.file), "", 0
    for house in read_houses(path):
        if house.get("name") == section.name:
            try:
                return build_procthor(house, config)
            except (KeyError, TypeError, ValueError) as error:
                raise WorldError(
                    f"{path}: house {section.name}: a field is missing or wrong: {error!r}"
                ) from None
        first_name, count = first_name or str(house.get("name")), count + 1
    raise WorldError(
        f"{path}: sim.world.name: none of the {count} houses is called {section.name!r}; the first "
        f"is {first_name}"
    )


def build_procthor(house: dict[str, Any], config: Config) -> BoxWorld:
    """Return the world of one parsed line.

    Raises:
        KeyError: a field is missing.
        TypeError: a field has the wrong type.
        ValueError: a field has the wrong length or content.
    """
    # The last number of a wall is the height of its upper edge; see `_wall`.
    ceiling_m = max((wall[-1] for wall in house["walls"]), default=2.6)
    structure = [part for room in house["rooms"] for part in _room_parts(room, ceiling_m)]
    structure += [_wall(wall) for wall in house["walls"]]
    furniture = [_object_parts(k + 1, item) for k, item in enumerate(house["objects"])]
    camera = config.sensors.camera
    depths = (camera.depth_min_m, camera.depth_max_m)
    start = SE2(*(float(v) for v in house["start"]))
    rooms = tuple(tuple(rectangles(room["polygon"])) for room in house["rooms"])
    robot_m = config.robot.height_m
    kinds = tuple(str(room["category"]) for room in house["rooms"])
    return BoxWorld(house["name"], structure, furniture, start, robot_m, depths, rooms, kinds)


def _room_parts(room: dict[str, Any], ceiling_m: float) -> list[Primitive]:
    """Return floor and ceiling of a room: one box each for every rectangle of its polygon."""
    look = _FLOORS.get(room["category"], _WOOD)
    return [
        part for rect in rectangles(room["polygon"]) for part in room_slabs(rect, *look, ceiling_m)
    ]


def rectangles(polygon: list[list[float]]) -> list[tuple[float, float, float, float]]:
    """Cut a polygon with axis-parallel sides into rectangles (x0, y0, x1, y1).

    There is a strip along x between each two neighbouring y of the corners.
    """
    ys = sorted({y for _, y in polygon})
    sides = list(zip(polygon, [*polygon[1:], polygon[0]], strict=True))
    out = []
    for low, high in pairwise(ys):
        middle = 0.5 * (low + high)
        # x of the sides along y that cross the strip. They are an even number: the strip is inside
        # the polygon between the first two, the next two, and so on.
        xs = sorted(a[0] for a, b in sides if min(a[1], b[1]) < middle < max(a[1], b[1]))
        out += [(x0, low, x1, high) for x0, x1 in zip(xs[::2], xs[1::2], strict=True)]
    return out


def _wall(wall: list[float]) -> Primitive:
    """Return a piece of wall, given by x0, y0, x1, y1 of its ends and its lower and upper z."""
    x0, y0, x1, y1, z0, z1 = wall
    # Walls on the floor extend by half a thickness at both ends, so that corners close.
    length = math.hypot(x1 - x0, y1 - y0) + _WALL_M * (z0 == 0.0)
    center = (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1))
    yaw = math.atan2(y1 - y0, x1 - x0)
    color = (224.0, 220.0, 210.0)
    return Primitive(kernels.BOX, center, (length, _WALL_M, z1 - z0), color, shading.PAINT, yaw)


def _object_parts(object_id: int, item: dict[str, Any]) -> tuple[WorldObject, list[Primitive]]:
    """Return the object of the world that a file's entry describes, with its only primitive."""
    category, yaw = item["category"], float(item["yaw"])
    center, size = tuple(map(float, item["center"])), tuple(map(float, item["size"]))
    # One colour for each category, on every computer.
    hue = zlib.crc32(category.encode()) / 2**32
    color = tuple(255.0 * v for v in colorsys.hsv_to_rgb(hue, 0.45, 0.75))
    world_object = WorldObject(
        object_id, str(item["id"]), names.canonical(category), category, center, size, yaw
    )
    return world_object, [Primitive(kernels.BOX, center, size, color, shading.FABRIC, yaw)]
