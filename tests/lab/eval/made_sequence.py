"""A sequence of SemanticKITTI, as small as one can be."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"
P2 = "100 0 50 20 0 100 30 10 0 0 1 0"
# Axes of a camera seen from the LiDAR's: x right, y down, z forward.
TR = "0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3"


def write(
    folder: Path, *, label: int = 40, points: int = 200, poses: int = 2, tr: bool = True
) -> Path:
    """Write a sequence of one frame: a flat road and a car of 30 points."""
    for name in ("image_2", "velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    calibration = "P2: 100 0 50 20 0 100 30 10 0 0 1 0\n" + (f"Tr: {TR}\n" if tr else "")
    (folder / "calib.txt").write_text(calibration)
    (folder / "poses.txt").write_text(f"{IDENTITY}\n" * poses)
    (folder / "times.txt").write_text("0.0\n0.1\n")
    cv2.imwrite(str(folder / "image_2/000000.png"), np.full((60, 100, 3), (10, 20, 200), np.uint8))
    random = np.random.default_rng(0)
    road = np.column_stack((random.uniform((3, -5), (30, 5), (points, 2)), np.full(points, -1.73)))
    car = random.uniform((10, -1, -1.5), (10.2, 1, -0.3), (30, 3))
    scan = np.column_stack((np.vstack((road, car)), np.zeros(points + 30))).astype(np.float32)
    labels = np.array([label] * points + [10 | 3 << 16] * 30, np.uint32)
    scan.tofile(folder / "velodyne/000000.bin")
    labels.tofile(folder / "labels/000000.label")
    return folder
