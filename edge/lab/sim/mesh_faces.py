"""Triangles of a textured scene as arrays for the kernels, with their textures in one atlas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """All triangles of a scene in the map frame, with the arrays that `shade_hits` needs.

    Attributes:
        triangles: (n, 3, 3) float32, corners [m].
        normals: (n, 3, 3) float32, normals at the corners, of any length.
        uvs: (n, 3, 2) float32, texture coordinates of the corners.
        tint: (n, 3) float32, factors on red, green and blue.
        first_level: (n,) int64, row of `levels` with the largest copy of the face's texture.
        level_count: (n,) int64, number of copies of this texture; they follow in `levels`.
        texel_density: (n,) float32, texels per metre of the largest copy of the texture.
        node: (n,) int32, index into `node_names`.
        node_names: names of the nodes (placed parts) of the scene.
        texels: (t, 3) uint8, colours of all textures and their smaller copies, one after another.
        levels: (m, 3) int64, for each copy: index of its first texel, its height and its width.
    """

    triangles: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    tint: np.ndarray
    first_level: np.ndarray
    level_count: np.ndarray
    texel_density: np.ndarray
    node: np.ndarray
    node_names: list[str]
    texels: np.ndarray
    levels: np.ndarray

    @classmethod
    def join(
        cls, parts: list[tuple[np.ndarray, ...]], node_names: list[str], atlas: Atlas
    ) -> Faces:
        """Return the triangles of several results of `face_arrays` with the same atlas."""
        return cls(
            *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)),
            node_names=node_names,
            texels=np.concatenate(atlas.texels),
            levels=np.array(atlas.levels, np.int64),
        )


class Atlas:
    """Textures one after another, each with its smaller copies (mipmap levels).

    Attributes:
        texels: one (k, 3) uint8 array of colours for each copy.
        levels: for each copy: index of its first texel (in all arrays joined), height, width.
    """

    def __init__(self) -> None:
        self.texels: list[np.ndarray] = []
        self.levels: list[tuple[int, int, int]] = []
        self._next = 0  # index of the next texel
        self._added: dict[int, tuple[int, int]] = {}  # id of an image -> result of `add`

    def add(self, image: Any) -> tuple[int, int]:
        """Add an image (PIL), or plain white for None; return (first level, level count)."""
        key = id(image)  # faces of several geometries share an image
        if key in self._added:
            return self._added[key]
        pixels = np.full((1, 1, 3), 255.0) if image is None else np.asarray(image.convert("RGB"))
        first = len(self.levels)
        while True:
            height, width = pixels.shape[:2]
            self.levels.append((self._next, height, width))
            self.texels.append(np.asarray(pixels, np.uint8).reshape(-1, 3))
            self._next += height * width
            if height == width == 1:
                break
            pixels = _halve(np.asarray(pixels, np.float32))
        self._added[key] = (first, len(self.levels) - first)
        return self._added[key]


def _halve(pixels: np.ndarray) -> np.ndarray:
    """Average 2x2 pixels; an odd last row or column is dropped."""
    for axis in (0, 1):
        size = pixels.shape[axis]
        if size > 1:  # add the odd rows (columns) to the even ones
            even = np.take(pixels, range(0, size - size % 2, 2), axis)
            pixels = 0.5 * (even + np.take(pixels, range(1, size, 2), axis))
    return pixels


def read_faces(scene: Any) -> Faces:
    """Return all triangles of a trimesh scene, in `map`; a geometry may be placed several times.

    Raises:
        ValueError: the scene has no triangles.
    """
    atlas, parts, node_names = Atlas(), [], []
    for node_name in scene.graph.nodes_geometry:
        T, geometry_name = scene.graph[node_name]
        parts.append(face_arrays(scene.geometry[geometry_name], T, atlas, len(node_names)))
        node_names.append(node_name)
    if not parts:
        raise ValueError("the file has no triangles")
    return Faces.join(parts, node_names, atlas)


def face_arrays(mesh: Any, T: np.ndarray, atlas: Atlas, node: int) -> tuple[np.ndarray, ...]:
    """Return the arrays of `Faces` from `triangles` to `node`, in this order, for one geometry.

    `T` leads from the geometry's frame to `map`. The texture of the geometry (trimesh) is added to
    the atlas.
    """
    count = len(mesh.faces)
    corners = mesh.vertices @ T[:3, :3].T + T[:3, 3]
    triangles = corners[mesh.faces]
    normals = _vertex_normals(triangles, mesh.faces, len(corners))[mesh.faces]
    material = getattr(mesh.visual, "material", None)
    image, uv = getattr(material, "baseColorTexture", None), getattr(mesh.visual, "uv", None)
    if image is None or uv is None:
        image, uv = None, np.zeros((len(mesh.vertices), 2))
    first, levels = atlas.add(image)
    # trimesh flips glTF's t, so that it counts upwards.
    uvs = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)[mesh.faces]
    factor = getattr(material, "baseColorFactor", None)
    tint = np.ones(3) if factor is None else np.asarray(factor[:3]) / 255.0
    _, height, width = atlas.levels[first]
    # Square root of the face's area in texels by its area in m².
    density = np.sqrt(
        _twice_area_2d(uvs * (width, height)) / np.maximum(_twice_area_3d(triangles), 1e-12)
    )
    return (
        np.ascontiguousarray(triangles, np.float32),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(uvs, np.float32),
        np.tile(tint.astype(np.float32), (count, 1)),
        np.full(count, first, np.int64),
        np.full(count, levels, np.int64),
        density.astype(np.float32),
        np.full(count, node, np.int32),
    )


def _vertex_normals(triangles: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """Return (count, 3) sums of the normals around each vertex, weighted by area."""
    # (faces, 3), each as long as twice the face's area.
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    corner = faces.ravel()
    return np.stack(
        [np.bincount(corner, np.repeat(across[:, j], 3), minlength=count) for j in range(3)], axis=1
    )


def _twice_area_2d(t: np.ndarray) -> np.ndarray:
    a, b = t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _twice_area_3d(t: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
