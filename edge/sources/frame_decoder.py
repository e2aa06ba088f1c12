"""Decoding of one camera's frames, and of clouds, into the arrays of a pool."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import numpy as np

from edge.bus.wire.images import drop_beyond
from edge.config import Config
from edge.geometry import CameraModel
from edge.sources.inputs import InputTable
from edge.sources.messages import (
    CameraInfo,
    Cloud,
    DepthImage,
    LaserScanFrame,
    SensorFrame,
    WrongSizeError,
)
from edge.sources.pool import FramePool, PoolSlot
from edge.sources.rectify import LensPlan, make_lens_plan
from edge.sources.streams import Stream
from edge.types import CAMERAS

log = logging.getLogger("edge.sources")

_NO_BEAM = "no beam has a valid range: NaN, 0 and -inf are invalid, +inf is valid (REP 117)"


class FrameDecoder:
    """Decodes and rectifies frames; for one thread.

    Args:
        camera_index: 0 for the first camera, 1 for the second.
        streams: the streams that are joined with the camera, by field.
        inputs: counts what is used.
        count: counts a drop: topic, reason, detail.

    Attributes:
        camera: intrinsics of the rectified images; None without usable camera info.
    """

    def __init__(
        self,
        config: Config,
        camera_index: int,
        streams: Mapping[str, Stream],
        inputs: InputTable,
        count: Callable[[str, str, object], None],
    ) -> None:
        self._source, self._index, self._streams = config.source, camera_index, streams
        self._inputs, self._count = inputs, count
        self.camera: CameraModel | None = None
        self._info: CameraInfo | None = None  # as received
        self._lens = LensPlan()
        self._pool: FramePool | None = None
        self._logged: set[tuple[str, str]] = set()  # (topic, text) that were logged
        # Some drivers send the end of the range in place of "no return". So this is the largest
        # float32 below the end of the range.
        farthest_m = np.float32(config.farthest_depth_m(config.sensors.cameras[camera_index]))
        self._max_depth_m = float(np.nextafter(farthest_m, np.float32(0)))

    @property
    def distortion(self) -> str:
        """See `Observation.distortion`."""
        return self._lens.distortion

    def use_camera_info(self, message: CameraInfo) -> None:
        """Use new camera info: plan the rectification, and drop the pool, whose size may change."""
        camera = message.camera
        if message == self._info:
            if self.camera is not None:
                self._inputs.on_used(message.topic)
            return
        size = camera.width_px * camera.height_px * 3
        if size > self._source.max_message_mb * 1e6:
            detail = f"{camera.width_px}x{camera.height_px} px"
            self._count(message.topic, "oversized", detail)
            return
        self._info, self.camera, self._pool = message, None, None
        if message.cut:
            self._log_once(
                message, f"{message.cut}: images of {camera.width_px}x{camera.height_px}"
            )
        where, listens = self._inputs.where, DepthImage.field in self._streams
        rgb, depth = (f"{CAMERAS[self._index]}/{name}" for name in ("rgb", "depth"))
        try:
            self._lens = make_lens_plan(
                message.lens, camera, self._source.distortion, where(rgb),
                where(depth) if listens else None,
            )  # fmt: skip
        except ValueError as error:
            self._count(message.topic, "distorted", error)
            return
        if message.lens is not None:
            # A guess that the user should see: the images may be rectified already.
            is_guess = self._lens.distortion == "rectified"
            level = logging.WARNING if is_guess else logging.INFO
            self._log_once(message, self._lens.log_line, level)
        self.camera = camera
        self._inputs.on_used(message.topic)

    def _log_once(self, message: CameraInfo, text: str, level: int = logging.WARNING) -> None:
        """Log once how camera info is used."""
        if (message.topic, text) not in self._logged:
            self._logged.add((message.topic, text))
            log.log(level, "%s: %s", message.topic, text)

    def acquire(self) -> PoolSlot | None:
        """Return a free slot; allocate the pool at the first call."""
        if self._pool is None:
            camera = self.camera
            self._pool = FramePool(
                self._source.pool_slots,
                image_hw=(camera.height_px, camera.width_px) if camera is not None else None,
                cloud_points=self._source.max_cloud_points if "cloud_m" in self._streams else 0,
                depth="depth_m" in self._streams,
            )
        return self._pool.acquire()

    def decode(self, frames: list[SensorFrame], slot: PoolSlot) -> dict[str, np.ndarray] | None:
        """Return the observation's arrays by field, decoded into the slot.

        Return None if the first frame, or one that is required, cannot be decoded.
        """
        fields: dict[str, np.ndarray] = {}
        for frame in frames:
            array = self._decode_frame(frame, slot)
            if array is not None:
                fields[frame.field] = array
            elif frame is frames[0] or self._streams[frame.field].required:
                return None
        return fields

    def _decode_frame(self, frame: SensorFrame, slot: PoolSlot) -> np.ndarray | None:
        """Return a frame's array, decoded into the slot; None (and counted) if that fails."""
        out = getattr(slot, frame.field)
        try:
            n = self._lens.decode(frame, out)
        except ValueError as error:
            reason = "wrong_size" if isinstance(error, WrongSizeError) else "malformed"
            self._count(frame.topic, reason, error)
            return None
        if n == 0:
            detail = _NO_BEAM if isinstance(frame, LaserScanFrame) else ""
            self._count(frame.topic, "empty", detail)
            return None
        if isinstance(frame, DepthImage):
            drop_beyond(out, self._max_depth_m)
        return out[:n] if isinstance(frame, Cloud) else out
