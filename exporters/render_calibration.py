"""Images of a mesh world from random free poses, for calibration or for parity checks.

    python -m exporters.render_calibration WORLD.glb --count 60 --seed 1 --out DIR

The same seed gives the same images. Use another seed for the images of a parity check.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from edge.cli.options import Parser
from edge.config import parse
from edge.geometry import CameraModel, se3, to_optical
from edge.lab.sim.base import free_poses
from edge.lab.sim.mesh import MeshWorld
from edge.lab.sim.mesh_faces import read_faces
from exporters.files import ExportError, exit_on_user_error

SIZES_HW = ((256, 320), (480, 640))
"""Sizes of the images, in turn."""
CAMERA_HEIGHT_M = (0.4, 0.6)
"""Range of the camera's height above the floor."""
HORIZONTAL_FOV_RAD = np.deg2rad(75.0)
RADIUS_M, MARGIN_M = 0.2, 0.1
"""Free space around the camera: the radius of a small robot, and more."""
MIN_MEDIAN_DEPTH_M = 0.8
"""Views with a smaller median depth show one surface without texture, which is useless for
calibration."""
MIN_HIT_SHARE = 0.9
"""Views in which a smaller share of the pixels shows the mesh are left out."""
CONFIG = parse({
    "perception": {"detector": {"kind": "sim"}},
    "robot": {"radius_m": RADIUS_M},
    "sensors": {"camera": {"depth_min_m": 0.01, "depth_max_m": 100.0}},
})  # fmt: skip


def load_world(path: Path) -> MeshWorld:
    """Read a .glb whose z axis is up; raise ExportError if it cannot be read."""
    import trimesh

    try:
        faces = read_faces(trimesh.load_scene(path))
    except Exception as error:
        raise ExportError(f"{path}: not a readable mesh ({error}); give a .glb file") from None
    return MeshWorld(path.stem, faces, [], np.zeros(len(faces.node), np.uint16), CONFIG)


def render_set(world: MeshWorld, count: int, seed: int, out: Path) -> list[Path]:
    """Write `count` images, every size in turn, and return their paths in order."""
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    paths: list[Path] = []
    while len(paths) < count:
        for pose in free_poses(world, count, int(rng.integers(1 << 32)), RADIUS_M, MARGIN_M):
            hw = SIZES_HW[len(paths) % len(SIZES_HW)]
            mount = to_optical(se3(0.0, 0.0, rng.uniform(*CAMERA_HEIGHT_M)))
            image = render(world, pose.matrix() @ mount, hw)
            if image is None or len(paths) == count:
                continue
            path = out / f"seed{seed}_{len(paths):04d}_{hw[0]}x{hw[1]}.png"
            if not cv2.imwrite(str(path), image[..., ::-1]):
                raise ExportError(
                    f"{path}: cannot be written; check the folder's permissions and the free disk "
                    "space"
                )
            paths.append(path)
    return paths


def render(world: MeshWorld, T_map_camera: np.ndarray, hw: tuple[int, int]) -> np.ndarray | None:
    """Return an image, (h, w, 3) uint8 RGB, from an optical pose; None for a useless view.

    See `MIN_MEDIAN_DEPTH_M` and `MIN_HIT_SHARE`.
    """
    camera = CameraModel.from_hfov(hw[1], hw[0], HORIZONTAL_FOV_RAD)
    rgb, depth_m = np.empty((*hw, 3), np.uint8), np.empty(hw, np.float32)
    world.render(camera, T_map_camera, rgb, depth_m, np.empty(hw, np.uint16))
    shows_mesh = np.isfinite(depth_m)
    if shows_mesh.mean() < MIN_HIT_SHARE or np.median(depth_m[shows_mesh]) < MIN_MEDIAN_DEPTH_M:
        return None
    return rgb


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
