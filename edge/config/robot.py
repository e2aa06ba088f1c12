"""The robot: its body, its sensors, and how the reference controller drives it."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from edge.config.section import NonNegative, Positive, Section
from edge.geometry import CameraModel, optical, se3


class Robot(Section):
    """`name` is for people; by default the last word of `zenoh.prefix`, as `edge fleet` has it.

    `radius_m` sets `mapping.inflation_m`, and `height_m` sets `mapping.obstacle_max_m`, where these
    are not set. What sensors see within `self_filter_m` of the axis of the base is the robot itself
    (posts, a gripper): by default `radius_m`; 0: nothing is.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")] | None = None
    radius_m: Positive = 0.2
    height_m: Positive = 0.8
    max_speed_mps: Positive = 0.5
    max_turn_radps: Positive = 1.2
    max_accel_mps2: Positive = 1.0
    max_turn_accel_radps2: Positive = 3.0
    self_filter_m: Annotated[NonNegative | None, Field(validate_default=True)] = None

    @field_validator("self_filter_m")
    @classmethod
    def _as_wide_as_itself(cls, value: float | None, info: ValidationInfo) -> float | None:
        return info.data.get("radius_m") if value is None else value


class Mount(Section):
    """Where a sensor sits on the robot's base: x forward, y left, z up.

    The angles are about these axes, roll first, then pitch (positive: nose down), then yaw
    (positive: to the left). `z_m` is negative if the base frame is above the sensor.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.5
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def T_base_mount(self) -> np.ndarray:
        """(4, 4) float64, with the axes of a body: x where the sensor points, z up."""
        angles_deg = self.roll_deg, self.pitch_deg, self.yaw_deg
        return se3(self.x_m, self.y_m, self.z_m, *map(math.radians, angles_deg))


class Camera(Mount):
    """A camera on the robot; intrinsics serve the simulator, a real one sends its own.

    Depth of `depth_max_m` or more is no return, unless `mapping.range_m` or
    `perception.lift_max_range_m` is larger: then depth from there on is none.
    """

    x_m: float = 0.1
    z_m: float = 0.6
    pitch_deg: float = 5.0
    width_px: Annotated[int, Field(ge=16, le=4096)] = 320
    height_px: Annotated[int, Field(ge=16, le=4096)] = 256
    hfov_deg: Annotated[float, Field(gt=10, lt=150)] = 75.0
    rate_hz: Positive = 30.0
    depth_min_m: NonNegative = 0.1
    depth_max_m: Positive = 8.0

    @model_validator(mode="after")
    def _is_one(self) -> Camera:
        try:
            self.intrinsics()
        except ValueError as error:
            raise ValueError(
                f"hfov_deg {self.hfov_deg:g} at width_px {self.width_px}, height_px "
                f"{self.height_px}: {error}; take a smaller hfov_deg, or a wider image"
            ) from None
        return self

    def intrinsics(self) -> CameraModel:
        """The camera as the simulator has it: square pixels, the principal point in the middle."""
        return CameraModel.from_hfov(self.width_px, self.height_px, math.radians(self.hfov_deg))

    def T_base_camera(self) -> np.ndarray:
        """(4, 4) float64, base from optical frame."""
        return optical(self.T_base_mount())


class Lidar(Mount):
    """A 2D (`rings: 1`) or 3D LiDAR (VL-Nav's is tilted nose down by 23 degrees)."""

    rings: Annotated[int, Field(ge=1, le=256)] = 16
    columns: Annotated[int, Field(ge=16, le=4096)] = 720
    vfov_deg: Annotated[float, Field(gt=0, le=170)] = 60.0
    rate_hz: Positive = 10.0
    range_m: Positive = 20.0
    noise_m: NonNegative = 0.01


class Sensors(Section):
    camera: Camera = Camera()
    lidar: Lidar | None = None
    odometry_hz: Positive = 60.0


class Motion(Section):
    """The reference motion controller: A* on the published map, pure pursuit.

    `clearance_m` is kept from occupied cells on top of the map's own inflation. A robot that does
    not move for `stuck_s` is stuck, whatever it was told.
    """

    rate_hz: Positive = 20.0
    stuck_s: Positive = 4.0
    clearance_m: NonNegative = 0.0
