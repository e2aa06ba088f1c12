"""`edge worlds import`: a Gazebo world becomes a textured mesh, a list of objects and a config."""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from edge import names
from edge.host.files import save
from edge.host.progress import with_progress
from edge.lab.sim.base import WorldError
from edge.lab.sim.gazebo.folders import ModelFolders
from edge.lab.sim.gazebo.naming import STRUCTURE, object_name, read_names, save_names
from edge.lab.sim.gazebo.sdf import ModelVisual, SdfReader
from edge.lab.sim.gazebo.shapes import ShapeLoader, VisualShape
from edge.text import format_table

PATH_VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH")
_BUILDING_SHARE, _BUILDING_M = 0.6, 4.0
"""A model that spans this share of the world, and so much, along both x and y is the building."""
_MAX_SHOWN = 10  # problems that are printed
_FLOOR_M = 0.1  # a floor is at most so far from z = 0

PlacedShape = tuple[ModelVisual, VisualShape, np.ndarray]
"""A shape, the visual that it belongs to, and its (4, 4) transform to the world."""


def run(args: argparse.Namespace) -> int:
    """Handle `edge worlds import`."""
    named = args.models or [
        Path(path)
        for name in PATH_VARIABLES
        for path in os.environ.get(name, "").split(":")
        if path
    ]
    world: Path = args.world
    folders = ModelFolders([world.parent, *named])
    reader = SdfReader(folders)
    visuals = reader.read(world)
    placed = place_shapes(visuals, ShapeLoader(folders, reader.problems), reader.problems)
    if not placed:
        raise WorldError(
            f"{world}: nothing to import: no visual could be read"
            + "".join(f"; first: {problem}" for problem in list(reader.problems)[:1])
        )
    for _, _, T in placed:
        T[2, 3] -= args.floor
    out = args.out / world.stem
    table = out.with_suffix(".names.yaml")
    boxes = _boxes(placed)
    chosen = read_names(table)
    names_by_model = _suggested(placed, boxes) | chosen
    scene, node_names = _scene(placed)
    items = _items(placed, boxes, names_by_model, node_names)
    save(out.with_suffix(".glb"), scene.export(file_type="glb"))
    save(out.with_suffix(".objects.json"), json.dumps(items, indent=1).encode())
    save_names(table, names_by_model.items())
    if not out.with_suffix(".yaml").exists():
        save(out.with_suffix(".yaml"), _config(out, items).encode())
    if reader.problems:
        lines = [f"{n} x {problem}\n" for problem, n in reader.problems.most_common()]
        save(out.with_suffix(".problems.txt"), "".join(lines).encode())
    print(_summary(out, items, placed, len(visuals), reader.problems))
    return 0


def place_shapes(
    visuals: list[ModelVisual], loader: ShapeLoader, problems: Counter[str]
) -> list[PlacedShape]:
    """Return the shapes of all visuals in the world; planes are cut to the size of the rest."""
    placed: list[PlacedShape] = []
    # Planes come last: they may be far larger than the building.
    ordered = sorted(visuals, key=lambda visual: visual.geometry.tag == "plane")
    for visual in with_progress("visuals", ordered):
        try:
            shapes = loader.shapes(visual)
        except WorldError as error:
            problems[str(error)] += 1
            continue
        for shape in shapes:
            if visual.geometry.tag == "plane" and placed:
                shape = shape._replace(geometry=_cut(shape.geometry, visual, placed))
            placed.append((visual, shape, visual.T_world_visual @ shape.T_visual_shape))
    return placed


def _corners(placed: PlacedShape) -> np.ndarray:
    """Return (n, 3) corners of a shape in the world."""
    _, shape, T = placed
    return shape.geometry.vertices @ T[:3, :3].T + T[:3, 3]


def _cut(plane: Any, visual: ModelVisual, placed: list[PlacedShape]) -> Any:
    """Return a plane that reaches no farther than the shapes that are placed already."""
    bounds = np.array([f(_corners(each), axis=0) for each in placed for f in (np.min, np.max)])
    low, high = bounds.min(axis=0), bounds.max(axis=0)
    box = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1)  # 8 corners
    T = np.linalg.inv(visual.T_world_visual)
    local = T[:3, :3] @ box + T[:3, 3:]
    cut = plane.copy()
    xy = cut.vertices[:, :2].clip(local[:2].min(axis=1), local[:2].max(axis=1))
    cut.vertices = np.column_stack([xy, cut.vertices[:, 2]])
    return cut


def _boxes(placed: list[PlacedShape]) -> dict[str, np.ndarray]:
    """Return the lowest and the highest corner of each instance, (2, 3)."""
    boxes: dict[str, np.ndarray] = {}
    for each in placed:
        corners = _corners(each)
        box = boxes.setdefault(each[0].instance, np.array([[np.inf] * 3, [-np.inf] * 3]))
        np.minimum(box[0], corners.min(axis=0), out=box[0])
        np.maximum(box[1], corners.max(axis=0), out=box[1])
    return boxes


def _suggested(placed: list[PlacedShape], boxes: dict[str, np.ndarray]) -> dict[str, str]:
    """Return a name for each model, from its own name and its size."""
    all_boxes = np.array(list(boxes.values()))
    span = all_boxes[:, 1, :2].max(axis=0) - all_boxes[:, 0, :2].min(axis=0)
    suggested: dict[str, str] = {}
    for visual, *_ in placed:
        low, high = boxes[visual.instance]
        if ((high - low)[:2] > np.maximum(_BUILDING_SHARE * span, _BUILDING_M)).all():
            suggested[visual.model] = STRUCTURE
        suggested.setdefault(visual.model, object_name(visual.model))
    return suggested


def _scene(placed: list[PlacedShape]) -> tuple[Any, dict[str, str]]:
    """Return a trimesh scene, and the name of each instance's nodes (up to a dot)."""
    import trimesh

    scene = trimesh.Scene()
    geometry_names: dict[int, str] = {}
    node_names: dict[str, str] = {}
    for number, (visual, shape, T) in enumerate(placed):
        node = node_names.setdefault(visual.instance, visual.instance.replace(".", "_"))
        key = id(shape.geometry)  # copies of a model share it
        if key not in geometry_names:
            geometry_names[key] = f"shape{len(geometry_names)}"
            scene.geometry[geometry_names[key]] = shape.geometry
        # A node's name is the object's up to the first dot (`edge.lab.sim.mesh`).
        scene.graph.update(frame_to=f"{node}.{number}", matrix=T, geometry=geometry_names[key])
    return scene, node_names


def _items(
    placed: list[PlacedShape],
    boxes: dict[str, np.ndarray],
    names_by_model: dict[str, str],
    node_names: dict[str, str],
) -> list[dict[str, Any]]:
    """Return the objects in the form of `edge.lab.sim.mesh.read_objects`."""
    items: dict[str, dict[str, Any]] = {}
    for visual, *_ in placed:
        name, T = names_by_model[visual.model], visual.T_world_visual
        if name == STRUCTURE or visual.instance in items:
            continue
        low, high = boxes[visual.instance].round(4).tolist()
        items[visual.instance] = {
            "name": node_names[visual.instance], "model": visual.model, "category": name,
            "yaw": round(float(np.arctan2(T[1, 0], T[0, 0])), 4), "aabb_min": low, "aabb_max": high,
        }  # fmt: skip
    return list(items.values())


def _config(out: Path, items: list[dict[str, Any]]) -> str:
    """Return a configuration with the world, and the simulated detector."""
    sizes = Counter({item["category"]: np.subtract(item["aabb_max"], item["aabb_min"]).prod()
                     for item in items if names.is_known(item["category"])})  # fmt: skip
    target = next((name for name, _ in sizes.most_common(1)), "chair")
    mesh, objects = (json.dumps(str(out.with_suffix(end).resolve())) for end in
                     (".glb", ".objects.json"))  # fmt: skip
    return (
        "# Made by `edge worlds import`. It uses the simulated detector, which knows all objects;\n"
        "# config/aws-house.yaml shows the sections for a real one.\n"
        f"mission: {{target: {json.dumps(target)}}}\n"
        "policy: {kind: search}\n"
        "perception: {detector: {kind: sim}}\n"
        f"sim:\n  world:\n    kind: mesh\n    mesh: {mesh}\n    objects: {objects}\n"
    )


def _summary(
    out: Path,
    items: list[dict[str, Any]],
    placed: list[PlacedShape],
    visuals: int,
    problems: Counter[str],
) -> str:
    """Return what was imported, what was left out, and what to do next."""
    counts = Counter(item["category"] for item in items)
    shown = len({id(visual) for visual, *_ in placed})
    lines = [
        f"{out.with_suffix('.glb')}: {shown} of {visuals} visuals, {len(items)} objects of "
        f"{len(counts)} names",
        format_table(
            [("name", "objects"), *((n, str(c)) for n, c in counts.most_common())], left=1
        ),
    ]
    if problems:
        lines.append(f"left out or changed: {problems.total()}")
        lines += [f"  {n} x {problem}" for problem, n in problems.most_common(_MAX_SHOWN)]
        if len(problems) > _MAX_SHOWN:
            more = len(problems) - _MAX_SHOWN
            lines.append(f"  and {more} more: {out.with_suffix('.problems.txt')}")
    floor = np.concatenate([_corners(each)[:, 2] for each in placed])
    if not (np.abs(floor) < _FLOOR_M).any():
        lines.append(f"no floor at z = 0: the lowest point is at {floor.min():.2f} m; import again "
                     "with --floor Z")  # fmt: skip
    lines.append(f"names to edit: {out.with_suffix('.names.yaml')} (then import again)")
    lines.append(f"try: edge demo {out.with_suffix('.yaml')}")
    return "\n".join(lines)
