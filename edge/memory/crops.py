"""Small pictures of objects: the best view of each, as JPEG, in limited memory."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence

import cv2
import numpy as np

from edge.host.checkpoint import Arrays, check_arrays
from edge.host.worker import Worker
from edge.perception.tracking.object_tracker import MAX_TRACKED, ObservedObject

SIDE_PX = 64
"""Longest side of a picture."""
MAX_CROPS = MAX_TRACKED
"""Largest number of pictures."""
MAX_CROP_BYTES = 16 << 20
"""Largest size of all pictures; beyond it the oldest are dropped. 5,000 of 2 kB are 10 MB."""
_QUALITY = 80  # of the JPEG
_LARGE_PX = 48
"""A box with this shorter side is large enough."""
_RIM_PX = 2  # a box this near to the image's edge counts as cut off
_MIN_GAIN = 1.25
"""A view replaces the last one if it is better by this factor, so that few pictures are encoded."""
_MAX_PER_IMAGE = 3  # largest number of views that are copied from one image
_MARGIN = 0.1
"""Margin on each side, as a share of the box."""

Crop = tuple[int, float, np.ndarray]
"""Id of the object, quality of the view, and (h, w, 3) uint8 RGB."""
_Stored = dict[int, tuple[float, bytes]]
"""Id of the object → quality of the view and JPEG."""


class CropStore:
    """The pictures of objects, by object id. A background thread encodes them.

    Attributes:
        changes: number of pictures that were stored or removed.
    """

    def __init__(self, inline: bool = False) -> None:
        self.changes = 0
        self._inline = inline
        self._worker: Worker[tuple[_Stored, Sequence[Crop]], None] | None = None
        self._lock = threading.Lock()
        self._jpeg: _Stored = {}
        self._n_bytes = 0
        self._renamed: dict[int, int] = {}  # `rename` of pictures that wait to be encoded
        self._best: dict[int, float] = {}  # best quality so far, stored or waiting, by object id

    def __len__(self) -> int:
        return len(self._jpeg)

    def get(self, object_id: int) -> bytes | None:
        """Return the JPEG of an object, or None."""
        found = self._jpeg.get(object_id)
        return None if found is None else found[1]

    def observe(self, seen: Sequence[ObservedObject], rgb: np.ndarray) -> None:
        """Copy the views that are better than the stored ones, at most `_MAX_PER_IMAGE`.

        Args:
            seen: objects in the image.
            rgb: (h, w, 3) uint8.
        """
        ratings = [(obj, quality(obj.score, obj.xyxy_px, *rgb.shape[:2])) for obj in seen]
        better = [pair for pair in ratings if pair[1] > _MIN_GAIN * self._best.get(pair[0].id, 0.0)]
        better.sort(key=lambda pair: self._best.get(pair[0].id, 0.0) / pair[1])
        crops: list[Crop] = []
        for obj, value in better[:_MAX_PER_IMAGE]:
            self._best[obj.id] = value
            crops.append((obj.id, value, _crop_box(obj.xyxy_px, rgb)))
        if crops:
            if self._worker is None:
                self._worker = Worker("crops", self._encode, inline=self._inline)
            self._worker.enqueue((self._jpeg, crops))

    def rename(self, ids: Mapping[int, int]) -> None:
        """Move pictures to another object, when a new object turned out to be a known one.

        The better picture of the two stays.

        Args:
            ids: id of the known object, by id of the new one.
        """
        if self._worker is None or self._worker.idle:
            self._renamed.clear()
        for new, old in ids.items():
            self._renamed.pop(old, None)
            self._renamed[new] = old
            if (value := self._best.pop(new, None)) is not None:
                self._best[old] = max(value, self._best.get(old, 0.0))
            with self._lock:
                picture = self._jpeg.pop(new, None)
                self._n_bytes -= 0 if picture is None else len(picture[1])
                if picture is not None and picture[0] >= self._jpeg.get(old, (0.0,))[0]:
                    self._store(self._jpeg, old, picture)

    def clear(self) -> None:
        """Remove all pictures; those that are being encoded are dropped."""
        self.changes += 1
        with self._lock:
            self._jpeg, self._best, self._n_bytes = {}, {}, 0
        if self._worker is not None:
            self._worker.discard_all()

    def close(self) -> None:
        """Stop the thread."""
        if self._worker is not None:
            self._worker.close()

    def snapshot(self) -> Callable[[], Arrays]:
        """Return a function that returns `state_dict` of now, on any thread."""
        with self._lock:
            jpeg = dict(self._jpeg)
        return lambda: _arrays_of(jpeg)

    def state_dict(self) -> Arrays:
        """Return all pictures as arrays: ids, qualities and sizes, and the JPEG bytes in a row."""
        return self.snapshot()()

    def load_state_dict(self, state: Arrays) -> None:
        """Load a `state_dict`.

        Raises:
            ValueError: the state is invalid.
        """
        max_rows = {("id", "quality", "n_bytes"): MAX_CROPS, ("jpeg",): MAX_CROP_BYTES}
        check_arrays(
            state, _arrays_of({}), max_rows, {"n_bytes": MAX_CROP_BYTES, "quality": 2}, ("id",)
        )
        if state["n_bytes"].sum() != len(state["jpeg"]):
            raise ValueError("pictures: the sum of n_bytes is not the size of jpeg")
        end = np.cumsum(state["n_bytes"])
        content = state["jpeg"].tobytes()
        for i, value, n, last in zip(
            *(state[name].tolist() for name in ("id", "quality", "n_bytes")), end.tolist(),
            strict=True,
        ):  # fmt: skip
            self._best[i] = value
            self._store(self._jpeg, i, (value, content[last - n : last]))

    def _encode(self, item: tuple[_Stored, Sequence[Crop]]) -> None:
        """Encode pictures and store them; on the worker's thread."""
        stored, crops = item
        for object_id, value, rgb in crops:
            scale = SIDE_PX / max(rgb.shape[:2])
            if scale < 1.0:
                size = tuple(max(1, round(scale * n)) for n in rgb.shape[1::-1])
                rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
            bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
            _, encoded = cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))
            with self._lock:
                while object_id in self._renamed:
                    object_id = self._renamed[object_id]
                if value > stored.get(object_id, (0.0, b""))[0]:
                    self._store(stored, object_id, (value, encoded.tobytes()))

    def _store(self, stored: _Stored, object_id: int, picture: tuple[float, bytes] | None) -> None:
        """Store a picture as the newest, and remove the oldest ones over the limits."""
        if picture is None or stored is not self._jpeg:  # cleared in between
            return
        self.changes += 1
        self._n_bytes -= len(stored.pop(object_id, (0.0, b""))[1])
        stored[object_id] = picture
        self._n_bytes += len(picture[1])
        while len(stored) > MAX_CROPS or self._n_bytes > MAX_CROP_BYTES:
            oldest = next(iter(stored))
            self._n_bytes -= len(stored.pop(oldest)[1])
            self._best.pop(oldest, None)


def quality(score: float, xyxy_px: np.ndarray, height_px: int, width_px: int) -> float:
    """Return the quality of a view in [0, 1]. The best view is a large, complete box."""
    x0, y0, x1, y1 = xyxy_px.tolist()
    size = min(1.0, max(0.0, min(x1 - x0, y1 - y0)) / _LARGE_PX)
    is_cut = min(x0, y0, width_px - x1, height_px - y1) < _RIM_PX
    return score * size * (0.5 if is_cut else 1.0)


def _crop_box(xyxy_px: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """Copy a box with a margin, thinned to at most twice `SIDE_PX`."""
    height, width = rgb.shape[:2]
    x0, y0, x1, y1 = xyxy_px.tolist()
    dx, dy = _MARGIN * (x1 - x0), _MARGIN * (y1 - y0)
    left, top = max(0, int(x0 - dx)), max(0, int(y0 - dy))
    right, bottom = min(width, int(x1 + dx) + 1), min(height, int(y1 + dy) + 1)
    step = max(1, max(right - left, bottom - top) // (2 * SIDE_PX))
    return np.ascontiguousarray(rgb[top:bottom:step, left:right:step])


def _arrays_of(jpeg: Mapping[int, tuple[float, bytes]]) -> Arrays:
    return {
        "id": np.array(list(jpeg), np.int64),
        "quality": np.array([value for value, _ in jpeg.values()], np.float64),
        "n_bytes": np.array([len(picture) for _, picture in jpeg.values()], np.int64),
        "jpeg": np.frombuffer(b"".join(picture for _, picture in jpeg.values()), np.uint8),
    }
