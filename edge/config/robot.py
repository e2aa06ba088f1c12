"""The sections of the robot, its sensors, and the reference controller."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from edge.config.section import NonNegative, Positive, Section
from edge.geometry import CameraModel, se3, to_optical


class RobotConfig(Section):
    """The robot's size and limits.

    Attributes:
        name: name for people; null: the last word of `zenoh.prefix`, as in `edge fleet`.
        radius_m: radius of the footprint. Default of `mapping.inflation_m`.
        height_m: height of the robot. Sets the default of `mapping.obstacle_max_m`.
        max_speed_mps: highest speed.
        max_turn_radps: highest turn rate.
        max_accel_mps2: highest acceleration.
        max_turn_accel_radps2: highest acceleration of the turn.
        self_filter_m: points within this distance of the vertical axis of the base are the robot
            itself (posts, a gripper) and are ignored. null: `radius_m`. 0: none is ignored.
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
    def _default_to_radius(cls, value: float | None, info: ValidationInfo) -> float | None:
        return info.data.get("radius_m") if value is None else value


class SensorMount(Section):
    """Pose of a sensor in the robot's base frame.

    Attributes:
        x_m: forward.
        y_m: to the left.
        z_m: up; negative if the base frame is above the sensor.
        roll_deg: rotation about x; it is applied first.
        pitch_deg: rotation about y, applied second; positive: the sensor looks down.
        yaw_deg: rotation about z, applied last; positive: the sensor looks to the left.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.5
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def T_base_mount(self) -> np.ndarray:
        """Return the pose, (4, 4) float64; x points where the sensor looks, z up."""
        angles_deg = self.roll_deg, self.pitch_deg, self.yaw_deg
        return se3(self.x_m, self.y_m, self.z_m, *map(math.radians, angles_deg))


class Camera(SensorMount):
    """A camera on the robot.

    The intrinsics are for the simulator; a real camera sends its own. The mount is as for a LiDAR:
    `x_m`, `y_m`, `z_m` in the base frame, then roll, pitch and yaw.

    Attributes:
        width_px: width of the image.
        height_px: height of the image.
        hfov_deg: horizontal field of view.
        rate_hz: images per second.
        depth_min_m: the simulated camera measures no nearer depth.
        depth_max_m: depth from here on is no measurement. If `mapping.range_m` or
            `perception.back_projection_max_range_m` is larger, that one is the limit.
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
    def _check_camera(self) -> Camera:
        if self.depth_min_m >= self.depth_max_m:
            raise ValueError(
                f"depth_min_m {self.depth_min_m:g}: must be below depth_max_m {self.depth_max_m:g}"
            )
        try:
            self.intrinsics()
        except ValueError as error:
            raise ValueError(
                f"hfov_deg {self.hfov_deg:g} at width_px {self.width_px}, height_px "
                f"{self.height_px}: {error}; set a smaller hfov_deg, or a wider image"
            ) from None
        return self

    def intrinsics(self) -> CameraModel:
        """Return the camera of the simulator: square pixels, principal point in the middle."""
        return CameraModel.from_hfov(self.width_px, self.height_px, math.radians(self.hfov_deg))

    def T_base_camera(self) -> np.ndarray:
        """Return the pose of the optical frame in the base frame, (4, 4) float64."""
        return to_optical(self.T_base_mount())


class Lidar(SensorMount):
    """A 2-D or 3-D LiDAR on the robot.

    Attributes:
        rings: number of scan lines; 1: a 2-D LiDAR.
        columns: measurements of a scan line in one turn.
        vfov_deg: vertical field of view.
        rate_hz: scans per second.
        noise_m: standard deviation of the simulated ranges.
    """

    rings: Annotated[int, Field(ge=1, le=256)] = 16
    columns: Annotated[int, Field(ge=16, le=4096)] = 720
    vfov_deg: Annotated[float, Field(gt=0, le=170)] = 60.0
    rate_hz: Positive = 10.0
    range_m: Positive = 20.0
    noise_m: NonNegative = 0.01


class SensorsConfig(Section):
    """The robot's sensors.

    Attributes:
        camera: the camera, colour and depth.
        second_camera: another camera, such as one that looks back; null: none.
        lidar: the LiDAR; null: none.
        odometry_hz: rate of the odometry.
    """

    camera: Camera = Camera()
    second_camera: Camera | None = None
    lidar: Lidar | None = None
    odometry_hz: Positive = 60.0

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras; an observation has the index of its camera here."""
        return (self.camera,) if self.second_camera is None else (self.camera, self.second_camera)


class MotionConfig(Section):
    """The reference controller: A* on the published map, and pure pursuit.

    Attributes:
        rate_hz: velocity commands per second.
    """

    rate_hz: Positive = 20.0
