"""Check that the content of depth images moves as the poses do; for `plausibility`.

It finds delays, wrong stamps, bad odometry and a wrong mount of the camera.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from edge.geometry import FARTHEST_M, CameraModel
from edge.host.backoff import pause_after

MISFIT = 0.45
"""Largest share of informative points in the wrong place. It is usually below 0.1."""
RETRY_NS, MOST_RETRY_NS = 800_000_000, 64_000_000_000
"""Shortest and longest time between retries after a failure. A standing robot cannot measure
whether images and poses fit again, so it retries at growing intervals."""
# Distances between views; 1 rad of turn counts as 1 m.
_APART_M = 0.08  # a view is kept if it is this far from the last one
_BASELINE_M, _FARTHEST_M = 0.2, 0.6  # views within this range are compared
_VIEWS = 4  # number of views that are kept
_SCORES = 5  # the check uses the mean of so many scores: a person may fill the view for a moment
_GOOD_SCORES = 12  # after so many good scores, retries start again at `RETRY_NS`
_STRIPS = 8  # vertical strips of an image
# A score needs so many strips, each with so many informative points.
_MIN_STRIPS, _MIN_POINTS = 4, 8
_FLOOR_M = 0.12  # lower points look the same from everywhere
# A pose that moves faster than the robot's limits times the first number, plus the second in
# metres, was corrected, so older views are useless.
_SPEED_MARGIN, _SLACK_M = 2.0, 0.02


class _View(NamedTuple):
    """An earlier depth image.

    Attributes:
        T_map_camera: (4, 4) pose of the camera (optical).
        points_m: (n, 3) float64 in `map`, without the floor.
        sample_m: every stride-th row and column of the image.
    """

    T_map_camera: np.ndarray
    points_m: np.ndarray
    sample_m: np.ndarray


class DepthMotionCheck:
    """A comparison of each depth image with an earlier one from a nearby camera pose.

    The motion of the pose predicts the depth of each point of the earlier view. A point is
    informative if this depth differs from the one that the same pixel showed before. Most points of
    a corridor's walls are not.

    The image is cut into vertical strips. All strips but one must be wrong (all, if four or five
    are informative), so that people who walk in front of the camera cause no failure.

    Attributes:
        since_ns: Loop time since which the images do not fit.
    """

    def __init__(self, max_speed_mps: float, max_turn_radps: float) -> None:
        self.since_ns = 0
        self._speed, self._turn = max_speed_mps, max_turn_radps
        self._views: deque[_View] = deque(maxlen=_VIEWS)
        self._scores: deque[tuple[int, float]] = deque(maxlen=_SCORES)  # loop time and score
        self._last: tuple[np.ndarray, int] | None = (
            None  # `T_map_camera` and stamp of the last image
        )
        # While it fails: the misfit, and the time of the next retry.
        self._failed: tuple[float, int] | None = None
        self._n_failed = self._n_good = 0

    def misfit(
        self,
        depth_m: np.ndarray,
        sample_m: np.ndarray,
        stride: tuple[int, int],
        camera: CameraModel,
        T_map_camera: np.ndarray,
        floor_m: float,
        stamp_ns: int,
        now_ns: int,
        repeats: bool,
    ) -> float:
        """Return the share of points in the wrong place; NaN while it cannot be measured.

        Args:
            depth_m: (h, w) float32 depth image.
            sample_m: Every stride-th row and column of the image.
            stride: Rows and columns between sampled pixels.
            camera: Intrinsics of the camera.
            T_map_camera: (4, 4) pose of the camera (optical).
            floor_m: Height of the base in `map`.
            stamp_ns: Stamp of the image.
            now_ns: Loop time.
            repeats: True if the image is a repetition, which has no information.
        """
        if self._failed is not None:
            value, until_ns = self._failed
            if now_ns < until_ns:
                return value
            self._reset()
        if self._has_jumped(T_map_camera, stamp_ns) or repeats:
            self._reset()
            return math.nan
        moved_m = [_moved_m(view.T_map_camera, T_map_camera) for view in self._views]
        if moved_m and moved_m[-1] < _APART_M:  # too near to the last view to be useful
            return self._mean_score()
        for view, way_m in zip(self._views, moved_m, strict=True):
            if _BASELINE_M <= way_m <= _FARTHEST_M:
                score = _misplaced_share(view, depth_m, stride, camera, T_map_camera)
                if not math.isnan(score):
                    self._add_score(score, now_ns)
                break
        self._views.append(_make_view(sample_m, stride, camera, T_map_camera, floor_m))
        return self._mean_score()

    def _add_score(self, score: float, now_ns: int) -> None:
        """Add the score of a comparison; start or end a failure."""
        self._scores.append((now_ns, score))
        mean = self._mean_score()
        if mean > MISFIT:
            self.since_ns = self._scores[0][0]
            self._n_failed, self._n_good = self._n_failed + 1, 0
            pause_ns = int(pause_after(self._n_failed, RETRY_NS, MOST_RETRY_NS))
            self._failed = mean, now_ns + pause_ns
        elif score <= MISFIT:
            self._n_good += 1
            if self._n_good >= _GOOD_SCORES:
                self._n_failed = 0

    def _mean_score(self) -> float:
        """Return the mean of the newest scores; NaN while there are too few."""
        if len(self._scores) < _SCORES:
            return math.nan
        return sum(score for _, score in self._scores) / _SCORES

    def _reset(self) -> None:
        self._views.clear()
        self._scores.clear()
        self._failed = None

    def _has_jumped(self, T_map_camera: np.ndarray, stamp_ns: int) -> bool:
        """Return True if the pose moved faster than the robot can."""
        last, self._last = self._last, (T_map_camera, stamp_ns)
        if last is None:
            return False
        passed_s = abs(stamp_ns - last[1]) * 1e-9
        most_m = _SPEED_MARGIN * passed_s * (self._speed + self._turn) + _SLACK_M
        return _moved_m(last[0], T_map_camera) > most_m


def _moved_m(T: np.ndarray, other: np.ndarray) -> float:
    """Return how far a camera moved, 1 rad of turn counted as 1 m."""
    cosine = 0.5 * (float(np.vdot(T[:3, :3], other[:3, :3])) - 1.0)
    return math.dist(T[:3, 3], other[:3, 3]) + math.acos(min(max(cosine, -1.0), 1.0))


def _make_view(
    sample_m: np.ndarray,
    stride: tuple[int, int],
    camera: CameraModel,
    T_map_camera: np.ndarray,
    floor_m: float,
) -> _View:
    """Return the view of the sampled pixels, as points in `map` without the floor."""
    (v, u), z = stride, sample_m
    row = (v // 2 + v * np.arange(z.shape[0]) - camera.cy_px) / camera.fy_px
    column = (u // 2 + u * np.arange(z.shape[1]) - camera.cx_px) / camera.fx_px
    at = np.nonzero((z > 0.0) & (z < FARTHEST_M))
    z = z[at].astype(np.float64)
    points_m = np.column_stack((column[at[1]] * z, row[at[0]] * z, z))
    points_m = points_m @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
    above = points_m[:, 2] - floor_m > _FLOOR_M
    return _View(T_map_camera, points_m[above], sample_m.copy())


def _misplaced_share(
    view: _View,
    depth_m: np.ndarray,
    stride: tuple[int, int],
    camera: CameraModel,
    T_map_camera: np.ndarray,
) -> float:
    """Return the share of a view's points that the new image shows in the wrong place.

    It is the second lowest share of the strips (the lowest of four or five); NaN if too few strips
    have informative points.
    """
    height, width = depth_m.shape
    points = (view.points_m - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
    points = points[points[:, 2] > 0.1]
    expected = points[:, 2]
    u = np.rint(points[:, 0] / expected * camera.fx_px + camera.cx_px)
    v = np.rint(points[:, 1] / expected * camera.fy_px + camera.cy_px)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    expected, u, v = expected[inside], u[inside].astype(np.int64), v[inside].astype(np.int64)
    measured = depth_m[v, u]
    rows, columns = view.sample_m.shape
    before = view.sample_m[
        np.minimum(v // stride[0], rows - 1), np.minimum(u // stride[1], columns - 1)
    ]
    # The change that the motion predicts, and the noise of a depth camera: 3 cm + 2 %.
    change, noise = np.abs(expected - before), 0.03 + 0.02 * expected
    informative = (measured > 0.0) & (before > 0.0) & (change > 2.0 * noise)
    wrong = informative & (np.abs(measured - expected) > 0.5 * change + noise)
    strip = u * _STRIPS // width
    number = np.bincount(strip[informative], minlength=_STRIPS)
    share = np.bincount(strip[wrong], minlength=_STRIPS) / np.maximum(number, 1)
    share = np.sort(share[number >= _MIN_POINTS])
    return math.nan if len(share) < _MIN_STRIPS else float(share[(len(share) - 1) // 5])
