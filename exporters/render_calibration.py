"""Images of a mesh world from random free poses, for calibration or for parity checks.

    python -m exporters.render_calibration WORLD.glb --count 60 --seed 1 --out DIR

The same seed gives the same images. Use another seed for the images of a parity check.

It has its own renderer, because an INT8 detector that is calibrated on images of
`edge.lab.sim.mesh` misses its gate: recall 0.87 of YOLO-World S at 256x320, 0.98 with these images.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from edge.cli.options import Parser
from edge.geometry import se3, to_optical
from exporters.files import ExportError, exit_on_user_error

SIZES_HW = ((256, 320), (480, 640))
"""Sizes of the images, in turn."""
CAMERA_HEIGHT_M = (0.4, 0.6)
"""Range of the camera's height above the floor."""
HORIZONTAL_FOV_RAD = np.deg2rad(75.0)
CLEARANCE_M = 0.3
"""Free space around the camera, as a small robot's body needs."""
MIN_MEDIAN_DEPTH_M = 0.8
"""Views with a smaller median depth show one surface without texture, which is useless for
calibration."""
MIN_HIT_SHARE = 0.9
"""Views in which a smaller share of the rays hits the mesh are left out."""
MAX_FLOOR_M, MIN_CEILING_M = 0.05, 1.8
"""The camera must be above floor that is not higher, and under a ceiling that is not lower."""
BACKGROUND_RGB = (190, 200, 210)


@dataclass(frozen=True)
class TexturedWorld:
    """A triangle mesh with the data to colour a hit.

    Attributes:
        mesh: all triangles as one trimesh, world frame, metres, z up.
        uv: (faces, 3, 2) float32 texture coordinates per corner.
        texture_index: (faces,) int32 into `textures`.
        textures: list of (h, w, 3) uint8 RGB.
    """

    mesh: object
    uv: np.ndarray
    texture_index: np.ndarray
    textures: list[np.ndarray]


def load_world(path: Path) -> TexturedWorld:
    """Read a .glb whose z axis is up; raise ExportError if it cannot be read."""
    import trimesh

    try:
        scene = trimesh.load_scene(path)
    except Exception as error:
        raise ExportError(f"{path}: not a readable mesh ({error}); give a .glb file") from None
    parts = scene.dump()
    uv = [_corner_uv(part) for part in parts]
    texture_index = np.repeat(np.arange(len(parts), dtype=np.int32), [len(p.faces) for p in parts])
    bare = [trimesh.Trimesh(part.vertices, part.faces, process=False) for part in parts]
    mesh = trimesh.util.concatenate(bare)
    return TexturedWorld(mesh, np.concatenate(uv), texture_index, [_texture(p) for p in parts])


def _corner_uv(part: object) -> np.ndarray:
    """Return (faces, 3, 2) float32; zeros if the part has no texture coordinates."""
    uv = getattr(part.visual, "uv", None)
    if uv is None:
        return np.zeros((len(part.faces), 3, 2), np.float32)
    return np.asarray(uv, np.float32)[part.faces]


def _texture(part: object) -> np.ndarray:
    """Return the part's base colour as an RGB image; one pixel if it is a plain colour."""
    material = getattr(part.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is not None:
        return np.asarray(image.convert("RGB"))
    colour = getattr(material, "main_color", (180, 180, 180, 255))
    return np.asarray(colour, np.uint8)[None, None, :3]


def render(
    world: TexturedWorld, T_map_camera: np.ndarray, hw: tuple[int, int]
) -> np.ndarray | None:
    """Return an image, (h, w, 3) uint8 RGB, from an optical pose; None for a useless view.

    See `MIN_MEDIAN_DEPTH_M` and `MIN_HIT_SHARE`.
    """
    directions = _rays(T_map_camera[:3, :3], hw)
    origins = np.broadcast_to(T_map_camera[:3, 3], directions.shape)
    points, ray, face = world.mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    image = np.full((len(directions), 3), BACKGROUND_RGB, np.uint8)
    if not len(ray):
        return None
    depth = np.full(len(directions), np.inf)
    depth[ray] = np.linalg.norm(points - T_map_camera[:3, 3], axis=1)
    if np.median(depth) < MIN_MEDIAN_DEPTH_M or len(ray) < MIN_HIT_SHARE * len(directions):
        return None
    normals = world.mesh.face_normals[face]
    shade = 0.55 + 0.45 * np.abs(np.einsum("ij,ij->i", normals, directions[ray]))
    image[ray] = np.clip(_colour(world, points, face) * shade[:, None], 0, 255).astype(np.uint8)
    return image.reshape(*hw, 3)


def _rays(R_map_camera: np.ndarray, hw: tuple[int, int]) -> np.ndarray:
    """Return unit ray directions in the map frame, (h*w, 3), row by row."""
    height, width = hw
    focal_px = width / 2 / np.tan(HORIZONTAL_FOV_RAD / 2)
    u, v = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    # In the camera's frame: x right, y down, z forward.
    rays = np.stack([u, v, np.full_like(u, focal_px)], axis=-1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True) @ R_map_camera.T


def _colour(world: TexturedWorld, points: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Return bilinear texture colours (n, 3) float32 of hit points on faces."""
    import trimesh

    weights = trimesh.triangles.points_to_barycentric(world.mesh.triangles[face], points)
    uv = np.einsum("nk,nkc->nc", weights.astype(np.float32), world.uv[face])
    colours = np.empty((len(face), 3), np.float32)
    for index in np.unique(world.texture_index[face]):
        chosen = world.texture_index[face] == index
        colours[chosen] = _bilinear(world.textures[index], uv[chosen])
    return colours


def _bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return texture samples (n, 3) float32 at uv (n, 2), repeating, with v from the bottom row."""
    size = np.array([texture.shape[1], texture.shape[0]])
    xy = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1) % 1.0 * size - 0.5
    # Pixel to the upper left of each sample, and the sample's offset from it, (n, 1) each.
    corner = np.floor(xy).astype(np.int64)
    fx, fy = (xy - corner).T[..., None]
    (x0, y0), (x1, y1) = (corner % size).T, ((corner + 1) % size).T
    above = texture[y0, x0] * (1 - fx) + texture[y0, x1] * fx
    below = texture[y1, x0] * (1 - fx) + texture[y1, x1] * fx
    return above * (1 - fy) + below * fy


def free_pose(world: TexturedWorld, rng: np.random.Generator) -> np.ndarray:
    """Return a random level T_map_camera over open floor with `CLEARANCE_M` on all sides."""
    (x0, y0, _), (x1, y1, _) = world.mesh.bounds
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    while True:
        origin = np.array([rng.uniform(x0, x1), rng.uniform(y0, y1), rng.uniform(*CAMERA_HEIGHT_M)])
        down, _, _ = world.mesh.ray.intersects_location([origin], [[0, 0, -1]], multiple_hits=False)
        up, _, _ = world.mesh.ray.intersects_location([origin], [[0, 0, 1]], multiple_hits=False)
        if not len(down) or not len(up) or down[0, 2] > MAX_FLOOR_M or up[0, 2] < MIN_CEILING_M:
            continue
        around, _, _ = world.mesh.ray.intersects_location(
            np.repeat(origin[None], len(ring), 0), ring, multiple_hits=False
        )
        if len(around) and np.linalg.norm(around - origin, axis=1).min() > CLEARANCE_M:
            return to_optical(se3(*origin, yaw_rad=rng.uniform(-np.pi, np.pi)))


def render_set(world: TexturedWorld, count: int, seed: int, out: Path) -> list[Path]:
    """Write `count` pictures, every size in turn, and return their paths in order."""
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    paths: list[Path] = []
    while len(paths) < count:
        hw = SIZES_HW[len(paths) % len(SIZES_HW)]
        image = render(world, free_pose(world, rng), hw)
        if image is None:
            continue
        path = out / f"seed{seed}_{len(paths):04d}_{hw[0]}x{hw[1]}.png"
        if not cv2.imwrite(str(path), image[..., ::-1]):
            raise ExportError(
                f"{path}: cannot be written; check the folder's permissions and the free disk space"
            )
        paths.append(path)
    return paths


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    # fmt: off
    parser = Parser(prog="python -m exporters.render_calibration", description="render images of "
                    "a textured world, to calibrate quantization with")
    option = parser.add_argument
    option("world", type=Path, help="mesh file of the world (.glb), z up, in m")
    option("--count", type=int, default=60, help="number of images")
    option("--seed", type=int, default=1, help="seed of the camera poses")
    option("--out", type=Path, required=True, help="folder for the images (required)")
    # fmt: on
    args = parser.parse_args(argv)
    paths = render_set(load_world(args.world), args.count, args.seed, args.out)
    print(f"{len(paths)} images in {args.out}")


if __name__ == "__main__":
    sys.exit(main())
