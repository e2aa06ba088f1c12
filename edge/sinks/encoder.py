"""Encoder of results as messages that Foxglove and ROS 2 can display.

A `ResultEncoder` copies the needed data on the loop's thread and encodes them on another. A
recording and a live view have the same channels.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from edge.bus.wire import clouds, compressed, images, markers, messages, transforms
from edge.bus.wire.kernels import exact_millimetres
from edge.bus.wire.messages import BASE_FRAME, MAP_FRAME
from edge.bus.wire.transforms import Transform
from edge.config import Config
from edge.geometry import CameraModel
from edge.loop.result import TickResult
from edge.loop.status import status_message
from edge.recording import channels
from edge.recording.channels import Channel
from edge.sinks.drawings import PathRing, drawing_of, markers_of
from edge.sinks.rate_limiter import RateLimiter
from edge.tasks.follow import path_message
from edge.tasks.refine import RefinedTrajectory
from edge.text import one_line
from edge.types import Detections, Observation

STATUS_HZ = LATENCY_HZ = DRAWN_HZ = INFO_HZ = 1.0
"""Rates of the status, the latencies, the drawings and the camera info."""
MOST_MAP_HZ = 1.0
"""Largest rate of the map, because a map is as large as several depth images."""
SHOWN_HZ = 10.0
"""Rate of pose, transforms and boxes, enough for people; with an image, the pose is always sent."""
TRAJECTORY_HZ = 0.2
"""A trajectory may be long; it is also sent when it changes."""
QUALITY = 85  # of JPEG, 1 to 100
CAMERA_FRAMES, LIDAR_FRAME = ("camera_optical", "camera2_optical"), "lidar"
_MAX_SPARE = 16  # depth buffers that are kept for later use
_NO_DEPTH = np.zeros((0, 0), np.uint16)
_NO_ARRAYS = {"rgb": None, "depth_m": None, "cloud_m": None}
_INFO = 2  # of foxglove.Log
_LINE_LOOP = 2  # of foxglove.PointsAnnotation
# Colours: of boxes and their labels, of the ground of labels, and none.
_BOX = {"r": 1.0, "g": 0.6, "b": 0.1, "a": 1.0}
_DARK = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.6}
_NOTHING = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0}


class EncodedMessage(NamedTuple):
    """One encoded message; `stamp_ns` is the time of its data, `sequence` the observation's number.

    The payload has several parts, so that the writer copies pixels and points only once.
    """

    channel: Channel
    stamp_ns: int
    payload: tuple[bytes | memoryview, ...]
    sequence: int = 0


class _PendingMessage(NamedTuple):
    """A message that is not encoded yet; any thread may encode it."""

    channel: Channel
    stamp_ns: int
    encode: Callable[[], bytes | tuple[bytes | memoryview, ...]]
    sequence: int = 0


@dataclass(frozen=True)
class ResultSnapshot:
    """The data of one result to encode.

    Attributes:
        observation: the observation without its arrays; None: there was none.
        arrays: copies of the wanted arrays, by the observation's fields; depth as uint16
            millimetres if these are exact.
    """

    now_ns: int
    observation: Observation | None
    arrays: dict[str, np.ndarray]
    messages: list[_PendingMessage]

    @property
    def bytes(self) -> int:
        """Size of the arrays."""
        return sum(array.nbytes for array in self.arrays.values())


class ResultEncoder:
    """Encodes results: `capture` is for the loop's thread, `encode` and `release` for another.

    Args:
        rgb_hz: rate of images, as JPEG; depth and clouds are encoded for every observation.
        is_wanted: returns True if a channel has a receiver; called on both threads.
    """

    def __init__(
        self,
        config: Config,
        rgb_hz: float,
        is_wanted: Callable[[Channel], bool] = lambda channel: True,
    ) -> None:
        self._rgb_hz, self._is_wanted = rgb_hz, is_wanted
        map_hz = min(config.report.map_hz, MOST_MAP_HZ)
        rates = {"map": map_hz, "info": INFO_HZ, "status": STATUS_HZ, "latency": LATENCY_HZ}
        rates |= {"pose": SHOWN_HZ, "boxes": SHOWN_HZ, "drawings": DRAWN_HZ}
        rates["trajectory"] = TRAJECTORY_HZ
        rates["rgb"] = max(rgb_hz, 1e-9)  # not 0
        rates |= {f"{name}2": rates[name] for name in ("pose", "info", "rgb", "boxes")}
        self._limiter = RateLimiter(**rates)
        self._driven_path = PathRing()
        self._mission: tuple[str, str, str] | None = None
        self._trajectory: RefinedTrajectory | None = None
        self._spans_ns = 0  # spans (`edge.loop.latency.Span`) are sent up to this time
        self._spare: deque[np.ndarray] = deque(maxlen=_MAX_SPARE)  # depth buffers, of both threads

    def capture(self, result: TickResult, arrays: bool = True) -> ResultSnapshot:
        """Copy the data of a result that will be overwritten, and choose the messages that are due.

        Args:
            result: the result.
            arrays: False to leave out images, depth and clouds.
        """
        if result.pose is not None:
            self._driven_path.add(result.pose)
        pending: list[_PendingMessage] = []
        observation, kept = result.observation, {}
        if observation is not None:
            kept = self._copy_arrays(observation, result.now_ns) if arrays else {}
            observation = replace(observation, slot=None, **_NO_ARRAYS)
            if self._take_turn("pose", observation, result.now_ns) or "rgb" in kept:
                pending += _pose_messages(observation, "cloud_m" in kept)
            camera = observation.camera
            if camera is not None and self._take_turn("info", observation, result.now_ns):
                pending.append(_camera_message(observation, camera))
            pending += _array_messages(observation, kept)
        found = result.detections
        if found is not None and self._take_turn("boxes", found.observation, result.now_ns):
            pending.append(_boxes_message(found))
        pending += self._result_messages(result, result.now_ns)
        return ResultSnapshot(result.now_ns, observation, kept, pending)

    def _take_turn(self, name: str, observation: Observation, now_ns: int) -> bool:
        """Return True if a message about this camera is due; see `RateLimiter.take_turn`."""
        return self._limiter.take_turn(f"{name}2" if observation.camera_index else name, now_ns)

    def _copy_arrays(self, observation: Observation, now_ns: int) -> dict[str, np.ndarray]:
        """Return copies of the wanted arrays; see `ResultSnapshot.arrays`."""
        available = {
            "rgb": (observation.rgb, channels.PICTURE),
            "depth_m": (observation.depth_m, channels.DEPTH),
            "cloud_m": (observation.cloud_m, channels.CLOUD),
        }
        if not (self._rgb_hz > 0 and self._take_turn("rgb", observation, now_ns)):
            del available["rgb"]
        return {
            name: self._copy_depth(array) if name == "depth_m" else array.copy()
            for name, (array, channel) in available.items()
            if array is not None and self._is_wanted(_channel_for(observation, channel))
        }

    def _copy_depth(self, depth_m: np.ndarray) -> np.ndarray:
        """Copy depth, as exact millimetres if possible.

        Millimetres take half the bytes and compress better. The conversion costs as much as a copy,
        since the map has just read the array.
        """
        mm = self._spare.pop() if self._spare else _NO_DEPTH
        if mm.shape != depth_m.shape:
            mm = np.empty(depth_m.shape, np.uint16)
        if exact_millimetres(depth_m.reshape(-1), mm.reshape(-1)):
            return mm
        self._spare.append(mm)
        return depth_m.copy()

    def _result_messages(self, result: TickResult, now_ns: int) -> Iterator[_PendingMessage]:
        """Yield all messages but those of the observation and of the detections."""
        for goal in result.goals:
            encode = partial(messages.encode_pose_stamped, goal.stamp_ns, goal.pose)
            yield _PendingMessage(channels.GOAL, goal.stamp_ns, encode)
        for status in result.goal_statuses:
            fields = {"stamp": status.stamp_ns, "state": status.state, "reason": status.reason}
            yield _PendingMessage(channels.GOAL_STATUS, now_ns, partial(json_bytes, fields))
        for event in result.events:
            yield _PendingMessage(channels.EVENTS, event.now_ns, partial(_encode_log, *event))
        mission = result.status
        if (mission.target, mission.phase, mission.reason) != self._mission:
            self._mission = (mission.target, mission.phase, mission.reason)
            yield _PendingMessage(channels.MISSION, now_ns, partial(json_bytes, asdict(mission)))
        if self._limiter.take_turn("status", now_ns):
            yield _PendingMessage(
                channels.STATUS, now_ns, partial(json_bytes, status_message(result))
            )
        if self._limiter.take_turn("latency", now_ns):
            yield _PendingMessage(
                channels.LATENCY, now_ns, lambda: json_bytes(result.latency().as_dict())
            )
            yield _PendingMessage(channels.SPANS, now_ns, partial(self._encode_spans, result))
        if self._limiter.take_turn("map", now_ns):
            yield _PendingMessage(
                channels.MAP, now_ns,
                lambda: messages.encode_occupancy_grid(now_ns, result.snapshot()),
            )  # fmt: skip
        if self._limiter.take_turn("drawings", now_ns):
            driven, drawing = self._driven_path.poses(), drawing_of(result)
            path = partial(transforms.encode_path, now_ns, MAP_FRAME, driven)
            yield _PendingMessage(channels.PATH, now_ns, path)
            yield _PendingMessage(
                channels.MARKERS, now_ns,
                lambda: markers.encode_markers(now_ns, MAP_FRAME, markers_of(drawing)),
            )  # fmt: skip

        yield from self._trajectory_messages(result, now_ns)

    def _trajectory_messages(self, result: TickResult, now_ns: int) -> Iterator[_PendingMessage]:
        """Yield the trajectory if it changed, and every few seconds; an empty one after its end."""
        task = result.task()
        refined = None if task is None else task.refined
        due = refined is not None and self._limiter.take_turn("trajectory", now_ns)
        if due or refined is not self._trajectory:
            self._trajectory = refined
            yield _PendingMessage(
                channels.TRAJECTORY, now_ns, partial(path_message, refined, now_ns)
            )

    def _encode_spans(self, result: TickResult) -> bytes:
        """Encode the spans since the last call."""
        spans = result.spans(self._spans_ns)
        # `result.spans` selects ticks by their begin, and background spans by their end.
        ends_ns = [s.begin_ns + (0 if s.in_tick else s.took_ns) for s in spans]
        self._spans_ns = max(ends_ns, default=self._spans_ns)
        return json_bytes({"spans": spans})

    def encode(self, snapshot: ResultSnapshot) -> Iterator[EncodedMessage]:
        """Yield the messages in the order of events; payloads are valid until `release`."""
        for channel, stamp_ns, encode, sequence in snapshot.messages:
            if self._is_wanted(channel):
                encoded = encode()
                payload = encoded if isinstance(encoded, tuple) else (encoded,)
                yield EncodedMessage(channel, stamp_ns, payload, sequence)

    def release(self, snapshot: ResultSnapshot) -> None:
        """Take back the arrays of a snapshot for later ones."""
        depth = snapshot.arrays.pop("depth_m", None)
        if depth is not None and depth.dtype == np.uint16:
            self._spare.append(depth)


def _pose_messages(observation: Observation, cloud: bool) -> Iterator[_PendingMessage]:
    """Yield the pose of the robot and of its sensors."""
    stamp_ns, T = observation.stamp_ns, observation.T_map_base
    yield _PendingMessage(
        channels.ODOMETRY, stamp_ns, partial(messages.encode_odometry, stamp_ns, T, 0.0, 0.0)
    )
    tf = [Transform(stamp_ns, MAP_FRAME, BASE_FRAME, T)]
    if observation.camera is not None:
        tf.append(
            Transform(stamp_ns, BASE_FRAME, _frame_of(observation), observation.T_base_camera)
        )
    if cloud:
        tf.append(Transform(stamp_ns, BASE_FRAME, LIDAR_FRAME, observation.T_base_lidar))
    yield _PendingMessage(channels.TF, stamp_ns, partial(transforms.encode_transforms, tf))


def _channel_for(observation: Observation, channel: Channel) -> Channel:
    """Return the channel of the observation's camera, given that of the first."""
    return channels.SECOND.get(channel, channel) if observation.camera_index else channel


def _frame_of(observation: Observation) -> str:
    return CAMERA_FRAMES[observation.camera_index]


def _camera_message(observation: Observation, camera: CameraModel) -> _PendingMessage:
    stamp_ns = observation.stamp_ns
    encode = partial(messages.encode_camera_info, stamp_ns, _frame_of(observation), camera)
    return _PendingMessage(_channel_for(observation, channels.CAMERA_INFO), stamp_ns, encode)


def _array_messages(
    observation: Observation, arrays: dict[str, np.ndarray]
) -> Iterator[_PendingMessage]:
    stamp_ns, n = observation.stamp_ns, observation.seq & 0xFFFFFFFF  # MCAP has 32 bits for it
    for name, array in arrays.items():
        channel, encoder = _ENCODERS[name]
        frame = LIDAR_FRAME if name == "cloud_m" else _frame_of(observation)
        encode = partial(encoder, stamp_ns, frame, array)
        yield _PendingMessage(_channel_for(observation, channel), stamp_ns, encode, n)


_Encoder = Callable[[int, str, np.ndarray], Any]
# Field of `Observation` → channel, encoder.
_ENCODERS: dict[str, tuple[Channel, _Encoder]] = {
    "cloud_m": (channels.CLOUD, clouds.cloud_parts),
    "depth_m": (channels.DEPTH, images.image_parts),
    "rgb": (channels.PICTURE, partial(compressed.encode_jpeg, quality=QUALITY)),
}


def _boxes_message(found: Detections) -> _PendingMessage:
    stamp_ns = found.observation.stamp_ns
    channel = _channel_for(found.observation, channels.BOXES)
    return _PendingMessage(channel, stamp_ns, partial(_encode_boxes, stamp_ns, found))


def _encode_boxes(stamp_ns: int, found: Detections) -> bytes:
    """Encode foxglove.ImageAnnotations."""
    at = _time(stamp_ns)
    outlines, labels = [], []
    for (x0, y0, x1, y1), score, k in zip(
        found.xyxy_px.tolist(), found.score.tolist(), found.class_id.tolist(), strict=True
    ):
        corners = [{"x": x, "y": y} for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        outlines.append({
            "timestamp": at, "type": _LINE_LOOP, "points": corners, "outline_color": _BOX,
            "outline_colors": [], "fill_color": _NOTHING, "thickness": 2.0,
        })  # fmt: skip
        labels.append({
            "timestamp": at, "position": corners[0], "text": f"{found.prompts[k]} {score:.2f}",
            "font_size": 12.0, "text_color": _BOX, "background_color": _DARK,
        })  # fmt: skip
    return json_bytes({"circles": [], "points": outlines, "texts": labels})


def _encode_log(now_ns: int, text: str) -> bytes:
    return json_bytes({
        "timestamp": _time(now_ns), "level": _INFO, "message": one_line(text, 1000),
        "name": "edge", "file": "", "line": 0,
    })  # fmt: skip


def _time(stamp_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def json_bytes(value: Any) -> bytes:
    """Encode as compact JSON; raise ValueError for NaN or inf."""
    return _JSON(value).encode()


_JSON = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
