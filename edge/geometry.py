"""Rigid transforms, the pinhole camera, image boxes and grids.

Frames follow REP-103/105: `map` and `base` have x forward, y left, z up. The camera's
*optical* frame has z forward, x right, y down. `T_a_b` maps points of frame b into frame a.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

FARTHEST_M = 1e6
"""The map ignores sensors and points beyond this coordinate. One float32 step is 6 cm there."""

# Columns are the optical axes seen from a body frame (x forward, y left, z up).
R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

# Limits of a pinhole camera; the first three are in units of the longer image side.
MIN_FOCAL = 0.01  # focal length with a field of view of 178.9 degrees
MAX_FOCAL = 100.0  # focal length with a field of view of 0.6 degrees
MAX_ASIDE = 10.0  # distance of the principal point from the centre; large if the image is a crop
MAX_SIDE_PX = 1 << 16  # width and height


def wrap_angle(angle_rad: float) -> float:
    """Return the same angle in [-pi, pi).

    >>> round(wrap_angle(3 * math.pi / 2), 3)
    -1.571
    """
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class SE2:
    """A planar pose: x and y in metres, yaw counter-clockwise in radians.

    Example:
        >>> pose = SE2(1.0, 2.0, math.pi / 2)
        >>> [round(v, 3) for v in pose.ahead(0.5)]
        [1.0, 2.5]
        >>> round(pose.bearing_to(0.0, 2.0), 3)  # a point to the left
        1.571
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def matrix(self, z_m: float = 0.0) -> np.ndarray:
        """Return the pose as a (4, 4) float64 transform at height `z_m`."""
        return se3(self.x_m, self.y_m, z_m, yaw_rad=self.yaw_rad)

    def distance_to(self, x_m: float, y_m: float) -> float:
        """Return the distance to a point, in metres."""
        return math.hypot(x_m - self.x_m, y_m - self.y_m)

    def ahead(self, distance_m: float) -> tuple[float, float]:
        """Return the point (x, y) at this distance ahead, or behind if the distance is negative."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + distance_m * c, self.y_m + distance_m * s

    def bearing_to(self, x_m: float, y_m: float) -> float:
        """Return the angle from the heading to a point, left positive, in [-pi, pi).

        Source: VL-Nav eq. 2.
        """
        return wrap_angle(math.atan2(y_m - self.y_m, x_m - self.x_m) - self.yaw_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A grid of square cells over part of `map`; row = y, column = x.

    Attributes:
        cells: (h, w) of any type. An occupancy grid is int8: -1 unknown, 0 free, 100 occupied.
            1 to 99 are inflated cells: free, but too near to an obstacle for the robot. Not every
            grid marks them.
        origin_xy_m: Corner of cell (0, 0) with the smallest x and y.
        resolution_m: Side of a cell.

    Example:
        >>> grid = Grid(np.zeros((4, 6), np.int8), (-1.0, 0.0), 0.5)
        >>> grid.cell_of(0.1, 0.9)
        (1, 2)
        >>> grid.extent_m
        (-1.0, 2.0, 0.0, 2.0)
    """

    cells: np.ndarray
    origin_xy_m: tuple[float, float]
    resolution_m: float

    def to_cells(self, xy_m: np.ndarray) -> np.ndarray:
        """Convert points (…, 2) from metres to cell units.

        Cell (row r, column c) spans [c, c + 1) x [r, r + 1).
        """
        return (np.asarray(xy_m, np.float64) - self.origin_xy_m) / self.resolution_m

    def to_metres(self, xy: np.ndarray) -> np.ndarray:
        """Convert points (…, 2) from cell units to metres, the inverse of `to_cells`."""
        return np.asarray(xy) * self.resolution_m + np.asarray(self.origin_xy_m)

    def centres_m(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the cell centres, (…, 2)."""
        return self.to_metres(np.stack([columns, rows], axis=-1) + 0.5)

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int] | None:
        """Return (row, column) of a point, or None outside the grid."""
        x = (x_m - self.origin_xy_m[0]) / self.resolution_m
        y = (y_m - self.origin_xy_m[1]) / self.resolution_m
        if not (0 <= x < self.cells.shape[1] and 0 <= y < self.cells.shape[0]):
            return None  # also for NaN
        return int(y), int(x)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max)."""
        (h, w), (x_m, y_m) = self.cells.shape, self.origin_xy_m
        return x_m, x_m + w * self.resolution_m, y_m, y_m + h * self.resolution_m

    @property
    def known_m2(self) -> float:
        """Area of the known cells in m²."""
        return float(np.count_nonzero(self.cells >= 0)) * self.resolution_m**2


def downsample(grid: Grid, max_side: int) -> Grid:
    """Merge blocks of k x k cells of an occupancy grid; the largest value of a block wins.

    So occupied wins over free, and free over unknown. k is the smallest factor that keeps both
    sides within `max_side` cells.
    """
    h, w = grid.cells.shape
    k = max(1, -(-max(h, w) // max_side))  # `-(-a // b)` rounds up
    if k == 1:
        return grid
    padded = np.full((-(-h // k) * k, -(-w // k) * k), -1, dtype=np.int8)
    padded[:h, :w] = grid.cells
    blocks = padded.reshape(padded.shape[0] // k, k, padded.shape[1] // k, k)
    return Grid(blocks.max(axis=(1, 3)), grid.origin_xy_m, k * grid.resolution_m)


def se2_of(T: np.ndarray) -> SE2:
    """Return the planar part of a (4, 4) transform."""
    return SE2(float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0]))


def se3(
    x_m: float = 0.0,
    y_m: float = 0.0,
    z_m: float = 0.0,
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    yaw_rad: float = 0.0,
) -> np.ndarray:
    """Return a (4, 4) float64 transform from a translation and fixed-axis roll, pitch, yaw.

    Positive pitch turns the nose down (rotation about +y).
    """
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x_m],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y_m],
            [-sp, cp * sr, cp * cr, z_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def se3_from_quaternion(
    position_m: tuple[float, float, float], quaternion_xyzw: tuple[float, float, float, float]
) -> np.ndarray:
    """Return a (4, 4) float64 transform from a position and a quaternion, which is normalised.

    Raises:
        ValueError: The length of the quaternion is zero or not finite.
    """
    # Plain floats take a fifth of the time of arrays. This runs for every odometry sample.
    x, y, z, w = (float(component) for component in quaternion_xyzw)
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not math.isfinite(norm) or norm < 1e-6:
        raise ValueError(f"not a rotation: quaternion {(x, y, z, w)} is zero or not finite")
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    x_m, y_m, z_m = position_m
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), x_m],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), y_m],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), z_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def quaternion_of(T: np.ndarray) -> tuple[float, float, float, float]:
    """Return the rotation of a (4, 4) transform as a unit quaternion (x, y, z, w), w >= 0."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = T[:3, :3].tolist()
    # The largest of the four squared components keeps the division well conditioned.
    squares = (1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz)
    k = squares.index(max(squares))
    s = 2.0 * math.sqrt(squares[k])
    if k == 3:
        q = ((zy - yz) / s, (xz - zx) / s, (yx - xy) / s, s / 4)
    elif k == 0:
        q = (s / 4, (xy + yx) / s, (xz + zx) / s, (zy - yz) / s)
    elif k == 1:
        q = ((xy + yx) / s, s / 4, (yz + zy) / s, (xz - zx) / s)
    else:
        q = ((xz + zx) / s, (yz + zy) / s, s / 4, (yx - xy) / s)
    sign = -1.0 if q[3] < 0 else 1.0
    return (sign * q[0], sign * q[1], sign * q[2], sign * q[3])


def invert(T: np.ndarray) -> np.ndarray:
    """Return the inverse of a rigid (4, 4) transform."""
    out = np.eye(4)
    out[:3, :3] = T[:3, :3].T
    out[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return out


def interpolate(T_a: np.ndarray, T_b: np.ndarray, fraction: float) -> np.ndarray:
    """Interpolate between two (4, 4) poses; a `fraction` above 1 extrapolates beyond `T_b`.

    The rotation is interpolated linearly and normalised (nlerp). Between odometry samples, which
    are less than 10 degrees apart, this differs from slerp by less than 1e-4 rad.
    """
    q_a, q_b = quaternion_of(T_a), quaternion_of(T_b)
    dot = sum(a * b for a, b in zip(q_a, q_b, strict=True))
    # q and -q are the same rotation: take the one on the side of q_a.
    f_a, f_b = 1.0 - fraction, fraction if dot >= 0.0 else -fraction
    x, y, z, w = (f_a * a + f_b * b for a, b in zip(q_a, q_b, strict=True))
    t = (1.0 - fraction) * T_a[:3, 3] + fraction * T_b[:3, 3]
    return se3_from_quaternion(tuple(t.tolist()), (x, y, z, w))


@dataclass(frozen=True, slots=True)
class CameraModel:
    """An undistorted pinhole camera; pixel centres are at integer coordinates.

    Code that computes strides or rays from a camera need not check the numbers again.

    Attributes:
        width_px: Width of the image.
        height_px: Height of the image.
        fx_px: Focal length in x.
        fy_px: Focal length in y.
        cx_px: Column of the principal point.
        cy_px: Row of the principal point.

    Raises:
        ValueError: The numbers are outside the limits (`MIN_FOCAL`, `MAX_FOCAL`, `MAX_ASIDE`,
            `MAX_SIDE_PX`).

    Example:
        >>> camera = CameraModel.from_hfov(640, 480, math.pi / 2)
        >>> round(camera.fx_px), round(camera.hfov_rad, 3)
        (320, 1.571)
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    def __post_init__(self) -> None:
        width, height, fx, fy = self.width_px, self.height_px, self.fx_px, self.fy_px
        side = max(width, height)
        offsets_px = (self.cx_px - 0.5 * width, self.cy_px - 0.5 * height)
        # The comparisons are written so that NaN fails.
        if not 0 < min(width, height) <= side <= MAX_SIDE_PX:
            raise ValueError(
                f"not a camera: {width}x{height} px, expected 1 to {MAX_SIDE_PX} a side"
            )
        if not all(MIN_FOCAL * side <= f <= MAX_FOCAL * side for f in (fx, fy)):
            raise ValueError(
                f"not a camera: focal lengths {fx:g}, {fy:g} px at {width}x{height}, "
                f"expected {MIN_FOCAL * side:g} to {MAX_FOCAL * side:g}"
            )
        if not all(abs(off) <= MAX_ASIDE * side for off in offsets_px):
            raise ValueError(
                f"not a camera: principal point ({self.cx_px:g}, {self.cy_px:g}) px is over "
                f"{MAX_ASIDE * side:g} px from the centre of the image of {width}x{height}"
            )

    @classmethod
    def from_hfov(cls, width_px: int, height_px: int, hfov_rad: float) -> CameraModel:
        """Return a camera with square pixels and the principal point at the image centre."""
        f = 0.5 * width_px / math.tan(0.5 * hfov_rad)
        return cls(width_px, height_px, f, f, 0.5 * (width_px - 1), 0.5 * (height_px - 1))

    @property
    def hfov_rad(self) -> float:
        """Horizontal field of view."""
        return 2.0 * math.atan(0.5 * self.width_px / self.fx_px)

    def bearing_of(self, u_px: np.ndarray | float) -> np.ndarray:
        """Return the angle of image columns from the optical axis, left positive.

        The result is float64 in radians, with the shape of `u_px`.
        """
        return np.arctan2(np.subtract(self.cx_px, u_px, dtype=np.float64), self.fx_px)


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens with distortion.

    Attributes:
        model: `plumb_bob`, `rational_polynomial`, `equidistant`, or an unknown model.
        coefficients: Coefficients of the model, ordered as in sensor_msgs/CameraInfo. At least one
            is not zero.
        camera: The pinhole camera of the matrix K.
    """

    model: str
    coefficients: tuple[float, ...]
    camera: CameraModel

    def __str__(self) -> str:
        return f"{self.model} distortion, k1 = {self.coefficients[0]:g}"


def to_optical(T: np.ndarray) -> np.ndarray:
    """Return the same (4, 4) pose with optical axes instead of body axes."""
    T = T.copy()
    T[:3, :3] = T[:3, :3] @ R_BODY_OPTICAL
    return T


def optical_yaw_rad(T: np.ndarray) -> float:
    """Return the yaw of the viewing direction of a camera at the (4, 4) optical pose `T`."""
    return math.atan2(T[1, 2], T[0, 2])


def overlaps(a_xyxy: np.ndarray, b_xyxy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how much the boxes of two sets overlap.

    Args:
        a_xyxy: (n, 4), the first boxes.
        b_xyxy: (m, 4), the second boxes.

    Returns:
        Two (n, m) arrays: intersection over union, and intersection over the area of the first
        box. A ratio is 0 if its divisor is 0.
    """
    low = np.maximum(a_xyxy[:, None, :2], b_xyxy[None, :, :2])
    high = np.minimum(a_xyxy[:, None, 2:], b_xyxy[None, :, 2:])
    both = np.clip(high - low, 0, None).prod(axis=2, dtype=float)
    a, b = _area(a_xyxy)[:, None], _area(b_xyxy)[None]
    union = a + b - both
    iou = np.divide(both, union, out=np.zeros_like(both), where=union > 0)
    share = np.divide(both, a, out=np.zeros_like(both), where=a > 0)
    return iou, share


def _area(xyxy: np.ndarray) -> np.ndarray:
    return np.clip(xyxy[:, 2:] - xyxy[:, :2], 0, None).prod(axis=1, dtype=float)
