"""Joins camera, depth, cloud and odometry messages into Observations; knows no transport.

One sensor leads (`mapping.input`): every depth image or every cloud is one observation. The others
are joined to it by stamp. It waits for them, and for an odometry sample at or after its stamp, at
most `PATIENCE_NS`; then the newest odometry within `source.max_pose_gap_s` serves, and a frame
that still has no pose, or lacks a sensor it must have, is dropped and counted. In lockstep it waits
for ever, so that a run replays the same. Of several complete observations the newest wins.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable

import numpy as np

from edge import names
from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError, messages
from edge.config import Config, ConfigError
from edge.geometry import CameraModel, camera_mount, se3
from edge.sources.odometry import OdometryRing
from edge.sources.pool import FramePool, PoolSlot
from edge.sources.streams import Message, Stream
from edge.types import Observation

log = logging.getLogger("edge.sources")

PATIENCE_NS = 50_000_000
_POSES_APART_NS = 1_000_000

REASONS = (
    "malformed", "oversized", "empty", "wrong_size", "repeated", "backward", "stale", "superseded",
    "unpaired", "no_pose", "no_camera_info", "pool_exhausted", "pose_jump", "clock_reset",
    "overrun",
)  # fmt: skip
IMAGES = (topics.RGB, topics.DEPTH, topics.OBJECT_IDS)
# Topics that say the same again and again, and where that begins: behind CDR header and stamp.
_DESCRIPTIONS = {topics.CAMERA_INFO: 12, topics.OBJECT_LABELS: 0}


def streams_of(config: Config) -> dict[Topic, Stream]:
    """The sensors that this configuration listens to, the leading one first.

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """
    perception, lidar = config.perception, config.sensors.lidar
    cloud_leads = config.mapping.input == "cloud"
    simulated = perception.detector.kind == "sim"
    if lidar is None and (cloud_leads or perception.lift == "cloud"):
        key = "mapping.input" if cloud_leads else "perception.lift"
        raise ConfigError(f"{config.path}: {key}: cloud needs sensors.lidar (where it is mounted)")
    must = config.loop.lockstep or not cloud_leads
    half_frame_ns = int(0.5e9 / config.sensors.camera.rate_hz)
    streams = {}
    if cloud_leads or perception.lift == "cloud":
        period_ns = int(1e9 / lidar.rate_hz)
        streams[topics.CLOUD] = Stream(period_ns, required=cloud_leads or config.loop.lockstep)
    if not cloud_leads or simulated or perception.lift == "depth":
        streams[topics.DEPTH] = Stream(half_frame_ns, required=must)
    streams[topics.RGB] = Stream(half_frame_ns, required=must)
    if simulated:
        streams[topics.OBJECT_IDS] = Stream(half_frame_ns, required=must)
    leader = topics.CLOUD if cloud_leads else topics.DEPTH
    return {leader: streams.pop(leader), **streams}


class Assembler:
    """See the module. For one thread.

    Attributes:
        counters: `received` messages, `observations` given out, and drops by reason (`REASONS`).
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
        self._patience_ns = math.inf if config.loop.lockstep else PATIENCE_NS
        self._camera: CameraModel | None = None
        self._labels: tuple[str, ...] = ()
        self._described: dict[Topic, bytes] = {}
        self._pool: FramePool | None = None
        self._seq = 0
        self._told: set[tuple[str, str]] = set()
        camera, lidar = config.sensors.camera, config.sensors.lidar
        self._T_base_camera = camera_mount(camera.x_m, camera.z_m, math.radians(camera.pitch_deg))
        self._T_base_lidar = np.eye(4)
        if lidar is not None:
            pitch_rad = math.radians(lidar.pitch_deg)
            self._T_base_lidar = se3(lidar.x_m, 0.0, lidar.z_m, pitch_rad=pitch_rad)

    def count(self, topic: Topic, reason: str, detail: str = "") -> None:
        """Count a drop; the first of its kind is also told."""
        self.counters[reason] += 1
        if reason != "superseded" and (topic.key, reason) not in self._told:
            self._told.add((topic.key, reason))
            log.warning("%s: dropped: %s %s(further ones are only counted)",
                        topic.key, reason, f"({detail}) " if detail else "")  # fmt: skip

    # -- messages in --------------------------------------------------------------------------

    def offer(self, topic: Topic, payload: bytes) -> None:
        """Take one message of any topic in `edge.bus.topics` that sensors write."""
        self.counters["received"] += 1
        if not payload:
            self.count(topic, "empty")
            return
        try:
            if topic is topics.ODOMETRY:
                self._take_odometry(payload)
            elif topic in _DESCRIPTIONS:
                self._take_description(topic, payload)
            else:
                self._take_frame(topic, payload)
        except DecodeError as error:
            self.count(topic, "malformed", str(error))

    def _take_odometry(self, payload: bytes) -> None:
        sample = messages.decode_odometry(payload)
        if reason := self.odometry.push(sample.stamp_ns, sample.T_map_base):
            self.count(topics.ODOMETRY, reason)

    def _take_description(self, topic: Topic, payload: bytes) -> None:
        """Cameras describe themselves with every frame, and hardly ever anew."""
        body = payload[_DESCRIPTIONS[topic] :]
        if body == self._described.get(topic):
            return
        if topic is topics.CAMERA_INFO:
            self._take_camera_info(payload)
        else:
            self._labels = _parse_labels(payload)
        self._described[topic] = body

    def _take_camera_info(self, payload: bytes) -> None:
        _, camera = messages.decode_camera_info(payload)
        if camera == self._camera:
            return
        size = camera.width_px * camera.height_px * 3
        if size > self.config.source.max_message_mb * 1e6:
            self.count(topics.CAMERA_INFO, "oversized", f"{camera.width_px}x{camera.height_px} px")
            return
        self._camera, self._pool = camera, None

    def _take_frame(self, topic: Topic, payload: bytes) -> None:
        stream = self.streams.get(topics.CLOUD if topic is topics.SCAN else topic)
        if stream is None:
            return
        stamp_ns = messages.peek_stamp_ns(payload)
        reason = stream.offer(Message(topic, stamp_ns, self._clock(), payload))
        if reason and (reason != "superseded" or topic is self._leader):
            self.count(topic, reason)

    # -- observations out ---------------------------------------------------------------------

    def poll(self) -> Observation | None:
        """The newest complete observation, held once for the caller; older ones are dropped."""
        leading = self.streams[self._leader]
        now_ns = self._clock()
        for message in leading.newest_first():
            joined, T_map_base, reason = self._join(message, now_ns)
            if reason == "wait":
                continue
            leading.drop(message)  # at once: one that cannot be decoded must not come up again
            if T_map_base is None:
                self.count(message.topic, reason)
                continue
            observation = self._observe(message, joined, T_map_base)
            if observation is None:
                continue
            self.counters["superseded"] += leading.drop_through(message.stamp_ns)
            self.counters["observations"] += 1
            return observation
        return None

    def _join(self, leader: Message, now_ns: int) -> tuple[list[Message], np.ndarray | None, str]:
        """(messages that belong to the leader, its pose, why there is none; `wait` = not yet)."""
        waited = now_ns - leader.arrived_ns > self._patience_ns
        joined = []
        for topic in self._others:
            stream = self.streams[topic]
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

    def _observe(
        self, leader: Message, joined: list[Message], T_map_base: np.ndarray
    ) -> Observation | None:
        """Decode into a slot of the pool; None (and counted) where that fails."""
        if self._camera is None and any(m.topic in IMAGES for m in (leader, *joined)):
            self.count(leader.topic, "no_camera_info")
            joined = [m for m in joined if m.topic not in IMAGES]
            if leader.topic in IMAGES:
                return None
        slot = self._acquire()
        if slot is None:
            self.count(leader.topic, "pool_exhausted")
            return None
        fields = None
        try:
            fields = self._fields(leader, joined, slot)
        finally:
            if fields is None:
                slot.release()
        if fields is None:
            return None
        self._seq += 1
        return Observation(
            seq=self._seq - 1,
            stamp_ns=leader.stamp_ns,
            T_map_base=T_map_base,
            camera=self._camera if fields.keys() - {"cloud_m"} else None,
            T_base_camera=self._T_base_camera,
            T_base_lidar=self._T_base_lidar,
            object_labels=self._labels,
            slot=slot,
            **fields,
        )

    def _fields(
        self, leader: Message, joined: list[Message], slot: PoolSlot
    ) -> dict[str, np.ndarray] | None:
        """The observation's arrays by name; None (and counted) where one is missing."""
        fields: dict[str, np.ndarray] = {}
        for message in (leader, *joined):
            array = self._decode(message, slot)
            if array is not None:
                fields[_FIELD_OF[message.topic.key]] = array
            elif message is leader or self.streams[message.topic].required:
                return None
        return fields

    def _acquire(self) -> PoolSlot | None:
        if self._pool is None:
            camera = self._camera
            self._pool = FramePool(
                self.config.source.pool_slots,
                image_hw=(camera.height_px, camera.width_px) if camera is not None else None,
                cloud_points=(
                    self.config.source.max_cloud_points if topics.CLOUD in self.streams else 0
                ),
                depth=topics.DEPTH in self.streams,
                object_ids=topics.OBJECT_IDS in self.streams,
            )
        return self._pool.acquire()

    def _decode(self, message: Message, slot: PoolSlot) -> np.ndarray | None:
        """One message's array, in its place in the slot; None (and counted) where that fails."""
        out = getattr(slot, _FIELD_OF[message.topic.key])
        try:
            if message.topic in IMAGES:
                return self._decode_image(message, out)
            into = _CLOUD_DECODERS[message.topic.key]
            n = into(message.payload, out)
        except DecodeError as error:
            self.count(message.topic, "malformed", str(error))
            return None
        if n == 0:
            self.count(message.topic, "empty")
            return None
        return out[:n]

    def _decode_image(self, message: Message, out: np.ndarray) -> np.ndarray | None:
        header = messages.decode_image_header(message.payload)
        if header.height * header.width == 0:
            self.count(message.topic, "empty")
        elif (header.height, header.width) != out.shape[:2]:
            height, width = out.shape[:2]
            detail = f"{header.width}x{header.height}, camera info says {width}x{height}"
            self.count(message.topic, "wrong_size", detail)
        else:
            messages.decode_image_into(message.payload, header, out)
            return out
        return None


_FIELD_OF = {
    topics.RGB.key: "rgb",
    topics.DEPTH.key: "depth_m",
    topics.OBJECT_IDS.key: "object_ids",
    topics.CLOUD.key: "cloud_m",
    topics.SCAN.key: "cloud_m",
}
_CLOUD_DECODERS = {
    topics.CLOUD.key: messages.decode_point_cloud_into,
    topics.SCAN.key: messages.decode_scan_points_into,
}


def _parse_labels(payload: bytes) -> tuple[str, ...]:
    """The simulator's object labels: a JSON list of names; the one of id i at index i - 1."""
    try:
        labels = json.loads(payload)
    except (ValueError, RecursionError):
        raise DecodeError("not JSON") from None
    if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
        raise DecodeError("not a JSON list of words")
    try:
        for label in labels:
            names.normalise(label)
    except names.NotANameError as error:
        raise DecodeError(str(error)) from None
    return tuple(labels)
