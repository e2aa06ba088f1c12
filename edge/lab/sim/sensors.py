"""Sensors of the simulated robot, and their data as messages of the bus.

`edge.lab.sim.process` sends the messages; evaluation reads the sensors directly.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Union

import numpy as np

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import messages
from edge.config import Config
from edge.geometry import SE2
from edge.lab.sim.base import LidarRays, World, WorldError
from edge.lab.sim.robot import MotionState
from edge.types import Observation

CAMERA_FRAMES, LIDAR_FRAME = ("camera_optical", "camera2_optical"), "lidar"
"""Frame ids in the messages."""
_TOPICS = (
    (topics.DEPTH, topics.SEGMENTATION, topics.RGB, topics.CAMERA_INFO),
    (topics.DEPTH2, topics.SEGMENTATION2, topics.RGB2, topics.CAMERA_INFO2),
)
Message = tuple[Topic, bytes]
"""Topic and encoded payload."""


def _check_above_floor(config: Config, key: str, z_m: float) -> None:
    """Raise WorldError for a sensor in or below the floor, on which the robot's base is."""
    if z_m <= 0.0:
        raise WorldError(
            f"{config.locate(key)}: got {z_m:g} m, but the simulated robot's base is on the "
            "floor, and a sensor must be above it; set a value above 0"
        )


class CameraRig:
    """Camera for colour, depth and object ids; its buffers are reused for every image.

    Attributes:
        index: which camera of the robot; see `Observation.camera_index`.
        T_base_camera: (4, 4) pose of the camera on the robot.
        rgb: (h, w, 3) uint8, the last image. Without colour it is None, in half the time.
        depth_m: (h, w) float32 z-depth of the last image, NaN for nothing.
        ids: (h, w) uint16, object ids in the last image, 0 for structure.
        rate_hz: images per second.
    """

    def __init__(self, config: Config, world: World, colour: bool = True, index: int = 0) -> None:
        camera, self._world = config.sensors.cameras[index], world
        self.index, self._topics = index, _TOPICS[index]
        key = ("camera", "second_camera")[index]
        _check_above_floor(config, f"sensors.{key}.z_m", camera.z_m)
        self.model = camera.intrinsics()
        self.T_base_camera = camera.T_base_camera()
        shape = (camera.height_px, camera.width_px)
        self.rgb = np.empty((*shape, 3), np.uint8) if colour else None
        self.depth_m = np.empty(shape, np.float32)
        self.ids = np.empty(shape, np.uint16)
        self.rate_hz = camera.rate_hz
        self._depth_noise = config.sim.depth_noise
        self._rng = np.random.default_rng(
            [config.sim.seed, 1, index] if index else [config.sim.seed, 1]
        )

    def look(self, pose: SE2) -> None:
        """Take an image from a robot pose: fill `rgb`, `depth_m` and `ids`.

        The noise of the depth grows with its square.
        """
        T_map_camera = pose.matrix() @ self.T_base_camera
        self._world.render(self.model, T_map_camera, self.rgb, self.depth_m, self.ids)
        if self._depth_noise > 0.0:
            noise = self._rng.standard_normal(self.depth_m.shape, np.float32)
            self.depth_m += self._depth_noise * noise * self.depth_m * self.depth_m

    def observation(
        self, seq: int, stamp_ns: int, T_map_base: np.ndarray, lidar: LidarRig | None = None
    ) -> Observation:
        """Return the last image as an observation, with the last scan of a LiDAR."""
        scan = {} if lidar is None else {
            "cloud_m": lidar.cloud_m(), "T_base_lidar": lidar.T_base_lidar,
        }  # fmt: skip
        return Observation(
            seq, stamp_ns, T_map_base, rgb=self.rgb, depth_m=self.depth_m, camera=self.model,
            T_base_camera=self.T_base_camera, camera_index=self.index, **scan,
        )  # fmt: skip

    def messages(self, stamp_ns: int) -> Iterator[Message]:
        """Yield the last image as messages; colour comes last, since it completes the frame."""
        assert self.rgb is not None, "a camera without colour sends nothing"
        depth_mm = np.nan_to_num(self.depth_m * 1000.0, nan=0.0).clip(0, 65535).astype(np.uint16)
        for topic, image in zip(self._topics, (depth_mm, self.ids, self.rgb), strict=False):
            yield topic, messages.encode_image(stamp_ns, CAMERA_FRAMES[self.index], image)

    def description(self, stamp_ns: int) -> Iterator[Message]:
        """Yield the intrinsics, and the label of each object id (id 1 first)."""
        frame = CAMERA_FRAMES[self.index]
        yield self._topics[-1], messages.encode_camera_info(stamp_ns, frame, self.model)
        labels = [item.label for item in self._world.objects]
        yield topics.LABELS, json.dumps(labels).encode()


class CameraPair:
    """Two cameras that take images in turn.

    Attributes:
        rate_hz: images per second of both.
    """

    def __init__(self, cameras: list[CameraRig]) -> None:
        self._cameras, self._current = cameras, cameras[-1]
        self.rate_hz = sum(camera.rate_hz for camera in cameras)

    def look(self, pose: SE2) -> None:
        """Take an image with the other camera; see `CameraRig.look`."""
        self._current = self._cameras[self._current.index - 1]
        self._current.look(pose)

    def messages(self, stamp_ns: int) -> Iterator[Message]:
        """Yield the last image as messages."""
        return self._current.messages(stamp_ns)

    def description(self, stamp_ns: int) -> Iterator[Message]:
        """Yield the intrinsics of both cameras, and the labels."""
        for camera in self._cameras:
            yield from camera.description(stamp_ns)


class LidarRig:
    """Rotating LiDAR; it sends a scan if it has one ring, else a point cloud.

    Attributes:
        rate_hz: sweeps per second.
        T_base_lidar: (4, 4) pose of the LiDAR on the robot.
        ranges_m: (rings, columns) float32 of the last sweep, NaN for no return.
    """

    def __init__(self, config: Config, world: World) -> None:
        lidar = config.sensors.lidar
        assert lidar is not None
        _check_above_floor(config, "sensors.lidar.z_m", lidar.z_m)
        self._world, self._fan, self._noise_m = world, LidarRays.of(lidar), lidar.noise_m
        self.rate_hz = lidar.rate_hz
        self.T_base_lidar = lidar.T_base_mount()
        self.ranges_m = np.empty(self._fan.directions.shape[:2], np.float32)
        self._rng = np.random.default_rng([config.sim.seed, 2])

    def look(self, pose: SE2) -> None:
        """Take a sweep from a robot pose: fill `ranges_m`."""
        self._world.cast(self._fan, pose.matrix() @ self.T_base_lidar, self.ranges_m)
        if self._noise_m > 0.0:
            noise = self._rng.standard_normal(self.ranges_m.shape, np.float32)
            self.ranges_m += self._noise_m * noise

    def cloud_m(self) -> np.ndarray:
        """Return (n, 3) float32 points of the last sweep in the LiDAR's frame."""
        hit = np.isfinite(self.ranges_m)
        return (self._fan.directions[hit] * self.ranges_m[hit][:, None]).astype(np.float32)

    def messages(self, stamp_ns: int) -> Iterator[Message]:
        """Yield the last sweep as a message."""
        rings, columns = self.ranges_m.shape
        if rings > 1:
            cloud = messages.encode_point_cloud(stamp_ns, LIDAR_FRAME, self.cloud_m())
            yield topics.CLOUD, cloud
            return
        ranges = np.where(np.isfinite(self.ranges_m[0]), self.ranges_m[0], np.inf)
        # First angle, step between the rays, and longest range.
        geometry = (-math.pi, 2 * math.pi / columns, self._fan.range_m)
        ranges = ranges.astype(np.float32)
        scan = messages.encode_laser_scan(stamp_ns, LIDAR_FRAME, *geometry, ranges)
        yield topics.SCAN, scan

    def description(self, stamp_ns: int) -> Iterator[Message]:
        """Return no messages: LiDAR data needs no description."""
        return iter(())


Rig = Union[CameraRig, CameraPair, LidarRig]


def make_rigs(config: Config, world: World) -> list[Rig]:
    """Return the configured sensors; the camera comes last, since it completes the frame."""
    lidar = [] if config.sensors.lidar is None else [LidarRig(config, world)]
    cameras = [CameraRig(config, world, index=i) for i in range(len(config.sensors.cameras))]
    return [*lidar, cameras[0] if len(cameras) == 1 else CameraPair(cameras)]


def odometry_message(motion: MotionState) -> Message:
    """Return the pose by odometry as a message."""
    T_map_base = motion.odometry.matrix()
    payload = messages.encode_odometry(motion.stamp_ns, T_map_base, motion.v_mps, motion.w_radps)
    return topics.ODOMETRY, payload


def truth_message(motion: MotionState) -> Message:
    """Return the true pose and the collisions as a message."""
    truth = {
        "stamp_ns": motion.stamp_ns,
        "pose": [motion.pose.x_m, motion.pose.y_m, motion.pose.yaw_rad],
        "v_mps": motion.v_mps,
        "w_radps": motion.w_radps,
        "collisions": motion.collisions,
        "bumped": motion.bumped,
        "path_m": motion.path_m,
        "person_contacts": motion.person_contacts,
    }
    return topics.GROUND_TRUTH, json.dumps(truth).encode()
