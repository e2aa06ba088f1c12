"""What the service saw and said, as messages that Foxglove and ROS 2 know.

A `Teller` takes what is needed from a result on the loop's thread, and makes messages of it on
another. A recording and a live view have the same channels.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from edge.bus.wire import compressed, markers, messages, transforms
from edge.bus.wire.images import M_PER_MM
from edge.bus.wire.messages import BASE_FRAME, MAP_FRAME
from edge.bus.wire.transforms import Transform
from edge.config import Config
from edge.loop.result import TickResult
from edge.loop.status import status_of
from edge.recording import channels
from edge.recording.channels import Channel
from edge.sinks.drawings import Way, markers_of
from edge.sinks.pace import Pace
from edge.text import one_line
from edge.types import Detections, Observation

STATUS_HZ = LATENCY_HZ = DRAWN_HZ = 1.0
QUALITY = 85
CAMERA_FRAME, LIDAR_FRAME = "camera_optical", "lidar"
_INFO = 2  # of foxglove.Log
_LINE_LOOP = 2  # of foxglove.PointsAnnotation
_BOX = {"r": 1.0, "g": 0.6, "b": 0.1, "a": 1.0}
_DARK = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.6}
_NOTHING = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0}


class Told(NamedTuple):
    """One message; `stamp_ns` is what it is about, `sequence` the observation's number."""

    channel: Channel
    stamp_ns: int
    payload: bytes
    sequence: int = 0


@dataclass(frozen=True)
class Moment:
    """What is to be told of a result.

    Attributes:
        seen: the observation, with copies of those arrays that are wanted and no others.
        later: makes messages of what is dear to gather, and may be called by any thread.
    """

    now_ns: int
    seen: Observation | None
    detections: Detections | None
    made: list[Callable[[], Told]] = field(default_factory=list)

    @property
    def bytes(self) -> int:
        """Of the arrays."""
        arrays = () if self.seen is None else (self.seen.rgb, self.seen.depth_m, self.seen.cloud_m)
        return sum(array.nbytes for array in arrays if array is not None)


class Teller:
    """See the module; `take` is for the loop's thread, `tell` for another.

    Args:
        rgb_hz: of pictures, as JPEG; depth and clouds are told of every observation.
    """

    def __init__(self, config: Config, rgb_hz: float) -> None:
        self._rgb_hz = rgb_hz
        rates = {"map": config.report.map_hz, "status": STATUS_HZ, "latency": LATENCY_HZ}
        self._pace = Pace(rgb=max(rgb_hz, 1e-9), drawings=DRAWN_HZ, **rates)
        self._way = Way()
        self._mission: tuple[str, str, str] | None = None
        self._spans_ns = 0  # told up to here

    def take(self, result: TickResult, arrays: bool = True) -> Moment:
        """What is to be told of a result; copies what the source will write over.

        Args:
            arrays: False: without pictures, depth and clouds.
        """
        seen, now_ns = result.observation, result.now_ns
        if result.pose is not None:
            self._way.add(result.pose)
        if seen is not None:
            picture = arrays and self._rgb_hz > 0 and seen.rgb is not None
            seen = replace(
                seen,
                rgb=_copy(seen.rgb) if picture and self._pace.is_due("rgb", now_ns) else None,
                depth_m=_copy(seen.depth_m) if arrays else None,
                cloud_m=_copy(seen.cloud_m) if arrays else None,
                slot=None,
            )
        return Moment(now_ns, seen, result.detections, list(self._made(result, now_ns)))

    def _made(self, result: TickResult, now_ns: int) -> Iterator[Callable[[], Told]]:
        """What is made later of what is gathered now."""
        for goal in result.goals:
            yield lambda goal=goal: Told(
                channels.GOAL, goal.stamp_ns, messages.encode_pose_stamped(goal.stamp_ns, goal.pose)
            )
        for answer in result.answers:
            said = {"stamp": answer.stamp_ns, "state": answer.state, "reason": answer.reason}
            yield lambda said=said: Told(channels.GOAL_STATUS, now_ns, json_bytes(said))
        for event in result.events:
            yield lambda event=event: Told(channels.EVENTS, event.now_ns, _log(*event))
        status = result.status
        if (status.target, status.phase, status.reason) != self._mission:
            self._mission = (status.target, status.phase, status.reason)
            yield lambda: Told(channels.MISSION, now_ns, json_bytes(asdict(status)))
        if self._pace.is_due("status", now_ns):
            said = status_of(result)
            yield lambda: Told(channels.STATUS, now_ns, json_bytes(said))
        if self._pace.is_due("latency", now_ns):
            yield lambda: Told(channels.LATENCY, now_ns, json_bytes(result.latency().as_dict()))
            yield lambda: Told(channels.SPANS, now_ns, self._spans(result))
        if self._pace.is_due("map", now_ns):
            yield lambda: Told(
                channels.MAP, now_ns, messages.encode_occupancy_grid(now_ns, result.snapshot())
            )
        if self._pace.is_due("drawings", now_ns):
            way, drawn = self._way.poses(), (result.frontiers(), result.instances(), result.goal)
            yield lambda: Told(
                channels.PATH, now_ns, transforms.encode_path(now_ns, MAP_FRAME, way)
            )
            yield lambda: Told(
                channels.MARKERS, now_ns,
                markers.encode_markers(now_ns, MAP_FRAME, markers_of(*drawn)),
            )  # fmt: skip

    def _spans(self, result: TickResult) -> bytes:
        """Those that came since the last were told."""
        spans = result.spans(self._spans_ns)
        ends_ns = [s.begin_ns + (0 if s.in_tick else s.took_ns) for s in spans]
        self._spans_ns = max(ends_ns, default=self._spans_ns)
        return json_bytes({"spans": spans})

    def tell(self, moment: Moment) -> Iterator[Told]:
        """The messages of a moment."""
        if moment.seen is not None:
            yield from _told_of(moment.seen)
        if moment.detections is not None:
            found = moment.detections
            yield Told(channels.BOXES, found.observation.stamp_ns, _boxes(found))
        for make in moment.made:
            yield make()


def _told_of(seen: Observation) -> Iterator[Told]:
    """Sensors, pose and transforms of an observation."""
    stamp_ns, n = seen.stamp_ns, seen.seq & 0xFFFFFFFF
    yield Told(
        channels.ODOMETRY, stamp_ns,
        messages.encode_odometry(stamp_ns, seen.T_map_base, 0.0, 0.0), n,
    )  # fmt: skip
    tf = [Transform(stamp_ns, MAP_FRAME, BASE_FRAME, seen.T_map_base)]
    if seen.camera is not None:
        tf.append(Transform(stamp_ns, BASE_FRAME, CAMERA_FRAME, seen.T_base_camera))
        info = messages.encode_camera_info(stamp_ns, CAMERA_FRAME, seen.camera)
        yield Told(channels.CAMERA_INFO, stamp_ns, info, n)
    if seen.cloud_m is not None:
        tf.append(Transform(stamp_ns, BASE_FRAME, LIDAR_FRAME, seen.T_base_lidar))
        cloud = messages.encode_point_cloud(stamp_ns, LIDAR_FRAME, seen.cloud_m)
        yield Told(channels.CLOUD, stamp_ns, cloud, n)
    yield Told(channels.TF, stamp_ns, transforms.encode_transforms(tf), n)
    if seen.depth_m is not None:
        depth = messages.encode_image(stamp_ns, CAMERA_FRAME, _smallest(seen.depth_m))
        yield Told(channels.DEPTH, stamp_ns, depth, n)
    if seen.rgb is not None:
        jpeg = compressed.encode_jpeg(stamp_ns, CAMERA_FRAME, seen.rgb, QUALITY)
        yield Told(channels.PICTURE, stamp_ns, jpeg, n)


def _smallest(depth_m: np.ndarray) -> np.ndarray:
    """Millimetres as uint16 where these say exactly the same, as most cameras' do."""
    with np.errstate(invalid="ignore"):
        mm = np.rint(depth_m * np.float32(1000.0)).astype(np.uint16)
    return mm if np.array_equal(mm * M_PER_MM, depth_m) else depth_m


def _copy(array: np.ndarray | None) -> np.ndarray | None:
    return None if array is None else array.copy()


def _boxes(found: Detections) -> bytes:
    """foxglove.ImageAnnotations."""
    at = _time(found.observation.stamp_ns)
    outlines, words = [], []
    for (x0, y0, x1, y1), score, k in zip(
        found.xyxy_px.tolist(), found.score.tolist(), found.class_id.tolist(), strict=True
    ):
        corners = [{"x": x, "y": y} for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        outlines.append({
            "timestamp": at, "type": _LINE_LOOP, "points": corners, "outline_color": _BOX,
            "outline_colors": [], "fill_color": _NOTHING, "thickness": 2.0,
        })  # fmt: skip
        words.append({
            "timestamp": at, "position": corners[0], "text": f"{found.prompts[k]} {score:.2f}",
            "font_size": 12.0, "text_color": _BOX, "background_color": _DARK,
        })  # fmt: skip
    return json_bytes({"circles": [], "points": outlines, "texts": words})


def _log(now_ns: int, text: str) -> bytes:
    """foxglove.Log."""
    return json_bytes({
        "timestamp": _time(now_ns), "level": _INFO, "message": one_line(text, 1000),
        "name": "edge", "file": "", "line": 0,
    })  # fmt: skip


def _time(stamp_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def json_bytes(said: Any) -> bytes:
    return json.dumps(said, separators=(",", ":"), allow_nan=False).encode()
