"""Synchronizer of camera, depth, cloud and odometry messages into Observations.

One sensor leads (`mapping.input`): each of its depth images or clouds is one observation. Frames of
the other sensors are joined to it by stamp. The leading frame waits for them, for a pose and for
mounts, at most `source.wait_s`. After that older data are used: a pose is extrapolated, but only
within `source.max_pose_gap_s` and while odometry arrives. A frame without a pose or a required
sensor is dropped and counted. In lockstep it waits forever, so that a run can be replayed exactly.
Of several complete observations the newest is used.

Each camera has a synchronizer of its own, with depth that leads; they share poses and counters. If
both cameras have an observation, they take turns. If one sends later than the other, stamps of
observations go back and forth.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from edge.config import Config, ConfigError
from edge.sources.frame_decoder import FrameDecoder
from edge.sources.inputs import InputTable, group_of
from edge.sources.messages import (
    CameraInfo,
    Cloud,
    DepthImage,
    Image,
    Message,
    MountAt,
    Odometry,
    SensorFrame,
)
from edge.sources.odometry import Missing, OdometryRing
from edge.sources.streams import Stream
from edge.text import one_line
from edge.types import CAMERAS, Observation

log = logging.getLogger("edge.sources")

_EXTRA_WAIT_NS = 50_000_000  # for an optional sensor, on top of its usual delay
_POSES_APART_NS = 1_000_000  # smallest distance of two poses that are kept
_MAX_LARGE_MESSAGES = 4  # messages of the largest size that one stream may hold
_NAMES = {kind.field: kind.topic for kind in (Image, DepthImage, Cloud)}

# Reasons of drops, the keys of `TimeSynchronizer.counters`.
REASONS = (
    "malformed",  # cannot be decoded
    "oversized",  # larger than source.max_message_mb
    "empty",  # no bytes, pixels or valid points
    "wrong_size",  # an image of another size than the camera info
    "repeated",  # the same stamp as before
    "backward",  # an earlier stamp than before
    "stale",  # a frame older than all poses that are kept
    "superseded",  # a newer frame was used
    "unpaired",  # no frame of a required sensor at this time
    "no_pose",
    "no_camera_info",
    "no_transform",  # missing in tf
    "pool_exhausted",  # all slots of the pool are in use
    "overrun",  # messages came faster than they were read
    "distorted",  # camera info with a distortion that cannot be used
)

# Counted, but no drop: the message is used.
_BREAKS = {
    "pose_jump": "the pose jumped: those before it are forgotten",
    "clock_reset": "the clock was reset: earlier stamps than before are accepted again",
}

_LIMITS = {
    "oversized": "source.max_message_mb",
    "pool_exhausted": "source.pool_slots",
    "pose_jump": "source.max_pose_jump_m",
}
"""Setting that limits what is accepted, by the reason of a drop."""


def streams_of(config: Config, camera_index: int = 0) -> dict[str, Stream]:
    """Return the streams that are joined with a camera, by field, the leading one first.

    Raises:
        ConfigError: it needs a cloud but has no `sensors.lidar`.
    """
    perception, lidar = config.perception, config.sensors.lidar
    cloud_leads = config.mapping.input == "cloud"
    if lidar is None and (cloud_leads or perception.back_projection == "cloud"):
        key = "mapping.input" if cloud_leads else "perception.back_projection"
        raise ConfigError(f"{config.locate(key)}: cloud needs sensors.lidar (where it is mounted)")
    needs_images = config.loop.lockstep or not cloud_leads
    half_frame_ns = int(0.5e9 / config.sensors.cameras[camera_index].rate_hz)
    # A frame may come this long before the leading frame, which then waits as long for its pose.
    kept_ns = int(2e9 * config.source.wait_s)
    most_bytes = int(_MAX_LARGE_MESSAGES * 1e6 * config.source.max_message_mb)
    streams = {}
    if cloud_leads or perception.back_projection == "cloud":
        needs_cloud = cloud_leads or config.loop.lockstep
        streams["cloud_m"] = Stream(int(1e9 / lidar.rate_hz), needs_cloud, kept_ns, most_bytes)
    # The simulator's detector takes distances from the depth image.
    if (
        not cloud_leads
        or perception.back_projection == "depth"
        or perception.detector.kind == "sim"
    ):
        streams["depth_m"] = Stream(half_frame_ns, needs_images, kept_ns, most_bytes)
    streams["rgb"] = Stream(half_frame_ns, needs_images, kept_ns, most_bytes)
    leader = "cloud_m" if cloud_leads else "depth_m"
    return {leader: streams.pop(leader), **streams}


def _make_odometry(config: Config, wait_ns: int) -> OdometryRing:
    return OdometryRing(
        config.source.odometry_ring,
        config.source.max_pose_gap_s,
        config.source.max_pose_jump_m,
        config.robot.max_speed_mps,
        config.robot.max_turn_radps,
        # So a full ring covers at least twice the waiting time (see `StampedPoses`).
        max(_POSES_APART_NS, 4 * wait_ns // config.source.odometry_ring),
    )


def _describe_nearest(leader: SensorFrame, name: str, nearest_ns: int | None) -> str:
    if nearest_ns is None:
        return f"no {name}"
    ms = (nearest_ns - leader.stamp_ns) / 1e6
    return f"the nearest {name} is {abs(ms):.0f} ms {'later' if ms > 0 else 'earlier'}"


class _Joined(NamedTuple):
    """A leading frame with all that was joined to it.

    Attributes:
        frames: of all sensors, the leading one first.
        T_map_base: pose at the leading frame's stamp.
        mounts: poses of the sensors on the base, by field of `Observation`.
        pose_age_ns: age of the odometry at the frame's stamp; 0: interpolated.
        tf_age_ns: age of the transforms at the frame's stamp.
    """

    frames: list[SensorFrame]
    T_map_base: np.ndarray
    mounts: dict[str, np.ndarray]
    pose_age_ns: int
    tf_age_ns: int


class _Dropped(NamedTuple):
    """The reason why a leading frame becomes no observation.

    Attributes:
        reason: one of `REASONS` or `_BREAKS`.
        why: more about the reason, in one line.
    """

    reason: str
    why: str


class TimeSynchronizer:
    """Joins messages as the module's docstring says; for one thread.

    A frame is one image or sweep; a field is the attribute of `Observation` that it fills.

    Args:
        clock: time of arrivals, in ns.
        mount_at: gives mounts that move; None: mounts come from the configuration.
        first: the synchronizer of the first camera, if this one is for the second. Messages and
            poses go through the first.

    Attributes:
        counters: numbers of messages (`received`), of observations (`observations`), of these with
            an old pose (`old_pose`, see `Observation.pose_age_ns`), and of drops (`REASONS`).
        inputs: messages and drops of each input, with rates and ages.
    """

    def __init__(
        self,
        config: Config,
        clock: Callable[[], int] = time.monotonic_ns,
        mount_at: MountAt | None = None,
        first: TimeSynchronizer | None = None,
    ) -> None:
        self.config = config
        wait_ns = int(config.source.wait_s * 1e9)
        self._index = 0 if first is None else 1
        self.streams = streams_of(config, self._index)
        self._leader, *self._others = self.streams
        self._clock = clock
        # All cameras, the one whose turn it is first; for the second camera: none.
        self._turns: list[TimeSynchronizer] = []
        if first is None:
            self.odometry = _make_odometry(config, wait_ns)
            totals = ("received", "observations", "old_pose")
            self.counters: dict[str, int] = dict.fromkeys((*totals, *REASONS, *_BREAKS), 0)
            self.inputs = InputTable(config, self.streams, clock)
            self._turns = [self]
            if len(config.sensors.cameras) > 1:
                self._turns.append(TimeSynchronizer(config, clock, mount_at, self))
        else:
            self.odometry, self.counters, self.inputs = first.odometry, first.counters, first.inputs
        self._cameras = tuple(self._turns)
        self._wait_ns = math.inf if config.loop.lockstep else wait_ns  # most for a leading frame
        self._mount_at = mount_at
        self._camera_frame = ""  # frame id of the newest image
        self._logged: set[tuple[str, str]] = set()  # (topic, reason) that were logged
        self._decoder = FrameDecoder(config, self._index, self.streams, self.inputs, self.count)
        camera, lidar = config.sensors.cameras[self._index], config.sensors.lidar
        self._mounts = {  # those of the configuration
            "T_base_camera": camera.T_base_camera(),
            "T_base_lidar": np.eye(4) if lidar is None else lidar.T_base_mount(),
        }

    def received(self, topic: str) -> None:
        """Count a message, before it is decoded and offered."""
        self.counters["received"] += 1
        self.inputs.on_message(topic)

    def count(self, topic: str, reason: str, detail: object = "") -> None:
        """Count a drop, a jump of the pose or a reset of the clock; log the first of its kind."""
        self.counters[reason] += 1
        limit = f"the limit is {_LIMITS[reason]}" if reason in _LIMITS else ""
        detail = ", ".join(filter(None, (one_line(detail), limit)))
        if reason not in _BREAKS:
            self.inputs.on_dropped(topic, reason, detail)
        if reason != "superseded" and (topic, reason) not in self._logged:
            self._logged.add((topic, reason))
            what = _BREAKS.get(reason, f"message dropped: {reason}")
            shown = f"({detail}) " if detail else ""
            log.warning("%s: %s %s(further ones are only counted)", topic, what, shown)

    def _count_old(self, leader: SensorFrame, joined: _Joined) -> None:
        """Count an observation with an old pose or mount; log the first of its kind."""
        if max(joined.pose_age_ns, joined.tf_age_ns) == 0:
            return
        self.counters["old_pose"] += 1
        for topic, what, age_ns in (
            (Odometry.topic, "poses", joined.pose_age_ns),
            ("tf", "transforms", joined.tf_age_ns),
        ):
            if not age_ns:
                continue
            delay_ns = self.odometry.delay_ns
            late = self._describe_delay(leader, topic, delay_ns) if topic == "odom" else ""
            warning = f"mapped with {what} {age_ns / 1e6:.0f} ms old{late}"
            self.inputs.warn(topic, warning)
            if (topic, "old") not in self._logged:
                self._logged.add((topic, "old"))
                log.warning("%s: %s (further ones are only counted)", topic, warning)

    # -- messages in --------------------------------------------------------------------------

    def offer(self, message: Message) -> None:
        """Process one message; frames of unused sensors are ignored."""
        i = message.camera_index
        # A cloud is joined with the images of each camera.
        for camera in self._cameras if isinstance(message, Cloud) else self._cameras[i : i + 1]:
            camera._take(message)

    def _take(self, message: Message) -> None:
        """Process a message of this camera, or of none."""
        reason = ""
        if isinstance(message, Odometry):
            reason = self.odometry.push(message.stamp_ns, message.T_map_base, message.age_ns)
            if reason not in ("repeated", "backward"):
                self.odometry.came_ns = self._clock()
                self.odometry.delay_ns = self.odometry.came_ns - message.stamp_ns
                self.inputs.on_used(message.topic)
        elif isinstance(message, CameraInfo):
            self._decoder.use_camera_info(message)
        elif (stream := self.streams.get(message.field)) is not None:
            reason = stream.offer(message)
            if message.field == Image.field:
                self._camera_frame = message.frame_id
            # A frame of another sensor that no leading frame needed is no drop.
            if reason == "superseded" and message.field != self._leader:
                return
        if reason:
            self.count(message.topic, reason)

    # -- observations out ---------------------------------------------------------------------

    def poll(self) -> Observation | None:
        """Return the newest complete observation, held once for the caller; cameras take turns.

        If clouds lead, each is used once: by the camera whose turn it is, or without an image. In
        lockstep, each needs an image, so the camera that has one uses it.
        """
        if len(self._turns) == 1:
            return self._poll_camera()
        cloud_leads = self._leader == Cloud.field
        waits = cloud_leads and not self.config.loop.lockstep
        for camera in self._turns[: 1 if waits else None]:
            if (observation := camera._poll_camera()) is not None:
                self._turns.remove(camera)
                if cloud_leads:
                    self._turns[0].streams[self._leader].drop_through(observation.stamp_ns)
                self._turns.append(camera)
                return observation
        return None

    def _poll_camera(self) -> Observation | None:
        """Return the newest complete observation of this camera; drop older ones."""
        leading = self.streams[self._leader]
        now_ns = self._clock()
        for frame in leading.newest_first():
            joined = self._join(frame, now_ns)
            if joined is None:
                continue  # it waits; an older one may be complete
            leading.drop_frame(frame)  # now: a frame that cannot be decoded must not be tried again
            if isinstance(joined, _Dropped):
                self.count(frame.topic, joined.reason, joined.why)
                continue
            observation = self._observe(frame, joined)
            if observation is None:
                continue
            self.counters["superseded"] += leading.drop_through(frame.stamp_ns)
            for field in self._others:
                self.streams[field].drop_unneeded(frame.stamp_ns)
            self.counters["observations"] += 1
            return observation
        return None

    def _join(self, leader: SensorFrame, now_ns: int) -> _Joined | _Dropped | None:
        """Return the leading frame with what belongs to it, or why it is dropped; None: wait."""
        since_ns = now_ns - leader.arrived_ns  # how long the frame has waited
        waited = since_ns > self._wait_ns
        frames = [leader]
        for field in self._others:
            stream = self.streams[field]
            match = stream.find_match(leader.stamp_ns)
            if match is not None:
                frames.append(match)
            elif not (since_ns > self._wait_limit_ns(stream) or stream.is_past(leader.stamp_ns)):
                return None
            elif stream.required:
                return _Dropped("unpaired", self._describe_distance(leader, field))
        T_map_base, missing, tf_age_ns = self.odometry.pose_at(leader.stamp_ns)
        pose_age_ns = 0
        if missing in ("empty", "too_new"):
            if not waited:
                return None
            # If no pose came after the frame, odometry is not late but silent.
            if missing == "too_new" and self.odometry.came_ns >= leader.arrived_ns:
                T_map_base, tf_age_ns = self.odometry.extrapolate(leader.stamp_ns)
                pose_age_ns = leader.stamp_ns - self.odometry.newest_ns
        if T_map_base is None:
            return self._without_pose(leader, missing)
        mounts = dict(self._mounts)
        for name, frame_id, stamp_ns in self._moving_mounts(frames):
            placed = self._mount_at(frame_id, stamp_ns)
            if placed.T is None:
                return _Dropped("no_transform", placed.why)
            if placed.age_ns and not waited:
                return None
            mounts[name], tf_age_ns = placed.T, max(tf_age_ns, placed.age_ns)
        return _Joined(frames, T_map_base, mounts, pose_age_ns, tf_age_ns)

    def _wait_limit_ns(self, stream: Stream) -> float:
        """Return how long a leading frame waits for another sensor, in ns."""
        if stream.required:
            return self._wait_ns
        late_ns = 0
        if stream.delay_ns is not None:
            late_ns = max(0, stream.delay_ns - self.streams[self._leader].delay_ns)
        return min(self._wait_ns, late_ns + _EXTRA_WAIT_NS)

    def _moving_mounts(self, frames: list[SensorFrame]) -> list[tuple[str, str, int]]:
        """Return the moving mounts to look up: field of `Observation`, sensor frame, stamp."""
        if self._mount_at is None:
            return []
        by_field = {frame.field: frame for frame in frames}
        lookups = []
        if (cloud := by_field.get(Cloud.field)) is not None:
            lookups.append(("T_base_lidar", cloud.frame_id, cloud.stamp_ns))
        # Depth is registered to the colour image: same mount, at the depth's own stamp.
        image = by_field.get(DepthImage.field) or by_field.get(Image.field)
        if image is not None and self._camera_frame:
            lookups.append(("T_base_camera", self._camera_frame, image.stamp_ns))
        return lookups

    def _without_pose(self, leader: SensorFrame, missing: Missing) -> _Dropped:
        """Return why a frame without a pose is dropped."""
        if missing == "gap":
            why = "the poses around it are farther apart than source.max_pose_gap_s"
            return _Dropped("no_pose", why)
        newest_ns, delay_ns = self.odometry.newest_ns, self.odometry.delay_ns
        why = _describe_nearest(leader, Odometry.topic, newest_ns) + self._describe_delay(
            leader, "odom", delay_ns
        )
        return _Dropped("stale" if missing == "too_old" else "no_pose", why)

    def _describe_distance(self, leader: SensorFrame, field: str) -> str:
        """Describe how far the nearest frame of another sensor is, and which of them is late."""
        stream = self.streams[field]
        nearest = stream.nearest(leader.stamp_ns)
        if nearest is None:
            name = _NAMES[field].replace(CAMERAS[0], CAMERAS[self._index])
            return _describe_nearest(leader, name, None)
        distance = _describe_nearest(leader, nearest.topic, nearest.stamp_ns)
        return distance + self._describe_delay(leader, nearest.topic, stream.delay_ns)

    def _describe_delay(self, leader: SensorFrame, topic: str, delay_ns: int | None) -> str:
        """Describe which of two topics arrives too late, and by how much; "" if neither does."""
        leader_delay_ns = self.streams[self._leader].delay_ns
        if delay_ns is None or leader_delay_ns is None:
            return ""
        late_ns, wait_s = delay_ns - leader_delay_ns, self.config.source.wait_s
        if abs(late_ns) <= wait_s * 1e9:
            return ""
        late, early = (topic, leader.topic) if late_ns > 0 else (leader.topic, topic)
        delay = f"{late} comes {abs(late_ns) / 1e6:.0f} ms after {early} of its stamp"
        return f"; {delay}, and source.wait_s is {wait_s:g}"

    def _observe(self, leader: SensorFrame, joined: _Joined) -> Observation | None:
        """Decode into a slot of the pool; None (and counted) if that fails."""
        frames = joined.frames
        camera = self._decoder.camera
        if camera is None and not all(isinstance(frame, Cloud) for frame in frames):
            self.count(leader.topic, "no_camera_info")
            if not isinstance(leader, Cloud):
                return None
            frames = [leader]  # the cloud alone needs no camera
        slot = self._decoder.acquire()
        if slot is None:
            self.count(leader.topic, "pool_exhausted")
            return None
        fields = None
        try:
            fields = self._decoder.decode(frames, slot)
        finally:
            if fields is None:
                slot.release()
        if fields is None:
            return None
        for frame in frames:
            if frame.field in fields:
                self.inputs.on_used(frame.topic)
        for field in self._others:
            if field not in fields:  # optional: an observation without it is complete, too
                self.inputs.on_unpaired(
                    group_of(field, self._index), self._describe_distance(leader, field)
                )
        self._count_old(leader, joined)
        return Observation(
            seq=self.counters["observations"],
            stamp_ns=leader.stamp_ns,
            T_map_base=joined.T_map_base,
            camera=camera if fields.keys() - {"cloud_m"} else None,
            slot=slot,
            pose_age_ns=max(joined.pose_age_ns, joined.tf_age_ns),
            **joined.mounts,
            distortion=self._decoder.distortion,
            lag_ns=self._lag_ns(leader),
            camera_index=self._index,
            **fields,
        )

    def _lag_ns(self, leader: SensorFrame) -> int:
        """Return how much newer the newest pose is than the frame; 0 in lockstep."""
        if self.config.loop.lockstep:
            return 0
        return max(self.odometry.newest_ns - leader.stamp_ns, 0)
