"""A made street: boxes on a plane, seen by a LiDAR of 64 rings and a camera, with known truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from edge.geometry import CameraModel, se3, to_optical
from edge.types import Detections, Observation

LIDAR = se3(0.0, 0.0, 1.7)
CAMERA = to_optical(se3(0.2, 0.0, 1.5))
MODEL = CameraModel.from_hfov(400, 240, 1.5)
GROUND = -1
SKY = -2
GRAY = (120, 120, 120)


@dataclass(frozen=True)
class Box:
    """An upright box on the ground: middle, size along its heading, across and up, heading."""

    x_m: float
    y_m: float
    size_m: tuple[float, float, float] = (4.0, 1.8, 1.5)
    heading_rad: float = 0.0
    label: str = "car"
    colour: tuple[int, int, int] = (200, 30, 30)


def cast(boxes, origin, directions):
    """Return each ray's distance to its first hit, and the hit box (GROUND, SKY)."""
    with np.errstate(all="ignore"):
        far = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
        hit = np.where(np.isfinite(far), GROUND, SKY)
        for i, box in enumerate(boxes):
            c, s = np.cos(box.heading_rad), np.sin(box.heading_rad)
            R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            half = 0.5 * np.array(box.size_m)
            o = R @ (origin - (box.x_m, box.y_m, half[2]))
            enter, leave = -np.inf, np.inf
            for k in range(3):
                d = directions @ R[k]
                sides = (-half[k] - o[k]) / d, (half[k] - o[k]) / d
                enter = np.maximum(enter, np.minimum(*sides))
                leave = np.minimum(leave, np.maximum(*sides))
            nearer = (enter < leave) & (enter > 0) & (enter < far)
            far, hit = np.where(nearer, enter, far), np.where(nearer, i, hit)
    return far, hit


def street(boxes, T_map_base=None, seq=1, range_m=50.0, rings=64, columns=720):
    """Return an observation of the street, and the box of each point of its cloud."""
    T_map_base = np.eye(4) if T_map_base is None else T_map_base
    elevation = np.radians(np.linspace(2.0, -24.8, rings))
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    e, a = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
    rays = np.stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), axis=1)
    T = T_map_base @ LIDAR
    far, hit = cast(boxes, T[:3, 3], rays @ T[:3, :3].T)
    back = far < range_m
    cloud = (rays[back] * far[back, None]).astype(np.float32)
    rgb, _ = picture(boxes, T_map_base)
    observation = Observation(
        seq=seq, stamp_ns=seq * 100_000_000, T_map_base=T_map_base, rgb=rgb, camera=MODEL,
        T_base_camera=CAMERA, cloud_m=cloud, T_base_lidar=LIDAR,
    )  # fmt: skip
    return observation, hit[back]


def picture(boxes, T_map_base):
    """Return the camera's image, and the box that each pixel shows."""
    return _picture(tuple(boxes), T_map_base.tobytes())


@lru_cache(maxsize=4)  # used for the cloud and again for the detections
def _picture(boxes, T_map_base):
    v, u = np.mgrid[: MODEL.height_px, : MODEL.width_px]
    rays = np.stack(
        ((u - MODEL.cx_px) / MODEL.fx_px, (v - MODEL.cy_px) / MODEL.fy_px, np.ones_like(u)), axis=-1
    ).reshape(-1, 3)
    T = np.frombuffer(T_map_base).reshape(4, 4) @ CAMERA
    _, hit = cast(boxes, T[:3, 3], rays @ T[:3, :3].T)
    colours = np.array([box.colour for box in boxes] + [(150, 190, 240), GRAY], np.uint8)
    shape = MODEL.height_px, MODEL.width_px
    return colours[hit].reshape(*shape, 3), hit.reshape(shape)


def found_in(observation, boxes):
    """Return the boxes of a perfect detector around the visible part of each object."""
    _, hit = picture(boxes, observation.T_map_base)
    labels = tuple(dict.fromkeys(box.label for box in boxes))
    xyxy, class_id = [], []
    for i, box in enumerate(boxes):
        v, u = np.nonzero(hit == i)
        if len(v):
            xyxy.append((u.min(), v.min(), u.max() + 1, v.max() + 1))
            class_id.append(labels.index(box.label))
    n = len(xyxy)
    return Detections(
        observation, np.array(xyxy, np.float32).reshape(n, 4), np.full(n, 0.8, np.float32),
        np.array(class_id, np.int32), labels,
    )  # fmt: skip
