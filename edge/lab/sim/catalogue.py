"""Furniture catalogues of Sweet Home 3D (`.sh3f` files), as models for furnished houses.

A file is a zip archive: `PluginFurnitureCatalog.properties` lists the models, each an OBJ file with
its textures. Debian's package `sweethome3d-furniture` has five files with about 800 models. The
licences are in the archives and in the package's `copyright`.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections import defaultdict
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from edge import names
from edge.lab.sim.base import WorldError
from edge.text import one_line

_PROPERTIES = "PluginFurnitureCatalog.properties"
# Key, number of the model, and value: "name#3 = Brown sofa" gives "name", "3", "Brown sofa".
_ROW = re.compile(r"(\w+)#(\d+)\s*=\s*(.*)")
_MAX_OBJ_BYTES = 2_000_000
"""Larger models are left out: a tree with all its needles takes most of a house's loading time."""
_MAX_TEXTURE_PX = 256  # longest side of a texture; larger ones are reduced
_KEPT_MODELS = 256  # number of models kept in memory
# Leading words of a name that are dropped: materials, makers, sizes, shapes.
_ADJECTIVES = frozenset({
    "black", "burlap", "child", "children", "clear", "concrete", "corner", "decorative", "folding",
    "glass", "gaz", "iron", "large", "little", "lower", "modern", "oak", "old", "opened", "osaka",
    "oriental", "oval", "painted", "plastic", "rattan", "round", "ryokan", "small", "teck", "upper",
    "winchester", "wood", "wooden",
})  # fmt: skip
_LABELS = {
    "apple ibook": "laptop", "apple imac": "computer monitor", "clothes washing machine": "washing "
    "machine", "drawers cabinet": "chest of drawers", "dryer machine": "clothes dryer",
    "toilets unit": "toilet", "puff": "ottoman", "baby bed": "crib", "bath": "bathtub",
    "island bath": "bathtub", "class seat": "chair", "convertible sofa bz": "sofa",
    "sofa seats": "sofa", "park trashcan": "trash can", "residential trashcan": "trash can",
}  # fmt: skip
"""Name in a catalogue -> our name, where the two differ."""
# From the models' axes (x right, y up, z to the viewer) to ours (x to the viewer, y left, z up).
_AXES = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


@dataclass(frozen=True, slots=True)
class CatalogueModel:
    """One model of a catalogue.

    Attributes:
        archive: the catalogue's file.
        path: the OBJ file in the archive.
        label: canonical name of the object (`edge.names`).
        section: section of the catalogue, such as "Bedroom".
        size_m: depth, width and height, as seen from its front.
        bottom_m: height of its lower end above the floor; more than 0 for a model on a wall.
        top_m: height above its lower end at which other objects stand on it; None if unknown.
        rotation: 9 numbers, a 3 x 3 matrix row by row: it turns the model in the OBJ file's axes.
    """

    archive: Path
    path: str
    label: str
    section: str
    size_m: tuple[float, float, float]
    bottom_m: float
    top_m: float | None
    rotation: tuple[float, ...]


@lru_cache(maxsize=4)
def read_catalogue(folder: Path) -> tuple[CatalogueModel, ...]:
    """Return the models of all `.sh3f` files in a folder, always in the same order.

    Raises:
        WorldError: there is no such file, or one cannot be read.
    """
    files = sorted(folder.glob("*.sh3f"))
    if not files:
        raise WorldError(
            f"sim.world.catalogue: {folder}: no .sh3f file; install Debian's package "
            "sweethome3d-furniture, or name the folder that has its files"
        )
    return tuple(model for file in files for model in _models_of(file))


def _models_of(file: Path) -> list[CatalogueModel]:
    """Return the models of one catalogue file, without too large ones."""
    # Number of the model -> its keys and values, for example 3 -> {"name": "Brown sofa", …}.
    rows: defaultdict[int, dict[str, str]] = defaultdict(dict)
    try:
        with zipfile.ZipFile(file) as archive:
            for line in archive.read(_PROPERTIES).decode("latin-1").splitlines():
                if row := _ROW.match(line.strip()):
                    rows[int(row[2])][row[1]] = row[3].strip()
            sizes = {info.filename: info.file_size for info in archive.infolist()}
        models = [_model(file, row) for _, row in sorted(rows.items())]
    except (OSError, zipfile.BadZipFile, KeyError, ValueError) as error:
        raise WorldError(
            f"{file}: not a furniture catalogue ({one_line(error)}); install it again, or remove it"
        ) from None
    return [m for m in models if m is not None and sizes.get(m.path, 0) <= _MAX_OBJ_BYTES]


def _model(file: Path, row: dict[str, str]) -> CatalogueModel | None:
    """Return the model of one entry; None if its name is not the name of an object.

    The entry has lengths in cm.
    """
    try:
        label = object_label(row["name"])
    except names.NotANameError:
        return None
    depth_m, width_m, height_m = (0.01 * float(row[k]) for k in ("depth", "width", "height"))
    top = row.get("dropOnTopElevation")
    return CatalogueModel(
        archive=file,
        path=row["model"].lstrip("/"),
        label=label,
        section=row["category"],
        size_m=(depth_m, width_m, height_m),
        bottom_m=0.01 * float(row.get("elevation", 0)),
        top_m=None if top is None or float(top) < 0 else 0.01 * float(top),
        rotation=tuple(map(float, row.get("modelRotation", "1 0 0 0 1 0 0 0 1").split())),
    )


def object_label(name: str) -> str:
    """Return the canonical name of the object that an entry describes.

    Example:
        >>> object_label("Winchester sofa 2"), object_label("Chair with cushion 1")
        ('sofa', 'chair')

    Raises:
        NotANameError: the text is not the name of an object.
    """
    plain = name.lower().partition(" with ")[0].partition(",")[0]
    words = re.sub(r"[\d:'’]+", " ", plain).split()  # "sofa 2" -> "sofa"
    while len(words) > 1 and not names.is_known(" ".join(words)) and words[0] in _ADJECTIVES:
        del words[0]
    label = " ".join(words)
    return names.canonical(_LABELS.get(label, label))


@lru_cache(maxsize=_KEPT_MODELS)
def load_model(model: CatalogueModel) -> tuple[tuple[Any, np.ndarray], ...]:
    """Return the parts of a model, each a trimesh geometry with its transform.

    The transforms (4, 4) put the model on the floor at the origin: front at +x, in metres, in the
    catalogue's size. Textures are reduced to 256 pixels.

    Raises:
        WorldError: the OBJ file cannot be read.
    """
    import trimesh
    from trimesh.resolvers import ZipResolver

    folder = model.path.rpartition("/")[0]
    try:
        with zipfile.ZipFile(model.archive) as archive:
            inside = [n for n in archive.namelist() if n.startswith(f"{folder}/") and n[-1] != "/"]
            files = {name: io.BytesIO(archive.read(name)) for name in inside}
        resolver = ZipResolver(files, namespace=folder)
        scene = trimesh.load_scene(files[model.path], file_type="obj", resolver=resolver)
        bounds = scene.bounds  # (2, 3): lowest and highest corner, in the OBJ file's axes
        if bounds is None:
            raise ValueError("it has no triangles")
    except (OSError, KeyError, ValueError, IndexError, TypeError, zipfile.BadZipFile) as error:
        raise WorldError(
            f"{model.archive}: the furniture model {model.path} cannot be read "
            f"({one_line(error)}); install the catalogue again"
        ) from None
    turn = _AXES @ np.array(model.rotation).reshape(3, 3)
    corners = np.array(np.meshgrid(*bounds.T)).reshape(3, -1)  # (3, 8), of the box
    low, high = (f(turn @ corners, axis=1) for f in (np.min, np.max))
    scale = np.array(model.size_m) / np.maximum(high - low, 1e-9)
    # The middle of the box's lower side comes to the origin.
    T = np.eye(4)
    T[:3, :3] = scale[:, None] * turn
    T[:3, 3] = -scale * np.array([*(0.5 * (low + high))[:2], low[2]])
    parts = []
    for node in scene.graph.nodes_geometry:
        T_node, name = scene.graph[node]
        part = scene.geometry[name]
        if hasattr(part, "faces") and len(part.faces):
            prepare_material(part)
            parts.append((part, T @ T_node))
    return tuple(parts)


def prepare_material(part: Any, max_px: int = _MAX_TEXTURE_PX) -> None:
    """Turn an OBJ material into the kind that glTF has, with a texture of at most `max_px`."""
    material = getattr(part.visual, "material", None)
    if hasattr(material, "to_pbr"):
        material = part.visual.material = material.to_pbr()
    image = getattr(material, "baseColorTexture", None)
    if image is not None and max(image.size) > max_px:
        image = image.convert("RGB")
        image.thumbnail((max_px, max_px))
        material.baseColorTexture = image
