"""Joins camera, depth, cloud and odometry messages into Observations; knows no transport.

One sensor leads (`mapping.input`): every depth image or every cloud is one observation. The others
are joined to it by stamp. It waits for them, and for an odometry sample at or after its stamp, at
most `PATIENCE_NS`; then the newest odometry within `source.max_pose_gap_s` serves, and a frame
that still has no pose, or lacks a sensor it must have, is dropped and counted. In lockstep it waits
for ever, so that a run replays the same. Of several complete observations the newest wins.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

import numpy as np

from edge.config import Config, ConfigError
from edge.geometry import CameraModel
from edge.sources.inputs import InputTable
from edge.sources.messages import (
    CameraInfo,
    Cloud,
    DepthImage,
    Frame,
    Image,
    Message,
    Mount,
    Odometry,
    WrongSizeError,
)
from edge.sources.odometry import OdometryRing
from edge.sources.pool import FramePool, PoolSlot
from edge.sources.streams import Stream
from edge.text import one_line
from edge.types import Observation

log = logging.getLogger("edge.sources")

PATIENCE_NS = 50_000_000
_POSES_APART_NS = 1_000_000
_NAMES = {kind.field: kind.topic for kind in (Image, DepthImage, Cloud)}

REASONS = (
    "malformed", "oversized", "empty", "wrong_size", "repeated", "backward", "stale", "superseded",
    "unpaired", "no_pose", "no_camera_info", "no_transform", "pool_exhausted", "pose_jump",
    "clock_reset", "overrun",
)  # fmt: skip


def streams_of(config: Config) -> dict[str, Stream]:
    """The sensors that this configuration listens to, by field, the leading one first.

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """
    perception, lidar = config.perception, config.sensors.lidar
    cloud_leads = config.mapping.input == "cloud"
    if lidar is None and (cloud_leads or perception.lift == "cloud"):
        key = "mapping.input" if cloud_leads else "perception.lift"
        raise ConfigError(f"{config.at(key)}: cloud needs sensors.lidar (where it is mounted)")
    must = config.loop.lockstep or not cloud_leads
    half_frame_ns = int(0.5e9 / config.sensors.camera.rate_hz)
    streams = {}
    if cloud_leads or perception.lift == "cloud":
        period_ns = int(1e9 / lidar.rate_hz)
        streams["cloud_m"] = Stream(period_ns, required=cloud_leads or config.loop.lockstep)
    # The simulator's detector tells how far things are from the depth image.
    if not cloud_leads or perception.lift == "depth" or perception.detector.kind == "sim":
        streams["depth_m"] = Stream(half_frame_ns, required=must)
    streams["rgb"] = Stream(half_frame_ns, required=must)
    leader = "cloud_m" if cloud_leads else "depth_m"
    return {leader: streams.pop(leader), **streams}


def _apart(leader: Frame, name: str, nearest_ns: int | None) -> str:
    if nearest_ns is None:
        return f"no {name}"
    ms = (nearest_ns - leader.stamp_ns) / 1e6
    return f"the nearest {name} is {abs(ms):.0f} ms {'later' if ms > 0 else 'earlier'}"


class TimeSynchronizer:
    """See the module. For one thread.

    Attributes:
        counters: `received` messages (counted by who hands them in), `observations` given out, and
            drops by reason (`REASONS`).
        inputs: the same for each input by itself, and how often and when it came.
    """

    def __init__(self, config: Config, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.config = config
        self.odometry = OdometryRing(
            config.source.odometry_ring,
            config.source.max_pose_gap_s,
            config.source.max_pose_jump_m,
            config.robot.max_speed_mps,
            config.robot.max_turn_radps,
            _POSES_APART_NS,
        )
        self.counters: dict[str, int] = dict.fromkeys(("received", "observations", *REASONS), 0)
        self.streams = streams_of(config)
        self._leader, *self._others = self.streams
        self._clock = clock
        self.inputs = InputTable(config, self.streams, clock)
        self._patience_ns = math.inf if config.loop.lockstep else PATIENCE_NS
        self._camera: CameraModel | None = None
        self._pool: FramePool | None = None
        self._seq = 0
        self._told: set[tuple[str, str]] = set()
        camera, lidar = config.sensors.camera, config.sensors.lidar
        self._T_base_camera = camera.T_base_camera()
        self._T_base_lidar = np.eye(4) if lidar is None else lidar.T_base_mount()

    def received(self, topic: str) -> None:
        """Count a message, before it is decoded and offered."""
        self.counters["received"] += 1
        self.inputs.came(topic)

    def count(self, topic: str, reason: str, detail: object = "") -> None:
        """Count a drop; the first of its kind is also told."""
        self.counters[reason] += 1
        detail = one_line(detail)
        self.inputs.dropped(topic, reason, detail)
        if reason != "superseded" and (topic, reason) not in self._told:
            self._told.add((topic, reason))
            said = f"({detail}) " if detail else ""
            log.warning("%s: dropped: %s %s(further ones are only counted)", topic, reason, said)

    # -- messages in --------------------------------------------------------------------------

    def offer(self, message: Message) -> None:
        """Take one message; frames of sensors that nobody asked for are left out."""
        reason = ""
        if isinstance(message, Odometry):
            reason = self.odometry.push(message.stamp_ns, message.T_map_base)
            if reason not in ("repeated", "backward"):
                self.inputs.used(message.topic)
        elif isinstance(message, CameraInfo):
            self._describe(message)
        elif isinstance(message, Mount):
            self._mount(message)
            return
        elif (stream := self.streams.get(message.field)) is not None:
            reason = stream.offer(message)
            if reason == "superseded" and message.field != self._leader:
                return
        if reason:
            self.count(message.topic, reason)

    def _mount(self, message: Mount) -> None:
        """Those that were given out keep the array that they have: it is never written to."""
        if message.field == Cloud.field:
            self._T_base_lidar = message.T_base_sensor
        else:
            self._T_base_camera = message.T_base_sensor

    def _describe(self, message: CameraInfo) -> None:
        camera = message.camera
        if camera == self._camera:
            self.inputs.used(message.topic)
            return
        size = camera.width_px * camera.height_px * 3
        if size > self.config.source.max_message_mb * 1e6:
            detail = f"{camera.width_px}x{camera.height_px} px"
            self.count(message.topic, "oversized", detail)
            return
        self._camera, self._pool = camera, None
        self.inputs.used(message.topic)

    # -- observations out ---------------------------------------------------------------------

    def poll(self) -> Observation | None:
        """The newest complete observation, held once for the caller; older ones are dropped."""
        leading = self.streams[self._leader]
        now_ns = self._clock()
        for frame in leading.newest_first():
            joined, T_map_base, reason = self._join(frame, now_ns)
            if reason == "wait":
                continue
            leading.drop(frame)  # at once: one that cannot be decoded must not come up again
            if T_map_base is None:
                self.count(frame.topic, reason, self._why(frame, reason))
                continue
            observation = self._observe(frame, joined, T_map_base)
            if observation is None:
                continue
            self.counters["superseded"] += leading.drop_through(frame.stamp_ns)
            self.counters["observations"] += 1
            return observation
        return None

    def _join(self, leader: Frame, now_ns: int) -> tuple[list[Frame], np.ndarray | None, str]:
        """(frames that belong to the leader, its pose, why there is none; `wait` = not yet)."""
        waited = now_ns - leader.arrived_ns > self._patience_ns
        joined = []
        for field in self._others:
            stream = self.streams[field]
            match = stream.near(leader.stamp_ns)
            if match is not None:
                joined.append(match)
            elif not (waited or stream.is_past(leader.stamp_ns)):
                return [], None, "wait"
            elif stream.required:
                return [], None, "unpaired"
        T_map_base, missing = self.odometry.pose_at(leader.stamp_ns)
        if missing in ("empty", "too_new"):
            if not waited:
                return [], None, "wait"
            T_map_base = self.odometry.latest(leader.stamp_ns)
        reason = "" if T_map_base is not None else "stale" if missing == "too_old" else "no_pose"
        return joined, T_map_base, reason

    def _why(self, leader: Frame, reason: str) -> str:
        """Say which input lacks a message for this frame, and how far its nearest one is."""
        if reason != "unpaired":
            return _apart(leader, Odometry.topic, self.odometry.newest_ns)
        required = (field for field in self._others if self.streams[field].required)
        return self._apart(
            leader, next(f for f in required if self.streams[f].near(leader.stamp_ns) is None)
        )

    def _apart(self, leader: Frame, field: str) -> str:
        nearest = self.streams[field].nearest(leader.stamp_ns)
        if nearest is None:
            return _apart(leader, _NAMES[field], None)
        return _apart(leader, nearest.topic, nearest.stamp_ns)

    def _observe(
        self, leader: Frame, joined: list[Frame], T_map_base: np.ndarray
    ) -> Observation | None:
        """Decode into a slot of the pool; None (and counted) where that fails."""
        frames = [leader, *joined]
        if self._camera is None and not all(isinstance(frame, Cloud) for frame in frames):
            self.count(leader.topic, "no_camera_info")
            if not isinstance(leader, Cloud):
                return None
            frames = [leader]
        slot = self._acquire()
        if slot is None:
            self.count(leader.topic, "pool_exhausted")
            return None
        fields = None
        try:
            fields = self._fields(frames, slot)
        finally:
            if fields is None:
                slot.release()
        if fields is None:
            return None
        self._seq += 1
        for frame in frames:
            if frame.field in fields:
                self.inputs.used(frame.topic)
        for field in self._others:
            if field not in fields:  # an observation is one without it, too
                self.inputs.unpaired(field, self._apart(leader, field))
        return Observation(
            seq=self._seq - 1,
            stamp_ns=leader.stamp_ns,
            T_map_base=T_map_base,
            camera=self._camera if fields.keys() - {"cloud_m"} else None,
            T_base_camera=self._T_base_camera,
            T_base_lidar=self._T_base_lidar,
            slot=slot,
            lag_ns=self._lag_ns(leader),
            **fields,
        )

    def _lag_ns(self, leader: Frame) -> int:
        """Return how much newer the newest pose is; 0 in lockstep, which has no real time."""
        if self.config.loop.lockstep:
            return 0
        return max(self.odometry.newest_ns - leader.stamp_ns, 0)

    def _fields(self, frames: list[Frame], slot: PoolSlot) -> dict[str, np.ndarray] | None:
        """The observation's arrays by name; None (and counted) where one is missing.

        Args:
            frames: the leading one first.
        """
        fields: dict[str, np.ndarray] = {}
        for frame in frames:
            array = self._decode(frame, slot)
            if array is not None:
                fields[frame.field] = array
            elif frame is frames[0] or self.streams[frame.field].required:
                return None
        return fields

    def _acquire(self) -> PoolSlot | None:
        if self._pool is None:
            camera = self._camera
            self._pool = FramePool(
                self.config.source.pool_slots,
                image_hw=(camera.height_px, camera.width_px) if camera is not None else None,
                cloud_points=(
                    self.config.source.max_cloud_points if "cloud_m" in self.streams else 0
                ),
                depth="depth_m" in self.streams,
            )
        return self._pool.acquire()

    def _decode(self, frame: Frame, slot: PoolSlot) -> np.ndarray | None:
        """A frame's array, in its place in the slot; None (and counted) where that fails."""
        out = getattr(slot, frame.field)
        try:
            n = frame.into(out)
        except ValueError as error:
            reason = "wrong_size" if isinstance(error, WrongSizeError) else "malformed"
            self.count(frame.topic, reason, error)
            return None
        if n == 0:
            self.count(frame.topic, "empty")
            return None
        return out[:n] if isinstance(frame, Cloud) else out
