"""Shapes and looks of visuals, as trimesh geometries with textures bound."""

from __future__ import annotations

import io
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from edge.host.files import read_regular
from edge.lab.sim.base import WorldError
from edge.lab.sim.catalogue import prepare_material
from edge.lab.sim.gazebo.folders import ModelFolders, parse_xml
from edge.lab.sim.gazebo.sdf import ModelVisual, numbers
from edge.text import one_line

MESH_FORMATS = ("dae", "obj", "stl", "glb", "gltf", "ply", "off")
_MAX_MESH_BYTES = 256 << 20
_MAX_TEXTURE_PX = 1024  # longest side of a texture in the result
_MAX_PIXELS = 64_000_000  # of a texture that is read
_GREY = (0.7, 0.7, 0.7)  # of a visual without any material
# Colours of Gazebo's own materials.
_GAZEBO = {
    "black": (0.1, 0.1, 0.1), "blue": (0.1, 0.1, 0.8), "bricks": (0.55, 0.35, 0.3),
    "ceilingtiled": (0.9, 0.9, 0.88), "darkgrey": (0.35, 0.35, 0.35), "grass": (0.3, 0.45, 0.2),
    "green": (0.1, 0.7, 0.1), "grey": _GREY, "orange": (1.0, 0.5, 0.05), "red": (0.8, 0.1, 0.1),
    "white": (0.95, 0.95, 0.95), "wood": (0.6, 0.45, 0.3), "woodfloor": (0.6, 0.45, 0.3),
    "yellow": (0.9, 0.9, 0.1),
}  # fmt: skip


class VisualShape(NamedTuple):
    """One part of a visual.

    Attributes:
        geometry: a trimesh geometry; several shapes may share it.
        T_visual_shape: (4, 4) transform, with the scale.
    """

    geometry: Any
    T_visual_shape: np.ndarray


class SurfaceLook(NamedTuple):
    """Colour and texture of a material.

    Attributes:
        color: red, green, blue, 0 to 1; None if the material has none.
        texture: file of the texture, or None.
    """

    color: tuple[float, ...] | None = None
    texture: Path | None = None


class ShapeLoader:
    """Loads meshes and materials, each file once. Each missing one adds a line to `problems`."""

    def __init__(self, folders: ModelFolders, problems: Counter[str]) -> None:
        self._folders, self._problems = folders, problems
        self._mesh = cache(self._read_mesh)
        self._image = cache(self._read_image)
        self._script = cache(self._read_script)

    def shapes(self, visual: ModelVisual) -> list[VisualShape]:
        """Return the parts of a visual."""
        kind = visual.geometry.tag
        if kind == "mesh":
            shapes = self._placed_mesh(visual.geometry, visual.file)
        else:
            shapes = [VisualShape(_primitive(visual.geometry), np.eye(4))]
        look = SurfaceLook() if visual.material is None else self._look(visual)
        if kind != "mesh" and look == SurfaceLook():
            look = SurfaceLook(_GREY)
        if look == SurfaceLook():
            return shapes
        return [shape._replace(geometry=self._painted(shape.geometry, look)) for shape in shapes]

    def _placed_mesh(self, element: Element, file: Path) -> list[VisualShape]:
        """Return the parts of a `<mesh>`, scaled."""
        uri = (element.findtext("uri") or "").strip()
        path = self._folders.find(uri, file.parent)
        if path is None or not path.is_file():
            raise WorldError(
                f"{file}: <mesh>: {one_line(uri)} is in no model folder; put the file there, or "
                "add its folder with --models"
            )
        T = np.diag([*numbers(element, "scale", 3, "1 1 1"), 1.0])
        wanted = element.findtext("submesh/name")
        shapes = []
        for name, geometry, T_mesh in self._mesh(path):
            if wanted is None or wanted.strip() in name:
                shapes.append(VisualShape(geometry, T @ T_mesh))
        if not shapes:
            raise WorldError(f"{path}: has no part {one_line(wanted or '')!r}; correct <submesh>")
        if (element.findtext("submesh/center") or "").strip() in ("true", "1"):
            corners = np.concatenate([_moved(shape) for shape in shapes])
            middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            T_centre = np.eye(4)
            T_centre[:3, 3] = -middle
            shapes = [shape._replace(T_visual_shape=T_centre @ shape[1]) for shape in shapes]
        return shapes

    def _read_mesh(self, path: Path) -> list[tuple[str, Any, np.ndarray]]:
        """Return name, geometry and (4, 4) transform of each part of a mesh file, in metres."""
        import trimesh

        suffix = path.suffix.lower().removeprefix(".")
        if suffix not in MESH_FORMATS:
            raise WorldError(
                f"{path}: {suffix or 'this format'} cannot be read; convert the mesh to one of "
                f"{', '.join(MESH_FORMATS)}"
            )
        try:
            content = read_regular(path, _MAX_MESH_BYTES)
            T = np.eye(4)
            if suffix == "dae":
                # Gazebo scales by the unit and ignores the axis that the file names as up.
                unit = parse_xml(path, content).find("asset/unit")
                T[:3, :3] *= 1.0 if unit is None else float(unit.get("meter", 1.0))
            resolver: Any = _Textures(self, path)
            scene = trimesh.load_scene(io.BytesIO(content), file_type=suffix, resolver=resolver)
            parts = []
            for node in scene.graph.nodes_geometry:
                T_node, name = scene.graph[node]
                part = scene.geometry[name]
                if len(getattr(part, "faces", ())):
                    _prepare(part)
                    parts.append((f"{node} {name}", part, T @ T_node))
        except WorldError:
            raise
        except Exception as error:  # parsers raise anything on a broken file
            raise WorldError(
                f"{path}: not a readable mesh ({one_line(error):.120}); export it again"
            ) from None
        if not parts:
            raise WorldError(f"{path}: has no triangles; export it again")
        return parts

    def texture_file(self, name: str, base: Path) -> Path | None:
        """Return a texture's file, see `ModelFolders.find_texture`; a missing one is noted."""
        path = self._folders.find_texture(name, base)
        if path is None:
            self._problems[
                f"{base}: {one_line(name)!r:.120} is in no model folder; its surfaces are plain"
            ] += 1
        return path

    def _read_image(self, path: Path) -> Any:
        """Return a texture (PIL); None if it cannot be read."""
        from PIL import Image

        try:
            return Image.open(io.BytesIO(read_regular(path)))
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            self._problems[f"{path}: not a readable picture ({one_line(error):.80})"] += 1
            return None

    def _look(self, visual: ModelVisual) -> SurfaceLook:
        """Return the look that a visual's `<material>` gives."""
        material, base = visual.material, visual.file.parent
        assert material is not None
        name = (material.findtext("script/name") or "").strip()
        if name:
            for uri in material.iterfind("script/uri"):
                look = self._script_look(uri.text or "", base, name)
                if look is not None:
                    return look
            color = _GAZEBO.get(name.rpartition("/")[2].lower())
            if color is not None:
                return SurfaceLook(color)
            self._problems[
                f"{visual.file}: material {one_line(name)!r} is in no script of the model; its "
                "surfaces are plain"
            ] += 1
        albedo = material.findtext("pbr/metal/albedo_map") or material.findtext(
            "pbr/specular/albedo_map"
        )
        texture = None if not albedo else self.texture_file(albedo.strip(), base)
        for key in ("diffuse", "ambient"):
            if (text := material.findtext(key)) and len(text.split()) in (3, 4):
                values = numbers(material, key, len(text.split()))
                return SurfaceLook(tuple(np.clip(values[:3], 0.0, 1.0).tolist()), texture)
        return SurfaceLook(None, texture)

    def _script_look(self, uri: str, base: Path, name: str) -> SurfaceLook | None:
        """Return the look of a material in an Ogre script, or in any script of a folder."""
        place = self._folders.find(uri, base)
        if place is None:
            return None
        files = [place] if place.is_file() else sorted(place.glob("*.material"))
        for file in files:
            # A folder's scripts may be links to elsewhere.
            real = self._folders.find(file.name, file.parent)
            materials = {} if real is None else self._script(real)
            if name in materials:
                color, texture = materials[name]
                found = None if texture is None else self.texture_file(texture, file.parent)
                return SurfaceLook(color, found)
        return None

    def _read_script(self, file: Path) -> dict[str, tuple[Any, str | None]]:
        """Return colour and texture of each material in an Ogre script, by its name."""
        materials: dict[str, tuple[Any, str | None]] = {}
        name = ""
        for line in read_regular(file).decode("utf-8", "replace").splitlines():
            words = line.partition("//")[0].split()
            key, values = (words[0], words[1:]) if words else ("", [])
            if key == "material" and values:
                name, _, parent = " ".join(values).partition(":")
                name = name.strip(' {"')
                materials[name] = materials.get(parent.strip(' {"'), (None, None))
            elif name and key == "texture" and values:
                materials[name] = (materials[name][0], values[0].strip('"'))
            elif name and key in ("ambient", "diffuse") and len(values) >= 3:
                try:
                    color = tuple(min(1.0, max(0.0, float(value))) for value in values[:3])
                except ValueError:  # such as `diffuse vertexcolour`
                    continue
                materials[name] = (color, materials[name][1])
        return materials

    def _painted(self, geometry: Any, look: SurfaceLook) -> Any:
        """Return a copy of a geometry with another look."""
        from trimesh.visual import TextureVisuals
        from trimesh.visual.material import PBRMaterial

        image = None if look.texture is None else self._image(look.texture)
        uv = getattr(geometry.visual, "uv", None)
        color = look.color or (1.0, 1.0, 1.0)
        painted = geometry.copy()
        material = PBRMaterial(
            baseColorFactor=[*(int(255 * value) for value in color), 255],
            baseColorTexture=None if uv is None else image,
        )
        painted.visual = TextureVisuals(uv=uv, material=material)
        _prepare(painted)
        return painted


class _Textures:
    """Gives trimesh the files that a mesh names, and no others (a resolver of trimesh)."""

    def __init__(self, loader: ShapeLoader, mesh: Path) -> None:
        self._loader, self._base = loader, mesh.parent

    def get(self, name: str) -> bytes:
        """Return a file's content."""
        path = self._loader.texture_file(str(name), self._base)
        if path is None:
            raise FileNotFoundError(name)
        return read_regular(path)

    __getitem__ = get


def _prepare(part: Any) -> None:
    """Keep of a geometry's look what the simulator shows: one colour, and one texture as JPEG."""
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    visual = part.visual
    if visual.kind in ("vertex", "face"):
        color, image = visual.main_color, None
    else:
        image = getattr(getattr(visual, "material", None), "image", None)
        image = getattr(getattr(visual, "material", None), "baseColorTexture", image)
        if image is not None and image.size[0] * image.size[1] > _MAX_PIXELS:
            raise WorldError(f"a texture has more than {_MAX_PIXELS} pixels; make it smaller")
        prepare_material(part, _MAX_TEXTURE_PX)
        material = getattr(visual, "material", None)
        color = getattr(material, "baseColorFactor", None)
        image = getattr(material, "baseColorTexture", None)
    if image is not None:
        image = image.convert("RGB")
        image.format = "JPEG"
    part.visual = TextureVisuals(
        uv=getattr(visual, "uv", None),
        material=PBRMaterial(baseColorFactor=color, baseColorTexture=image),
    )


def _primitive(element: Element) -> Any:
    """Return a geometry of SDF's own as a trimesh geometry."""
    from trimesh import Trimesh, creation

    kind = element.tag
    if kind == "box":
        return creation.box(numbers(element, "size", 3, "1 1 1"))
    if kind == "sphere":
        return creation.icosphere(3, *numbers(element, "radius", 1, "1"))
    if kind == "ellipsoid":
        mesh = creation.icosphere(3)
        mesh.apply_scale(numbers(element, "radii", 3, "1 1 1"))
        return mesh
    if kind in ("cylinder", "capsule", "cone"):
        (radius,), (length,) = (numbers(element, key, 1, "1") for key in ("radius", "length"))
        if kind == "cylinder":
            return creation.cylinder(radius, length, sections=48)
        mesh = (
            creation.capsule(length, radius) if kind == "capsule" else creation.cone(radius, length)
        )
        mesh.apply_translation([0.0, 0.0, -mesh.bounds.mean(axis=0)[2]])
        return mesh
    if kind == "plane":
        x, y = 0.5 * numbers(element, "size", 2, "1 1")
        return Trimesh(
            [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], [[0, 1, 2], [0, 2, 3]], process=False
        )
    raise WorldError(
        f"<geometry>: <{kind}> cannot be imported; replace it by a mesh, box, cylinder, sphere or "
        "plane"
    )


def _moved(shape: VisualShape) -> np.ndarray:
    """Return (n, 3) corners of a shape in the visual's frame."""
    T = shape.T_visual_shape
    return shape.geometry.vertices @ T[:3, :3].T + T[:3, 3]
