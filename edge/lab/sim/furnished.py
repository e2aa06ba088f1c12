"""Houses with textured furniture from a catalogue, in place of boxes (extra `worlds`).

The walls and the places of the furniture are those of a generated or ProcTHOR house. Each object is
replaced by a model of the same name, or by another model of about its size. So the houses have
objects that look alike, and objects whose names are in none of our tables. Small objects are put on
tables and cabinets.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from edge import names
from edge.config import Config, WorldFurnished
from edge.host import resources
from edge.lab.sim import shading
from edge.lab.sim.base import WorldObject
from edge.lab.sim.boxworld import BoxWorld
from edge.lab.sim.catalogue import CatalogueModel, load_model, read_catalogue
from edge.lab.sim.generator.contents import SUPPORTS
from edge.lab.sim.generator.house import load_generated
from edge.lab.sim.generator.rng import PortableRng
from edge.lab.sim.mesh import MeshWorld, objects_of, require_packages
from edge.lab.sim.mesh_faces import Atlas, Faces, face_arrays
from edge.lab.sim.procthor import load_procthor

_RNG_KEY = 33
_OTHER_P = 0.35
"""Probability that an object is replaced by a model of another name."""
_SCALES = (0.7, 1.15)
"""Smallest and largest factor on the size of a model, so that it fits its place."""
_LEAST_FILL = 0.4
"""A model of another name covers at least this share of the object's floor (or wall, if hung)."""
_HEIGHTS = (0.45, 1.6)
"""Smallest and largest height of a model of another name, as a factor on the object's height."""
_LOW_M = 0.05  # lower objects are flat: carpets and mats
_ON_TOP_M = 0.15  # largest vertical gap between an object and the furniture below it
_MAX_SMALL = 3  # most small objects that are put on a piece of furniture
_SMALL_M = 0.45  # largest extent of such an object
_EDGE_M = 0.03  # gap between such objects, and to the edge of the furniture
_SECTIONS = ("Living room", "Kitchen", "Bedroom", "Bathroom", "Office", "Miscellaneous", "Lights")
"""Sections of the catalogue whose models stand in houses."""
_NOT_IN_HOUSES = frozenset({"ceiling fan", "deer", "fence", "street light", "tatami"})
_SUPPORTS = frozenset(map(names.canonical, (*SUPPORTS, "table", "bookcase", "countertop")))
"""Names of the furniture that small objects are put on."""
_TEXTURE_PX = 256  # side of the square texture of a floor or wall
_TEXEL_M = 0.01  # side of one pixel of this texture on the floor or wall
_UNIT = 200.0
"""Value of a texture's pixel for the factor 1. It is below 255, so that brighter factors fit in."""
_LIGHT = (0.85, 1.2)
"""Smallest and largest factor on all colours of a house."""
_WARMTH = 0.08
"""Largest share by which red and blue of the light differ from green."""


@dataclass(frozen=True, slots=True)
class PlacedModel:
    """A model at its place.

    Attributes:
        x_m: x of its middle in `map`.
        y_m: y of its middle in `map`.
        z_m: height of its lower side above the floor.
        yaw_rad: direction of its front.
        scale: factor on the size that the catalogue gives.
    """

    model: CatalogueModel
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    scale: float

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Depth, width and height."""
        depth, width, height = self.model.size_m
        return depth * self.scale, width * self.scale, height * self.scale

    @property
    def top_m(self) -> float:
        """Height above the floor on which other objects stand."""
        top = self.model.top_m
        return self.z_m + self.scale * (self.model.size_m[2] if top is None else top)

    @property
    def T_map_model(self) -> np.ndarray:
        """(4, 4) transform to `map`, with the scale, from the frame that `load_model` gives."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        T = np.eye(4)
        T[:3, :3] = self.scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        T[:3, 3] = self.x_m, self.y_m, self.z_m
        return T

    def holds(self, x_m: float, y_m: float) -> bool:
        """Return True if a point of `map` is within its footprint."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        ahead_m, left_m = c * dx + s * dy, c * dy - s * dx
        return abs(ahead_m) <= 0.5 * self.size_m[0] and abs(left_m) <= 0.5 * self.size_m[1]

    def to_map(self, ahead_m: float, left_m: float) -> tuple[float, float]:
        """Return x and y in `map` of a point ahead of the model's middle and to its left."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + c * ahead_m - s * left_m, self.y_m + s * ahead_m + c * left_m


def load_furnished(section: WorldFurnished, config: Config) -> MeshWorld:
    """Load a house, furnished with the models of a catalogue; a seed gives the same everywhere."""
    require_packages(config)
    plan = section.house
    house = (  # its furniture is made of boxes
        load_generated(plan, config) if plan.kind == "generated" else load_procthor(plan, config)
    )
    models = read_catalogue(resources.expand(section.catalogue))
    rng = PortableRng(_RNG_KEY, section.seed, zlib.crc32(house.name.encode()))
    placed = Furnisher(models, rng).furnish(house, fronts_known=plan.kind == "generated")
    name = f"furnished-{section.seed}-{house.name}"
    faces, items = _build(house, placed, _draw_light(rng))
    objects, owner = objects_of(faces, items, config.robot.height_m)
    world = MeshWorld(name, faces, objects, owner, config, house.rooms, house.room_kinds)
    if world.plan.clearance_at(house.start.x_m, house.start.y_m) > config.robot.radius_m:
        world.start = house.start
    return world


class Furnisher:
    """Chooses and places the models of a house; `rng` draws all choices."""

    def __init__(self, models: tuple[CatalogueModel, ...], rng: PortableRng) -> None:
        self._rng = rng
        self._models = [
            m for m in models if m.section in _SECTIONS and m.label not in _NOT_IN_HOUSES
        ]
        self._by_name: dict[str, list[CatalogueModel]] = {}  # see `_models_named`
        self._small = [  # models that are put on furniture
            m for m in self._models if m.bottom_m == 0.0 and _LOW_M < max(m.size_m) <= _SMALL_M
        ]

    def furnish(self, boxes: BoxWorld, fronts_known: bool) -> list[PlacedModel]:
        """Return the models in place of the objects of a house, and small objects on them.

        If `fronts_known`, its objects face along their own x axis. If not (the file does not give
        their fronts), they are turned to the middle of the room.
        """
        standing: list[PlacedModel] = []  # on the floor
        raised: list[PlacedModel] = []  # on a wall, or on other furniture
        for item in sorted(boxes.objects, key=_bottom_m):
            below, bottom_m = _support(boxes.objects, item), _bottom_m(item)
            hung = bottom_m > _LOW_M and below is None
            turns = [item] if fronts_known else _facing(item, boxes)
            placed = self._replace(turns, hung)
            if placed is None:
                continue
            if below is None:
                (raised if hung else standing).append(placed)
                continue
            # The object below may have been replaced by a smaller model, or by none.
            holder = next((p for p in standing if p.holds(placed.x_m, placed.y_m)), None)
            if holder is not None and _fits_on(placed, holder):
                raised.append(replace(placed, z_m=holder.top_m))
        for holder in standing:
            if holder.model.label in _SUPPORTS:
                raised += self._put_on(holder, [p for p in raised if holder.holds(p.x_m, p.y_m)])
        return [*standing, *raised]

    def _replace(self, turns: list[WorldObject], hung: bool) -> PlacedModel | None:
        """Return a model in place of an object, on a wall if `hung`; None if no model fits.

        `turns` is the object in each direction that it may face (a box turned by a quarter has
        depth and width exchanged), the best direction first.
        """
        rng, item = self._rng, turns[0]
        same = self._models_named(item.label)
        sections = {m.section for m in same} or {"Living room", "Miscellaneous"}
        other = [
            m for m in self._models
            if m.section in sections and m not in same and (m.bottom_m > 0.0) == hung
        ]  # fmt: skip
        fitting_same = [m for m in same if any(_scale(m, turn, hung) for turn in turns)]
        fitting_other = [m for m in other if any(_looks_like(m, turn, hung) for turn in turns)]
        # Models of the same name come first, or by chance those of another name.
        if rng.chance(_OTHER_P):
            choices = fitting_other or fitting_same
        else:
            choices = fitting_same or fitting_other
        if not choices:
            return None
        model = rng.pick(choices)
        # The best direction in which the model fits.
        turn = next(turn for turn in turns if _scale(model, turn, hung))
        scale = _scale(model, turn, hung)
        # The back stays where the object's back was: at the wall.
        behind_m = 0.5 * (turn.size_m[0] - scale * model.size_m[0])
        x_m = turn.center_m[0] - behind_m * math.cos(turn.yaw_rad)
        y_m = turn.center_m[1] - behind_m * math.sin(turn.yaw_rad)
        return PlacedModel(model, x_m, y_m, max(_bottom_m(turn), 0.0), turn.yaw_rad, scale)

    def _models_named(self, label: str) -> list[CatalogueModel]:
        """Return the models of a name or of a wider name: for a dining table also tables."""
        if label not in self._by_name:
            self._by_name[label] = [
                m for m in self._models if m.label == label or names.is_kind_of(label, m.label)
            ]
        return self._by_name[label]

    def _put_on(self, holder: PlacedModel, taken: list[PlacedModel]) -> list[PlacedModel]:
        """Return small objects at free places on top of a piece of furniture."""
        rng, on_top = self._rng, list(taken)
        for _ in range(rng.count(0, _MAX_SMALL)):
            model = rng.pick(self._small)
            reach_m = 0.5 * math.hypot(*model.size_m[:2]) + _EDGE_M
            # Largest distance of the small object's middle from the holder's, along both sides.
            free_x, free_y = (0.5 * side - reach_m for side in holder.size_m[:2])
            at = rng.between(-free_x, free_x), rng.between(-free_y, free_y)
            yaw_rad = rng.between(-math.pi, math.pi)
            if min(free_x, free_y) < 0.0:
                continue  # it is larger than the holder
            x_m, y_m = holder.to_map(*at)
            if all(
                math.hypot(p.x_m - x_m, p.y_m - y_m) > reach_m + 0.5 * math.hypot(*p.size_m[:2])
                for p in on_top
            ):
                on_top.append(PlacedModel(model, x_m, y_m, holder.top_m, yaw_rad, 1.0))
        return on_top[len(taken) :]


def _bottom_m(item: WorldObject) -> float:
    return item.center_m[2] - 0.5 * item.size_m[2]


def _scale(model: CatalogueModel, item: WorldObject, hung: bool) -> float:
    """Return the factor with which a model fits into an object's place; 0 if it does not fit."""
    # Only a flat model replaces a flat object.
    if not hung and (item.size_m[2] < _LOW_M) != (model.size_m[2] < _LOW_M):
        return 0.0
    # Indices of the sizes that must fit: on a wall width and height, on the floor depth and width.
    sides = (1, 2) if hung else (0, 1)
    scale = min(_SCALES[1], *(item.size_m[k] / max(model.size_m[k], 1e-3) for k in sides))
    return scale if scale >= _SCALES[0] else 0.0


def _looks_like(model: CatalogueModel, item: WorldObject, hung: bool) -> bool:
    """Return True if a model of another name fits and fills enough of an object's place."""
    scale = _scale(model, item, hung)
    # Sizes of the model as shares of the object's sizes.
    depth, width, height = (scale * a / b for a, b in zip(model.size_m, item.size_m, strict=True))
    if hung:
        return width * height >= _LEAST_FILL
    return depth * width >= _LEAST_FILL and _HEIGHTS[0] <= height <= _HEIGHTS[1]


def _facing(item: WorldObject, boxes: BoxWorld) -> list[WorldObject]:
    """Return an object in four directions, a quarter turn apart.

    The direction that points best to the middle of the object's room comes first.
    """
    middles = [  # of the rectangles of rooms that the object is in
        (0.5 * (x0 + x1), 0.5 * (y0 + y1))
        for room in boxes.rooms
        for x0, y0, x1, y1 in room
        if x0 <= item.center_m[0] <= x1 and y0 <= item.center_m[1] <= y1
    ]
    x_m, y_m = middles[0] if middles else item.center_m[:2]
    dx, dy = x_m - item.center_m[0], y_m - item.center_m[1]
    turns = []
    for quarter in range(4):
        yaw_rad = item.yaw_rad + 0.5 * math.pi * quarter
        depth, width, height = item.size_m
        size_m = (width, depth, height) if quarter % 2 else item.size_m
        towards = math.cos(yaw_rad) * dx + math.sin(yaw_rad) * dy
        turns.append((-towards, quarter, replace(item, yaw_rad=yaw_rad, size_m=size_m)))
    # Sort by the first two entries only: objects cannot be compared.
    return [turn for *_, turn in sorted(turns, key=lambda each: each[:2])]


def _support(objects: list[WorldObject], item: WorldObject) -> WorldObject | None:
    """Return the object on the floor that an object stands on, or None."""
    bottom_m = _bottom_m(item)
    if bottom_m <= _LOW_M:
        return None
    for other in objects:
        gap_m = bottom_m - other.center_m[2] - 0.5 * other.size_m[2]  # negative: inside
        stands = other is not item and _bottom_m(other) <= _LOW_M and gap_m < _ON_TOP_M
        if stands and other.distance_m(*item.center_m[:2]) == 0.0:
            return other
    return None


def _fits_on(placed: PlacedModel, holder: PlacedModel) -> bool:
    """Return True if an object covers no more floor than the furniture below it."""
    return placed.size_m[0] * placed.size_m[1] <= holder.size_m[0] * holder.size_m[1]


def _draw_light(rng: PortableRng) -> np.ndarray:
    """Draw the colour of the light, as (3,) factors on red, green and blue."""
    warmth = rng.between(-_WARMTH, _WARMTH)
    return rng.between(*_LIGHT) * np.array([1.0 + warmth, 1.0, 1.0 - warmth], np.float32)


def _build(
    boxes: BoxWorld, placed: list[PlacedModel], light: np.ndarray
) -> tuple[Faces, list[dict[str, Any]]]:
    """Return all triangles of the house, and its objects as `mesh.read_objects` returns them.

    Of the boxes, only walls, floors and ceilings are used. `light` (3,) are factors on red, green
    and blue.
    """
    atlas = Atlas()
    node_names = ["structure"]
    parts = [face_arrays(part, np.eye(4), atlas, 0) for part in _structure(boxes)]
    items: list[dict[str, Any]] = []
    for number, each in enumerate(placed, start=1):
        T, node = each.T_map_model, len(node_names)
        own = [
            face_arrays(part, T @ T_part, atlas, node) for part, T_part in load_model(each.model)
        ]
        if not own:
            continue
        parts += own
        node_names.append(f"{each.model.label}-{number}")
        # `part[0]` has the triangles, see `face_arrays`.
        corners = np.concatenate([part[0].reshape(-1, 3) for part in own])
        items.append({
            "name": node_names[-1], "category": each.model.label, "yaw": each.yaw_rad,
            "aabb_min": corners.min(axis=0), "aabb_max": corners.max(axis=0),
        })  # fmt: skip
    faces = Faces.join(parts, node_names, atlas)
    np.multiply(faces.tint, light, out=faces.tint)
    return faces, items


def _structure(boxes: BoxWorld) -> list[Any]:
    """Return floors, walls and ceilings as trimesh boxes with the textures of `shading`.

    The texture's image and the box's colour are multiplied, which gives the colour of `BoxWorld`.
    """
    import trimesh
    from PIL import Image
    from trimesh.visual.material import PBRMaterial

    images: dict[int, Any] = {}  # by the texture's number in `shading`
    parts = []
    for k in np.flatnonzero(boxes.owner == 0):  # primitives that belong to no object
        kind = int(boxes.texture[k])
        if kind not in images:
            factors = np.empty((_TEXTURE_PX, _TEXTURE_PX, 3), np.float32)
            shading.bake(kind, _TEXEL_M, factors)
            images[kind] = Image.fromarray(np.clip(_UNIT * factors, 0, 255).astype(np.uint8))
        x, y, z, half_x, half_y, half_z, c, s = boxes.geometry[k]
        half = np.array([half_x, half_y, half_z])
        # Six faces with four corners each, and the texture's coordinates (uv) at the corners.
        corners, uv = [], []
        for axis in range(3):  # the axis that the face is perpendicular to
            across, along = np.delete(half, axis)  # half sizes of the face
            for side in (-1.0, 1.0):
                quad = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (across, along)
                corners.append(np.insert(quad, axis, side * half[axis], axis=1))
                uv.append(quad / (_TEXTURE_PX * _TEXEL_M))  # 1 is the length of the texture
        vertices = np.concatenate(corners)
        turned = vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + (x, y, z)
        quads = np.arange(24).reshape(6, 4)  # corners of each face; two triangles fill it
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        color = np.append(np.clip(boxes.color[k] * 255.0 / _UNIT, 0, 255), 255).astype(np.uint8)
        material = PBRMaterial(baseColorTexture=images[kind], baseColorFactor=color)
        visual = trimesh.visual.TextureVisuals(uv=np.concatenate(uv), material=material)
        parts.append(trimesh.Trimesh(turned, triangles, visual=visual, process=False))
    return parts
