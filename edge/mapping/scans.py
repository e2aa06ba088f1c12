"""Depth images and point clouds, read into polar bins around the sensor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edge import config
from edge.geometry import FARTHEST_M, CameraModel
from edge.mapping import points
from edge.mapping.ground import FloorTracker
from edge.mapping.layers import plain

# An obstacle of this width and height gets two samples across and four up at full range. Its
# lowest sample may look like ground; the highest must still be 0.06 m above that.
_SMALLEST_OBSTACLE_M = 0.1
_SAMPLES_ACROSS, _SAMPLES_UP = 2, 4


class PixelSamples(NamedTuple):
    """The pixels of a camera that are read: every stride-th one.

    Attributes:
        strides: across and up.
        column, row: (w,) and (h,) float32: (u - cx) / fx and (v - cy) / fy of each pixel.
    """

    camera: CameraModel
    strides: tuple[int, int]
    column: np.ndarray
    row: np.ndarray
    n: int


def pixel_samples(camera: CameraModel, range_m: float) -> PixelSamples:
    """Choose the pixels that find the smallest obstacle at full range."""
    pixels = _SMALLEST_OBSTACLE_M / range_m
    strides = (
        max(1, int(camera.fx_px * pixels / _SAMPLES_ACROSS)),
        max(1, int(camera.fy_px * pixels / _SAMPLES_UP)),
    )
    size = camera.width_px, camera.height_px
    u, v = (np.arange(pixels) for pixels in size)
    return PixelSamples(
        camera,
        strides,
        ((u - camera.cx_px) / camera.fx_px).astype(np.float32),
        ((v - camera.cy_px) / camera.fy_px).astype(np.float32),
        math.prod(len(range(by // 2, n, by)) for n, by in zip(size, strides, strict=True)),
    )


class ScanReader:
    """A reader of scans: it finds floor, steps and heights of obstacles in the newest points.

    Attributes:
        polar: bins of the *scratch grid*: a square of cells with the sensor's cell in its centre.
        half_side: cells on each side of its centre.
        scan: the newest points, classified.
        lost_rays: (sectors,) uint64, see `points.lost_rays`.
        floor: the floor under the robot.
        sensor_cell: the sensor's world cell.
        sensor_z_m: height of the sensor in `map`.
        coded_m: height of the highest code of `Layers.top`.
    """

    def __init__(self, config: config.MappingConfig, robot: config.RobotConfig) -> None:
        self._config, self._robot = config, robot
        self.polar = points.make_polar(config.range_m, config.resolution_m)
        self.half_side = self.polar.bin_of.shape[0] // 2
        self.scan = points.make_scan(self.polar, 1024)
        self.lost_rays = np.zeros(self.polar.sectors, np.uint64)
        self.floor = FloorTracker(config)
        self.sensor_cell, self.sensor_z_m = (0, 0), 0.0
        self._at = np.float32(0.0), np.float32(0.0)  # the sensor in the scratch grid, in cells
        self.coded_m = max(config.obstacle_max_m, points.CODED_M)
        self._samples: PixelSamples | None = None

    def read_depth(
        self,
        depth_m: np.ndarray,
        camera: CameraModel,
        T_map_base: np.ndarray,
        T_base_camera: np.ndarray,
    ) -> None:
        """Read a depth image; see `RollingMap.update_depth`."""
        if depth_m.shape != (camera.height_px, camera.width_px):
            raise ValueError(
                f"depth image is {depth_m.shape}, its camera {camera.height_px}x"
                f"{camera.width_px} (height x width): send the matching camera info"
            )
        samples = self._samples
        if samples is None or samples.camera != camera:
            samples = self._samples = pixel_samples(camera, self._config.range_m)
            self._reserve(samples.n)
        T = self._locate(T_map_base, T_base_camera)
        seen = (
            plain(depth_m), *samples.strides, samples.column, samples.row, T,
            np.float32(self._config.min_range_m),
        )  # fmt: skip
        n_points = points.from_depth(*seen, self.scan.xyz)
        self.lost_rays[:] = 0
        if n_points < samples.n:
            points.lost_rays(*seen, self.polar, self.lost_rays)
        self._classify(n_points, n_points, T_map_base, T_base_camera)

    def read_cloud(
        self, cloud_m: np.ndarray, T_map_base: np.ndarray, T_base_lidar: np.ndarray
    ) -> None:
        """Read a point cloud; see `RollingMap.update_cloud`."""
        if cloud_m.ndim != 2 or cloud_m.shape[1] != 3:
            raise ValueError(f"cloud has shape {cloud_m.shape}, expected (n, 3): x, y, z in metres")
        self._reserve(len(cloud_m))
        T = self._locate(T_map_base, T_base_lidar)
        hits, n_points = points.from_cloud(
            plain(cloud_m), T, np.float32(self._config.min_range_m), self.scan.xyz
        )
        self.lost_rays[:] = 0
        self._classify(n_points, hits, T_map_base, T_base_lidar)

    def _reserve(self, n_points: int) -> None:
        """Make the scratch arrays large enough for so many points."""
        if len(self.scan.cell) < n_points:
            self.scan = points.make_scan(self.polar, n_points + n_points // 4)

    def _locate(self, T_map_base: np.ndarray, T_base_sensor: np.ndarray) -> np.ndarray:
        """Set the sensor's place; return `T_map_sensor` without its last row, (3, 4) float32."""
        T_map_sensor = T_map_base @ T_base_sensor
        x_m, y_m = T_map_sensor[:2, 3].tolist()
        coordinates = x_m, y_m, *T_map_base[:2, 3].tolist()
        if not np.isfinite(T_map_sensor).all() or not all(abs(v) < FARTHEST_M for v in coordinates):
            raise ValueError(
                f"sensor or robot pose is not finite or beyond {FARTHEST_M:.0e} m: "
                f"x, y of sensor and robot {coordinates}"
            )
        cell_m, half = self._config.resolution_m, self.half_side
        x, y = x_m / cell_m, y_m / cell_m
        self.sensor_cell = x_cell, y_cell = math.floor(x), math.floor(y)
        self._at = np.float32(half + x - x_cell), np.float32(half + y - y_cell)
        T = np.ascontiguousarray(T_map_sensor[:3], np.float32)
        self.sensor_z_m = float(T[2, 3])
        return T

    def _classify(
        self, n_points: int, hits: int, T_map_base: np.ndarray, T_base_sensor: np.ndarray
    ) -> None:
        """Classify the points in `scan.xyz`: first `hits`, then ends of rays that hit nothing."""
        c, polar, scan, robot = self._config, self.polar, self.scan, self._robot
        sensor_z = np.float32(self.sensor_z_m)
        if robot.self_filter_m:
            axes = T_map_base[:3, :3].astype(np.float32, order="C")
            sensor_m = T_base_sensor[:3, 3].astype(np.float32)
            n_points, hits = points.drop_self_points(
                n_points, hits, scan.xyz, axes, sensor_m, sensor_z, robot.self_filter_m,
                robot.height_m,
            )  # fmt: skip
        n = points.bin_points(
            n_points, hits, sensor_z, np.float32(c.range_m), np.float32(1.0 / c.resolution_m),
            *self._at, polar, scan,
        )  # fmt: skip
        self.floor.update(scan, polar, self.sensor_z_m, float(T_map_base[2, 3]))
        if self.floor.is_missing:
            n, scan.reach_m[:] = 0, 0.0
        points.classify(n, scan, polar, c.obstacle_min_m, c.obstacle_max_m, self.coded_m)
        if self.coded_m > c.obstacle_max_m:
            points.extend_obstacles_up(n, scan, polar, c.obstacle_max_m, self.coded_m)
