"""A recording for the Rerun viewer (extra `rerun`), which can follow the file while it grows.

There is no server and no connection to a viewer: `rerun-sdk` 0.41 serves on all addresses without
authentication, and a connection blocks its sender while no viewer reads.
"""

from __future__ import annotations

import logging
import os
import uuid
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from edge.config import Config
from edge.errors import ConfigError
from edge.geometry import CameraModel, Grid
from edge.host.worker import Worker
from edge.loop.result import Event, TickResult
from edge.sinks.drawings import Drawing, PathRing, boxes_of, drawing_of
from edge.sinks.rate_limiter import RateLimiter
from edge.text import one_line
from edge.types import CAMERAS, Detections, Observation

log = logging.getLogger("edge.sinks.rerun")

_POSE_HZ, _BOXES_HZ, _DRAWN_HZ = 10.0, 10.0, 1.0  # rates of the entities
_BATCH_HZ = 2.0  # a batch is written at once, because each wake of the thread delays a tick
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 80]
_CLOSE_S = 2.0  # longest time to write what is pending at the end
_MB = 1_000_000
_ROBOT = "map/robot"
_CAMERAS = tuple(f"{_ROBOT}/{name}" for name in CAMERAS)  # by `camera_index`


class _Entry(NamedTuple):
    """An entity to log.

    Attributes:
        make: makes its archetype, on the sink's thread.
    """

    entity: str
    make: Callable[[], Any]


class RerunSink:
    """Writes images, boxes, poses, map, objects, goal, path and events to one file.

    Args:
        file: path of the file (.rrd); one of an earlier run is overwritten.
        max_mb: size in MB at which writing ends.
        rgb_hz: rate of the images of each camera, as JPEG; 0: none.

    Raises:
        ConfigError: `rerun-sdk` is not installed, or the file cannot be written.
    """

    def __init__(
        self, config: Config, file: str = "edge.rrd", max_mb: float = 1024.0, rgb_hz: float = 5.0
    ) -> None:
        self._rr = _import_sdk()
        self._path, self._max_bytes = Path(file).expanduser(), int(max_mb * _MB)
        try:
            self._path.write_bytes(b"")
        except OSError as error:
            why = f"{one_line(file)}: cannot be written: {error.strerror}"
            raise ConfigError(f"sinks: rerun: file: {why}") from None
        self._stream = self._rr.RecordingStream("edge", recording_id=uuid.uuid4())
        self._stream.save(self._path)
        self._stream.log("map", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._images, map_hz = rgb_hz > 0, min(config.report.map_hz, _DRAWN_HZ)
        rates = {"pose": _POSE_HZ, "boxes": _BOXES_HZ, "rgb": max(rgb_hz, 1e-9)}
        rates |= {f"{name}2": hz for name, hz in rates.items()}  # of the second camera
        self._limiter = RateLimiter(map=map_hz, drawings=_DRAWN_HZ, batch=_BATCH_HZ, **rates)
        self._driven, self._is_full = PathRing(), False
        self._batch: list[tuple[int, list[_Entry]]] = []  # loop time and entries of ticks
        self._worker: Worker[list[tuple[int, list[_Entry]]], None] = Worker(
            "rerun-sink", self._write, finish_on_close=True
        )

    @staticmethod
    def check_options(file: str = "edge.rrd", max_mb: float = 1024.0, rgb_hz: float = 5.0) -> None:
        """Raise an error for invalid options or a missing SDK; see `edge.config.components`."""
        if not file.endswith(".rrd"):
            raise ConfigError(f"sinks: rerun: file: expected a name in .rrd, got {file!r:.80}")
        for name, value, least in (("max_mb", max_mb, 1), ("rgb_hz", rgb_hz, 0)):
            if not least <= value < 1e6:
                raise ConfigError(
                    f"sinks: rerun: {name}: expected a number, {least} or more, got {value!r:.40}"
                )
        _import_sdk()

    # -- on the loop's thread -------------------------------------------------------------------

    def tick(self, result: TickResult) -> None:
        """Copy what is due; see `edge.loop.result.Sink`."""
        if self._is_full:
            return
        now_ns, entries = result.now_ns, []
        if result.pose is not None:
            self._driven.add(result.pose)
        if result.observation is not None:
            entries += self._observed(result.observation, now_ns)
        found = result.detections
        if found is not None and self._is_due("boxes", found.observation, now_ns):
            entity = f"{_CAMERAS[found.observation.camera_index]}/boxes"
            entries.append(_Entry(entity, partial(self._boxes, found)))
        if self._limiter.take_turn("map", now_ns):
            entries.append(_Entry("map/grid", lambda: self._grid(result.snapshot())))
        if self._limiter.take_turn("drawings", now_ns):
            entries += self._drawn(drawing_of(result), self._driven.poses())
        entries += [_Entry("events", partial(self._event, event)) for event in result.events]
        self._batch.append((now_ns, entries))
        if self._limiter.take_turn("batch", now_ns):
            self._flush()

    def status(self) -> dict[str, Any]:
        """Return the file and worker statistics; see `edge.loop.result.Sink`."""
        status = {"file": str(self._path), **self._worker.stats.status()}
        return {**status, "problem": "the file has max_mb"} if self._is_full else status

    def close(self) -> None:
        """Write what is pending and complete the file."""
        self._flush()
        if self._worker.close(_CLOSE_S):
            self._stream.disconnect()

    def _flush(self) -> None:
        batch, self._batch = self._batch, []
        self._worker.enqueue(batch)

    def _is_due(self, name: str, observation: Observation, now_ns: int) -> bool:
        return self._limiter.take_turn(f"{name}2" if observation.camera_index else name, now_ns)

    def _observed(self, seen: Observation, now_ns: int) -> list[_Entry]:
        """Return the entries of an observation: pose of the robot, camera and image."""
        entries = []
        if self._is_due("pose", seen, now_ns):
            entries.append(_Entry(_ROBOT, partial(self._transform, seen.T_map_base)))
        if seen.rgb is None or seen.camera is None or not self._images:
            return entries
        if self._is_due("rgb", seen, now_ns):
            entity = _CAMERAS[seen.camera_index]
            entries += [
                _Entry(entity, partial(self._transform, seen.T_base_camera)),
                _Entry(entity, partial(self._pinhole, seen.camera)),
                _Entry(f"{entity}/image", partial(self._image, seen.rgb.copy())),
            ]
        return entries

    def _drawn(self, drawing: Drawing, driven: np.ndarray) -> list[_Entry]:
        return [
            _Entry("map/objects", partial(self._objects, drawing)),
            _Entry("map/frontiers", lambda: self._rr.Points3D(_flat(drawing.frontiers_m))),
            _Entry("map/driven", lambda: self._rr.LineStrips3D([_flat(driven[:, :2])])),
            _Entry("map/goal", partial(self._goal, drawing)),
        ]

    # -- on the worker's thread ------------------------------------------------------------------

    def _write(self, batch: list[tuple[int, list[_Entry]]]) -> None:
        """Log the entries of some ticks; end at `max_mb`."""
        if self._is_full:
            return
        for now_ns, entries in batch:
            self._stream.set_time("time", timestamp=np.datetime64(now_ns, "ns"))
            for entry in entries:
                self._stream.log(entry.entity, entry.make())
        if os.path.getsize(self._path) >= self._max_bytes:
            self._is_full = True
            log.warning("sinks: rerun: %s has max_mb: nothing more is written", self._path)

    def _transform(self, T: np.ndarray) -> Any:
        return self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _pinhole(self, camera: CameraModel) -> Any:
        return self._rr.Pinhole(
            focal_length=(camera.fx_px, camera.fy_px),
            principal_point=(camera.cx_px, camera.cy_px),
            resolution=(camera.width_px, camera.height_px),
        )

    def _image(self, rgb: np.ndarray) -> Any:
        jpeg = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), _JPEG)[1]
        return self._rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")

    def _boxes(self, found: Detections) -> Any:
        names = zip(found.class_id.tolist(), found.score.tolist(), strict=True)
        labels = [f"{found.prompts[k]} {score:.2f}" for k, score in names]
        xyxy_px = found.xyxy_px.reshape(-1, 4)
        return self._rr.Boxes2D(
            array=xyxy_px, array_format=self._rr.Box2DFormat.XYXY, labels=labels
        )

    def _grid(self, grid: Grid) -> Any:
        height, width = grid.cells.shape
        if grid.cells.size == 0:
            return self._rr.Clear(recursive=False)
        components = self._rr.components
        return self._rr.GridMap(
            data=np.flipud(grid.cells).tobytes(),  # Rerun's first row has the highest y
            format=components.ImageFormat(
                width=width, height=height, color_model="L", channel_datatype="U8"
            ),
            cell_size=grid.resolution_m,
            translation=(*map(float, grid.origin_xy_m), 0.0),
            colormap=components.Colormap.RvizMap,
        )

    def _objects(self, drawing: Drawing) -> Any:
        boxes = boxes_of(drawing)
        return self._rr.Boxes3D(
            centers=[box.center_m for box in boxes],
            sizes=[np.maximum(box.size_m, 0.1) for box in boxes],
            labels=[f"{box.name} {box.score:.2f}" for box in boxes],
        )

    def _goal(self, drawing: Drawing) -> Any:
        if drawing.goal is None:
            return self._rr.Clear(recursive=False)
        pose = drawing.goal.pose
        ahead = *pose.ahead(0.5), 0.0
        origin = np.array([pose.x_m, pose.y_m, 0.0])
        return self._rr.Arrows3D(origins=[origin], vectors=[np.array(ahead) - origin])

    def _event(self, event: Event) -> Any:
        return self._rr.TextLog(one_line(event.text, 1000), level="INFO")


def _flat(xy_m: np.ndarray) -> np.ndarray:
    """Return points (n, 2) on the floor as (n, 3)."""
    return np.column_stack((xy_m, np.zeros(len(xy_m))))


def _import_sdk() -> Any:
    try:
        import rerun
    except ImportError:
        raise ConfigError(
            "sinks: rerun: rerun-sdk is not installed: pip install 'edge-vln[rerun]'"
        ) from None
    return rerun
