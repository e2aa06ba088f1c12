"""Images on which models are compared: views of a simulated world, or a folder of images."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from edge import names
from edge.config import Config
from edge.errors import UserError
from edge.geometry import SE2, invert
from edge.host.c_stderr import silence_c_stderr
from edge.lab.bench.boxes import KIND_OF_PROMPT, SAME_NAME, UNRELATED, GroundTruthBoxes
from edge.lab.sim.base import World, WorldObject, free_poses
from edge.lab.sim.sensors import CameraRig
from edge.lab.sim.worlds import load_world
from edge.perception.detection import kernels
from edge.perception.embedding import text

SEED = 7  # of the robot poses
MIN_SIDE_PX = 12
"""Smaller objects do not count; in pixels of the configured camera."""
MIN_VISIBLE = 0.5
"""Objects with a smaller visible share do not count; share of the rectangle around the entire
object."""
_NEAR_M = 0.05  # nearer corners of an object are projected as if they were at this distance
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".webp")


@dataclass(frozen=True, slots=True)
class BenchFrames:
    """Images, and their ground truth if it is known.

    Attributes:
        source: where the images come from, as text for a person.
        rgb: (h, w, 3) uint8 each.
        labels: names of the objects that may be in them.
        truth: one for each image, or None if unknown.
        world: the world that the images show, or None.
        poses: robot poses in `world` that the images were taken from.
    """

    source: str
    rgb: list[np.ndarray]
    labels: tuple[str, ...]
    truth: list[GroundTruthBoxes] | None
    world: World | None = None
    poses: tuple[SE2, ...] = ()

    @property
    def counted(self) -> int:
        """Number of objects that count, over all images."""
        return sum(int(t.counts.sum()) for t in self.truth or ())


def from_world(config: Config, count: int, inputs_hw: Sequence[tuple[int, int]]) -> BenchFrames:
    """Render views of the configured world from random free poses, repeatably.

    The camera is the configured one, scaled up to the largest model input, so that no model gets an
    enlarged image.
    """
    camera = config.sensors.camera
    fits = [min(h / camera.height_px, w / camera.width_px) for h, w in inputs_hw]
    scale = max(1.0, *fits) if fits else 1.0
    size = {
        "width_px": round(camera.width_px * scale),
        "height_px": round(camera.height_px * scale),
    }
    sensors = config.sensors.model_copy(update={"camera": camera.model_copy(update=size)})
    world = load_world(config)
    rig = CameraRig(config.model_copy(update={"sensors": sensors}), world)
    labels = tuple(sorted({item.label for item in world.objects}))
    rgb, truth = [], []
    poses = tuple(free_poses(world, count, SEED, config.robot.radius_m))
    for pose in poses:
        rig.look(pose)
        rgb.append(rig.rgb.copy())
        T_camera_map = invert(pose.matrix() @ rig.T_base_camera)
        truth.append(_truth(rig, world, labels, T_camera_map, MIN_SIDE_PX * scale))
    return BenchFrames(f"{world.name}, seed {SEED}", rgb, labels, truth, world, poses)


def _truth(
    rig: CameraRig,
    world: World,
    labels: tuple[str, ...],
    T_camera_map: np.ndarray,
    min_side_px: float,
) -> GroundTruthBoxes:
    """Return the box around the visible part of each object in the rig's last image.

    An object's id in `rig.ids` is its index + 1, and `GroundTruthBoxes.label` an index of `labels`.
    Objects with a side shorter than `min_side_px` do not count.
    """
    n = len(world.objects)
    box, pixels, distance = np.empty((n, 4), np.int32), np.empty(n, np.int32), np.empty(n, "f4")
    kernels.object_boxes(rig.ids, rig.depth_m, box, pixels, distance)
    seen = np.flatnonzero(pixels)
    side = box[seen, 2:] - box[seen, :2]
    full_px = np.array([full_area_px(world.objects[k], T_camera_map, rig) for k in seen])
    # NumPy needs `initial` if no object is seen; no side is as long as it.
    large = side.min(axis=1, initial=1 << 16) >= min_side_px
    counts = large & (side.prod(axis=1) >= MIN_VISIBLE * full_px.reshape(-1))
    index = {label: k for k, label in enumerate(labels)}
    label = np.array([index[world.objects[k].label] for k in seen], np.int32)
    return GroundTruthBoxes(box[seen].astype(np.float32), label, counts)


def full_area_px(item: WorldObject, T_camera_map: np.ndarray, rig: CameraRig) -> float:
    """Return the area [px²] of an object's box in the image, without occlusion or image borders."""
    # The eight corners of a cube of side 1: bits 0 to 2 of i say on which side.
    signs = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) - 0.5
    corners = signs * item.size_m
    c, s = math.cos(item.yaw_rad), math.sin(item.yaw_rad)
    turned = corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    points = (turned + item.center_m) @ T_camera_map[:3, :3].T + T_camera_map[:3, 3]
    rays = points[:, :2] / np.maximum(points[:, 2:], _NEAR_M)
    width, height = (rays.max(axis=0) - rays.min(axis=0)) * (rig.model.fx_px, rig.model.fy_px)
    return float(width * height)


def from_folder(folder: Path, count: int) -> BenchFrames:
    """Read the first `count` images of a folder, by name; their ground truth is unknown.

    Raises:
        UserError: the folder has no image, or an image cannot be read.
    """
    paths = sorted(p for p in folder.glob("*") if p.suffix.lower() in _IMAGES)[:count]
    if not paths:
        raise UserError(f"--images {folder}: no images ({', '.join(_IMAGES)}); give another folder")
    rgb = []
    for path in paths:  # OpenCV would wait forever on a pipe
        with silence_c_stderr():
            image = cv2.imread(str(path), cv2.IMREAD_COLOR) if path.is_file() else None
        if image is None:
            raise UserError(f"{path}: not a readable image; remove the file from the folder")
        rgb.append(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    return BenchFrames(str(folder), rgb, tuple(names.ALIASES), None)


def prompts_for(
    labels: Sequence[str], resolve: Callable[[str], str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the labels that a text encoder knows, and those that it does not know.

    A label does not count as known if the encoder only has a substitute word (table for balcony
    table).
    """
    words = words_for(labels, resolve)
    known = tuple(label for label, word in words.items() if names.same_name(word, label))
    return known, tuple(label for label in labels if label not in known)


def words_for(labels: Sequence[str], resolve: Callable[[str], str]) -> dict[str, str]:
    """Map labels to an encoder's words, without its warnings.

    See `edge.perception.embedding.text.words_for`.
    """
    logging.disable(logging.WARNING)  # it warns about every substitute word
    try:
        return text.words_for(labels, resolve)
    finally:
        logging.disable(logging.NOTSET)


def relations_of(labels: Sequence[str], prompts: Sequence[str]) -> np.ndarray:
    """Return (labels, prompts) uint8, relation of each label to each prompt, see `SAME_NAME`."""
    relations = np.full((len(labels), len(prompts)), UNRELATED, np.uint8)
    for i, label in enumerate(labels):
        for j, prompt in enumerate(prompts):
            if names.same_name(label, prompt):
                relations[i, j] = SAME_NAME
            elif names.is_kind_of(label, prompt):
                relations[i, j] = KIND_OF_PROMPT
    return relations
