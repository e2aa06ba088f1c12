"""Measurements of an observation; the checks of `edge.loop.checks.plausibility` limit them."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from edge.config import Config
from edge.geometry import FARTHEST_M, SE2, CameraModel, wrap_angle
from edge.loop.checks.depth_motion import MISFIT, DepthMotionCheck
from edge.types import Observation

FROZEN_AFTER_M = 0.1
"""A frame that does not change in any bit over this distance is frozen; 1 rad counts as 1 m."""
_MOVES_M = 0.02  # below this motion, frames may be identical
VALID_SHARE = 0.02  # smallest share of a depth image's pixels with a value
# After an object nearer than `_CLOSE_M` was seen, an empty depth image is no failure until the
# robot has moved `_CLOSE_WAY_M`; see `FrameMeter._is_close`.
_CLOSE_M, _CLOSE_WAY_M = 0.6, 0.2
_WALL_M = 1.5  # one object may fill the image at this distance
_SLOW_NS = 100_000_000  # period of measurements that change slowly
_BUFFERS = 4  # number of frames that a hanging driver may repeat in turn
_SAMPLES = 32  # rows and columns of the sample of an image
_FEWEST = 50  # smallest number of sampled pixels for `_FloorLimit`
_NEAR_SHARE = 0.05  # share of the pixels that may be near by noise
_BELOW_BASE_M = 1.0  # the floor is at most this far below the base, e.g. at stairs
_STEEP = 0.25  # smallest slope of a ray that is compared with the floor: m down per m of depth
_MARGIN = 1.3  # a depth may be larger than that of the floor by this factor
_FARTHEST_M = 100.0  # every depth camera sees something nearer than this
_Step = tuple[float, float, float]
"""Motion of the robot from one observation to the next (x, y, yaw)."""


@dataclass(slots=True)
class FrameFacts:
    """Measurements of one observation. NaN means not measured; no check fails on it.

    Attributes:
        depth_valid: Share of the depth image's pixels that have a value.
        depth_driven_m: Distance driven since the depth image last changed.
        depth_misfit: Share of the depth image's points that did not move as the pose did.
        depth_scale: Ratio of the measured depth to the depth of the floor; 1 if it fits.
        cloud_driven_m: Distance driven since the cloud last changed.
        cloud_points: Number of points of the cloud that have a value.
        rgb_driven_m: Distance driven since the colour image last changed.
        rgb_levels: Difference between the largest and the smallest value of the colour image.
        rgb_level: Mean of its green values, 0 to 255.
        axis_z: z of the camera's optical axis in the base frame, -1 (down) to 1 (up).
        floor_lost: 1 if the last update of the map found no floor at the height of the mount,
            else 0.
        late_s: Time from the frame to the newest pose.
        pose_age_s: Age of the frame's pose relative to the frame; 0 if it is interpolated.
    """

    depth_valid: float = math.nan
    depth_driven_m: float = math.nan
    depth_misfit: float = math.nan
    depth_scale: float = math.nan
    cloud_driven_m: float = math.nan
    cloud_points: float = math.nan
    rgb_driven_m: float = math.nan
    rgb_levels: float = math.nan
    rgb_level: float = math.nan
    axis_z: float = math.nan
    floor_lost: float = math.nan
    late_s: float = math.nan
    pose_age_s: float = math.nan

    def clear(self) -> None:
        """Set every measurement to NaN."""
        for name in self.__slots__:
            setattr(self, name, math.nan)


class FrameMeter:
    """Measures the observations of one camera.

    Attributes:
        facts: Measurements of the newest observation.
        surroundings_ns: Loop time of the newest real picture of the surroundings. It is older than
            the newest observation if that came late or is a repetition.
        floor_lost: True if the last update of the map found no floor; see `FrameFacts`.
    """

    def __init__(self, config: Config) -> None:
        self.facts = FrameFacts()
        self.surroundings_ns = 0
        self._pose: SE2 | None = None  # of the last observation
        self._close_at: SE2 | None = None  # pose at which the view was full of something close
        # Loop time of the newest slow measurements, and their results.
        self._slow_ns = -_SLOW_NS
        self._scale = math.nan
        self._levels = math.nan, math.nan  # `rgb_levels` and `rgb_level`
        self.floor_lost = False
        self._depth, self._rgb, self._cloud = _Repeats(), _Repeats(), _Repeats()
        self._floor = _FloorLimit()
        self._motion = DepthMotionCheck(config.robot.max_speed_mps, config.robot.max_turn_radps)

    def measure(self, observation: Observation, now_ns: int) -> None:
        """Fill `facts`. Measurements that change slowly are made once in `_SLOW_NS`."""
        facts, rgb, depth_m = self.facts, observation.rgb, observation.depth_m
        facts.clear()
        step = self._step(observation.pose)
        slow = not 0 <= now_ns - self._slow_ns < _SLOW_NS  # negative: the clock was set back
        self._slow_ns = now_ns if slow else self._slow_ns
        self.surroundings_ns = now_ns - observation.lag_ns
        facts.late_s, facts.pose_age_s = observation.lag_ns * 1e-9, observation.pose_age_ns * 1e-9
        facts.floor_lost = float(self.floor_lost)
        wall = False
        if depth_m is not None and observation.camera is not None:
            wall = self._measure_depth(observation, depth_m, observation.camera, step, now_ns, slow)
        if rgb is not None:
            self._measure_rgb(rgb, step, now_ns, slow, wall)
        if rgb is not None or depth_m is not None:
            facts.axis_z = float(observation.T_base_camera[2, 2])
        if observation.cloud_m is not None:
            self._measure_cloud(observation.cloud_m, step, now_ns)

    def _measure_depth(
        self,
        observation: Observation,
        depth_m: np.ndarray,
        camera: CameraModel,
        step: _Step,
        now_ns: int,
        slow: bool,
    ) -> bool:
        """Measure the depth image; return True if something near fills half of it."""
        facts, pose, wall = self.facts, observation.pose, False
        sample = self._depth.sample(depth_m)
        valid = (sample > 0.0) & (sample < FARTHEST_M)
        facts.depth_valid = float(np.count_nonzero(valid) / sample.size)
        if facts.depth_valid >= VALID_SHARE:
            most = 0.5 * facts.depth_valid * sample.size
            close = np.count_nonzero(valid & (sample < _CLOSE_M)) > most
            self._close_at = pose if close else None
            wall = bool(np.count_nonzero(valid & (sample < _WALL_M)) > most)
        elif self._is_close(pose):
            facts.depth_valid = math.nan
        if facts.depth_valid > 0.0:
            facts.depth_driven_m = self._unchanged_m(self._depth, depth_m, step, now_ns)
        if slow:
            shape, stride, T = depth_m.shape, self._depth.stride, observation.T_base_camera
            self._scale = self._floor.scale(sample, valid, shape, stride, camera, T)
        facts.depth_scale = self._scale
        facts.depth_misfit = self._misfit(observation, depth_m, camera, sample, now_ns)
        return wall

    def _measure_rgb(
        self, rgb: np.ndarray, step: _Step, now_ns: int, slow: bool, wall: bool
    ) -> None:
        """Measure the colour image; `wall` is the result of `_measure_depth`."""
        facts, sample = self.facts, self._rgb.sample(rgb)
        if slow:
            low, high = float(sample.min()), float(sample.max())
            # Green is all of grey, and a third of the work.
            self._levels = high - low, float(sample[..., 1].mean())
        facts.rgb_levels, facts.rgb_level = self._levels
        if wall:  # it may have one colour, as in a simulator
            facts.rgb_levels = math.nan
        if self._levels[0] > 0.0:  # frames of one colour are all equal
            facts.rgb_driven_m = self._unchanged_m(self._rgb, rgb, step, now_ns)

    def _measure_cloud(self, cloud_m: np.ndarray, step: _Step, now_ns: int) -> None:
        """Measure the points of a LiDAR."""
        size = np.abs(self._cloud.sample(cloud_m)).max(axis=1)
        self.facts.cloud_points = float(np.count_nonzero(size > 0.0))
        # Beams that hit nothing (inf) look the same from every place.
        if np.count_nonzero((size > 0.0) & np.isfinite(size)):
            self.facts.cloud_driven_m = self._unchanged_m(self._cloud, cloud_m, step, now_ns)

    def _unchanged_m(self, frames: _Repeats, array: np.ndarray, step: _Step, now_ns: int) -> float:
        """Return `_Repeats.driven_m`; a frozen sensor shows old surroundings."""
        driven_m = frames.driven_m(array, step, now_ns)
        if driven_m > FROZEN_AFTER_M:
            self.surroundings_ns = min(self.surroundings_ns, frames.since_ns)
        return driven_m

    def _is_close(self, pose: SE2) -> bool:
        """Return True if an object is too close to the camera for depth.

        Such a camera sends no depth until the robot has turned away, so the robot must be able to
        turn.
        """
        at = self._close_at
        return at is not None and pose.distance_to(at.x_m, at.y_m) < _CLOSE_WAY_M

    def _misfit(
        self,
        observation: Observation,
        depth_m: np.ndarray,
        camera: CameraModel,
        sample: np.ndarray,
        now_ns: int,
    ) -> float:
        """Return `DepthMotionCheck.misfit`; a depth image that does not fit shows nothing real."""
        T, stride = observation.T_map_base, self._depth.stride
        misfit = self._motion.misfit(
            depth_m, sample, stride, camera, T @ observation.T_base_camera, T[2, 3],
            observation.stamp_ns, now_ns, self._depth.repeats,
        )  # fmt: skip
        if misfit > MISFIT:
            self.surroundings_ns = min(self.surroundings_ns, self._motion.since_ns)
        return misfit

    def _step(self, pose: SE2) -> _Step:
        """Return how the pose moved since the last observation (x, y, yaw)."""
        last, self._pose = self._pose or pose, pose
        return pose.x_m - last.x_m, pose.y_m - last.y_m, wrap_angle(pose.yaw_rad - last.yaw_rad)


class _Repeats:
    """Detection of repeated frames of one sensor, by a sample of the newest frame.

    A frame is a repetition if it equals one of the last few: a driver that hangs may send its
    buffers in turn.

    Attributes:
        stride: Rows and columns from one sampled pixel to the next.
        since_ns: Loop time of the newest frame that showed the real surroundings.
        repeats: True if the newest frame is a repetition.
    """

    def __init__(self) -> None:
        self.stride = (1, 1)
        self.since_ns = 0
        self.repeats = False
        self._sample: np.ndarray = np.empty(0)
        # Last few frames: checksum of the sample -> checksum of the entire frame, which is computed
        # at the first repetition.
        self._known: dict[int, int | None] = {}
        # Since the frames last changed: motion (x, y, yaw), the longest step of it, and the
        # distance without that step.
        self._way = np.zeros(3)
        self._longest_m = self._driven_m = 0.0

    def sample(self, array: np.ndarray) -> np.ndarray:
        """Set `stride`; return a copy of every stride-th row and column, or point of a cloud."""
        cloud = array.shape[1] == 3 and array.ndim == 2
        rows = _SAMPLES * _SAMPLES if cloud else _SAMPLES
        # Rounded up, so that the sample never has more than `rows` rows.
        v = max(1, math.ceil(len(array) / rows))  # a cloud may be empty
        u = 1 if cloud else math.ceil(array.shape[1] / _SAMPLES)
        self.stride = v, u
        picked = array[v // 2 :: v, u // 2 :: u]
        if picked.shape != self._sample.shape or picked.dtype != self._sample.dtype:
            self._sample = np.empty(picked.shape, picked.dtype)
        np.copyto(self._sample, picked)
        return self._sample

    def driven_m(self, array: np.ndarray, step: _Step, now_ns: int) -> float:
        """Return the distance (1 rad of turn counts as 1 m) since the frames last changed.

        The longest step does not count, because a localisation may have corrected the pose of a
        standing robot. The entire frame is read only if its sample equals one of the last few.
        """
        crc, known = zlib.crc32(self._sample.data), self._known
        full = zlib.crc32(np.ascontiguousarray(array).data) if crc in known else None
        self.repeats = full is not None and known[crc] in (None, full)
        if not self.repeats:
            known.pop(crc, None)
            known[crc], self.since_ns = full, now_ns
            self._way[:], self._longest_m, self._driven_m = 0.0, 0.0, 0.0
            if len(known) > _BUFFERS:
                del known[next(iter(known))]
            return 0.0
        # At the first repetition the frame before was not read completely, so only its sample is
        # known to be equal. The distance counts from the second repetition on.
        is_certain, known[crc] = known[crc] is not None, full
        self._way += step
        way_m, self._longest_m = _length_m(self._way), max(self._longest_m, _length_m(step))
        if way_m < _MOVES_M:
            self.since_ns = now_ns
        if is_certain:
            self._driven_m = max(self._driven_m, way_m - self._longest_m)
        return self._driven_m


def _length_m(step: Iterable[float]) -> float:
    """Return the length of a motion (x, y, yaw); 1 rad of turn counts as 1 m."""
    x, y, yaw = step
    return math.hypot(x, y) + abs(yaw)


class _FloorLimit:
    """The largest plausible depth at each pixel, from the camera's mount above the floor."""

    def __init__(self) -> None:
        self._mount: tuple[CameraModel, np.ndarray] | None = None
        self._steep = np.empty(0, np.bool_)
        self._floor_m: np.ndarray = np.empty(0)
        self._limit_m: np.ndarray = np.empty(0)

    def scale(
        self,
        sample: np.ndarray,
        valid: np.ndarray,
        shape: tuple[int, ...],
        stride: tuple[int, int],
        camera: CameraModel,
        T: np.ndarray,
    ) -> float:
        """Return the ratio of the image's depth to the floor's; 1 if the image is plausible.

        It is plausible if at least `_NEAR_SHARE` of the pixels are nearer than the limit. Else the
        ratio is the median over the pixels.

        Args:
            sample: Every stride-th row and column of the depth image.
            valid: Pixels of the sample that have a value.
            shape: Height and width of the depth image.
            stride: Rows and columns from one sampled pixel to the next.
            camera: Intrinsics of the camera.
            T: (4, 4) pose of the camera (optical) in the base frame.
        """
        mount = self._mount
        if mount is None or mount[0] != camera or mount[1] is not T:
            self._mount = camera, T
            self._compute_floor(shape, camera, T, stride)
        judged, floor_m = valid & self._steep, self._floor_m
        limit_m: np.ndarray | float = self._limit_m
        n = np.count_nonzero(judged)
        if n < _FEWEST:  # no ray looks down, so only the general limit applies
            judged, limit_m = valid, _FARTHEST_M
            n = np.count_nonzero(valid)
        if n < _FEWEST or np.count_nonzero((sample < limit_m) & judged) >= _NEAR_SHARE * n:
            return 1.0
        return float(np.median(sample[judged] / floor_m[judged]))

    def _compute_floor(
        self, shape: tuple[int, ...], camera: CameraModel, T: np.ndarray, stride: tuple[int, int]
    ) -> None:
        """Compute the floor's depth, and the largest plausible depth, at each sampled pixel."""
        v, u = stride
        row = (np.arange(v // 2, shape[0], v) - camera.cy_px) / camera.fy_px
        column = (np.arange(u // 2, shape[1], u) - camera.cx_px) / camera.fx_px
        down = -(T[2, 0] * column[None, :] + T[2, 1] * row[:, None] + T[2, 2])
        self._steep = down >= _STEEP
        down, height_m = np.maximum(down, _STEEP), max(float(T[2, 3]), 0.0)
        self._floor_m = (max(height_m, 0.1) / down).astype(np.float32)
        self._limit_m = (_MARGIN * (height_m + _BELOW_BASE_M) / down).astype(np.float32)
