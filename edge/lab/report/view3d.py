"""Interactive 3-D view of a scene and its trajectories: one page, which fetches nothing.

The page has its own small viewer: with 60,000 points it has 0.2 MB. Plotly's page has 5.4 MB, of
which 4.8 MB are the library; pyvista's has 1.6 MB, of which 1.4 MB are the library.
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

import numpy as np

from edge.lab.report import palette
from edge.lab.report.document import document, pairs_section
from edge.tasks.refine import RefinedTrajectory
from edge.tasks.scene.scene import Scene, SceneObject

VOXEL_M = 0.1  # one point is sent for each cube of this size
FARTHEST_M = 300.0  # farther points are left out: points are sent as centimetres in int16
UNKNOWN, OCCUPIED = 254, 255  # contents of a cell of the ground; the regions' ids are smaller
# Colours of the ground, by the region's label; "" for no region.
_GROUND_RGB = {
    "": (150, 166, 138), "road": (98, 102, 110), "sidewalk": (186, 184, 178),
    "parking": (126, 130, 142), "floor": (198, 190, 176), "terrain": (140, 160, 122),
}  # fmt: skip
_OTHERS_RGB = ((172, 158, 140), (140, 150, 172), (166, 146, 166))  # regions with other labels
UNKNOWN_RGB, _OCCUPIED_RGB = (202, 208, 216), (58, 66, 78)
_POINT_RGB = (112, 122, 136)  # points that belong to no object
# Colours of the kinds of objects (one label, one kind), for a dark and for a light background.
_BRIGHT = (
    "#ff8787", "#74c0fc", "#ffd43b", "#8ce99a", "#e599f7", "#ffa94d", "#66d9e8", "#d0bfff",
)  # fmt: skip
_DARK = (
    "#c92a2a", "#1864ab", "#e67700", "#2b8a3e", "#862e9c", "#d9480f", "#0b7285", "#5f3dc4",
)  # fmt: skip

STYLE = """
#view { display: block; width: 100%; height: min(66vh, 640px); border-radius: 8px;
  touch-action: none; cursor: grab; }
#view:active { cursor: grabbing; }
.bar { display: flex; flex-wrap: wrap; align-items: center; gap: 6px 16px; margin-top: 10px; }
.bar label { display: inline-flex; align-items: center; gap: 6px; }
.bar button { font: inherit; color: inherit; background: var(--track); cursor: pointer;
  border: 1px solid var(--line); border-radius: 8px; padding: 3px 12px; }
.swatch { display: inline-block; width: 18px; height: 4px; border-radius: 2px; }
#along { flex: 1; min-width: 160px; }
#when { min-width: 9.5em; font-variant-numeric: tabular-nums; }
td, th { text-align: left; }
"""


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A trajectory to draw.

    Attributes:
        name: text of its check box.
        points_m: (n, 2 or 3) float64 in `map`; without heights it is on the ground.
    """

    name: str
    points_m: np.ndarray
    colour: str
    breadth_px: float = 3.0


def coarse_and_refined(coarse_m: np.ndarray, refined: RefinedTrajectory) -> tuple[Line, Line]:
    """Return the two lines that every task has."""
    return (
        Line("coarse", coarse_m, "#f08c00", 2.0),
        Line("refined", refined.poses[:, :3], palette.TARGET, 4.0),
    )


def scene_page(
    title: str,
    scene: Scene,
    lines: Sequence[Line],
    machine: str,
    *,
    refined: RefinedTrajectory | None = None,
    cloud_m: np.ndarray | None = None,
    facts: Sequence[tuple[str, str]] = (),
    ground_m: float = 0.0,
) -> str:
    """Return the page as HTML. All text arguments are plain text.

    The slider follows the refined trajectory. `cloud_m` has all points, (n, 3) float32 in `map`;
    the objects' own points are always drawn. The facts, pairs of name and value, are under the
    picture. `ground_m` is the height of the ground in `map`.
    """
    labels = list(dict.fromkeys(item.label for item in scene.objects.values()))
    poses, pose_texts = _poses_with_text(refined)
    data = {
        "start": [scene.pose.x_m, scene.pose.y_m, scene.pose.yaw_rad],
        "ground": _ground(scene, ground_m),
        "cloud": _cloud(scene, labels, cloud_m),
        "boxes": [_box(item, labels) for item in scene.objects.values()],
        "lines": [_line(line, ground_m) for line in lines],
        "poses": poses,
        "when": pose_texts,
    }
    viewer = files(__package__).joinpath("view3d.js").read_text(encoding="utf-8")
    # A "</script>" or "<!--" in a name would end the script.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    body = (
        f"<header><h1>{escape(title)}</h1></header>"
        '<section><canvas id="view" tabindex="0" role="img" '
        f'aria-label="{escape(title)}: a view in three dimensions"></canvas>'
        f"{_controls(lines, pose_texts)}</section>"
        f"{pairs_section('Trajectory', facts) if facts else ''}{_objects(scene)}"
    )
    return document(title, body, machine, STYLE, f"const DATA = {text};\n{viewer}")


def ground_colours(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the content of each cell, and the colours of the contents.

    Returns:
        (h, w) uint8: a region's id, 0 for none, `UNKNOWN` or `OCCUPIED`; and (256, 3) uint8
            colours.
    """
    occupancy = scene.occupancy.cells
    cells = np.where(occupancy < 0, np.uint8(UNKNOWN), scene.regions_grid.cells)
    cells = np.where(occupancy >= 50, np.uint8(OCCUPIED), cells).astype(np.uint8)
    colours = np.full((256, 3), _GROUND_RGB[""], np.uint8)
    for k, region in enumerate(scene.regions.values()):
        colours[region.id] = _GROUND_RGB.get(region.label, _OTHERS_RGB[k % len(_OTHERS_RGB)])
    colours[UNKNOWN], colours[OCCUPIED] = UNKNOWN_RGB, _OCCUPIED_RGB
    return cells, colours


def _ground(scene: Scene, ground_m: float) -> dict[str, object]:
    """Return the grid of the ground for the viewer."""
    cells, colours = ground_colours(scene)
    rows, columns = cells.shape
    return {
        "rows": rows,
        "columns": columns,
        "cell": scene.occupancy.resolution_m,
        "origin": list(scene.occupancy.origin_xy_m),
        "level": ground_m,
        "cells": _packed(cells),
        "colours": colours.tolist(),
    }


def _cloud(scene: Scene, labels: Sequence[str], cloud_m: np.ndarray | None) -> dict[str, object]:
    """Return one point per voxel, with its kind and the colours of the kinds.

    Points of objects have kinds from 1 on, by label; after eight, labels share kinds. Other points,
    `cloud_m` (n, 3), have kind 0. `labels` are those of all objects, each once.
    """
    points, kind = [np.empty((0, 3), np.float32)], [np.empty(0, np.uint8)]
    for item in scene.objects.values():
        points.append(item.points_m)
        k = 1 + labels.index(item.label) % len(_DARK)
        kind.append(np.full(len(item.points_m), k, np.uint8))
    if cloud_m is not None:
        points.append(cloud_m)
        kind.append(np.zeros(len(cloud_m), np.uint8))
    xyz, all_kinds = np.concatenate(points), np.concatenate(kind)
    near = (np.abs(xyz) < FARTHEST_M).all(axis=1)  # False for NaN
    xyz, all_kinds = xyz[near], all_kinds[near]
    # Objects come first, and the first point of each voxel is kept.
    _, first = np.unique(np.floor(xyz / VOXEL_M).astype(np.int32), axis=0, return_index=True)
    return {
        "xyz_cm": _packed(np.rint(100.0 * xyz[first]).astype("<i2")),
        "kind": _packed(all_kinds[first]),
        "colours": [_POINT_RGB, *(_rgb(colour) for colour in _DARK)],
    }


def _box(item: SceneObject, labels: Sequence[str]) -> dict[str, object]:
    """Return an object's box and name for the viewer; `labels` as for `_cloud`."""
    k = labels.index(item.label) % len(_DARK)
    return {
        "id": item.id,
        "label": item.label,
        "at": _rounded(item.position_m),
        "size": _rounded(item.size_m),
        "heading": round(item.heading_rad, 4),
        "colour": _DARK[k],
        "bright": _BRIGHT[k],
    }


def _line(line: Line, ground_m: float) -> dict[str, object]:
    """Return a trajectory for the viewer, with heights."""
    points = np.asarray(line.points_m, np.float64)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.full(len(points), ground_m)])
    points = points + np.array([0.0, 0.0, 0.05])  # just above the ground
    return {"points": _rounded(points), "colour": line.colour, "breadth": line.breadth_px}


def _poses_with_text(refined: RefinedTrajectory | None) -> tuple[list[list[float]], list[str]]:
    """Return the poses that the slider selects, and time and speed at each as text."""
    if refined is None:
        return [], []
    texts = [
        f"{t_s:.1f} s, {v_mps:.2f} m/s"
        for t_s, v_mps in zip(refined.times_s, refined.speeds_mps, strict=True)
    ]
    return [_rounded(pose) for pose in refined.poses], texts


def _controls(lines: Sequence[Line], pose_texts: Sequence[str]) -> str:
    """Return buttons for views, check boxes, and the slider if there are poses."""
    views = "".join(
        f'<button type="button" data-view="{view}">{words}</button>'
        for view, words in (("behind", "Behind"), ("above", "Above"), ("robot", "As the robot"))
    )
    keys = "".join(
        f'<label><input type="checkbox" data-line="{k}" checked>'
        f'<span class="swatch" style="background:{escape(line.colour)}"></span>'
        f"{escape(line.name)}</label>"
        for k, line in enumerate(lines)
    )
    slider = ""
    if pose_texts:
        slider = (
            '<div class="bar"><label for="along">Position</label><input type="range" id="along" '
            f'min="0" max="{len(pose_texts) - 1}" value="0">'
            f'<output id="when">{escape(pose_texts[0])}</output></div>'
        )
    return (
        f'<div class="bar">{views}{keys}'
        '<label><input type="checkbox" data-show="boxes" checked>boxes</label>'
        '<label><input type="checkbox" data-show="words" checked>names</label></div>'
        f'{slider}<p class="note">Drag to turn, scroll to zoom, drag with Shift or the right '
        "button to move; arrow keys and + and − do too.</p>"
    )


def _objects(scene: Scene) -> str:
    """Return the objects as a table, for readers who cannot see the picture."""
    if not scene.objects:
        return '<section><p class="note">No objects were found.</p></section>'
    rows = "".join(
        f"<tr><td>{item.id}</td><td>{escape(item.label)}</td><td>{escape(item.caption)}</td>"
        f"<td>({item.position_m[0]:.1f}, {item.position_m[1]:.1f})</td>"
        f"<td>{math.dist(item.position_m[:2], (scene.pose.x_m, scene.pose.y_m)):.1f} m</td></tr>"
        for item in scene.objects.values()
    )
    head = "".join(f"<th>{word}</th>" for word in ("No.", "Object", "Caption", "At", "Distance"))
    return (
        f"<section><details><summary>{len(scene.objects)} objects</summary>"
        f'<div class="scroll"><table><tr>{head}</tr>{rows}</table></div></details></section>'
    )


def _packed(array: np.ndarray) -> str:
    """Return an array's bytes, compressed, as text."""
    return base64.b64encode(zlib.compress(array.tobytes(), 9)).decode("ascii")


def _rounded(values: np.ndarray) -> list[float]:
    return np.round(np.asarray(values, np.float64), 3).tolist()


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(colour[1:]))
