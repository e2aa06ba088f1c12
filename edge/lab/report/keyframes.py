"""Selection of the few camera images of a run that its report shows."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from edge import names
from edge.lab.report.record import Keyframe
from edge.types import Detections

FRAMES = 8  # most frames in a report
FRAME_NS = 1_000_000_000  # least time between two frames
BETTER_SCORE = 0.05  # a frame shows a target better if its score is higher by more than this
MAX_FRAME_PX = 640  # longest side of a kept image


class KeyframeBuffer:
    """Keeps at most `capacity` frames: half are the best views of targets, the rest are the newest.

    Several targets take turns for the best views. Frames without boxes are dropped first.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._n_best = (capacity + 1) // 2
        self._frames: list[Keyframe] = []
        self._taken_ns: int | None = None

    def offer(self, detections: Detections, targets: Collection[str]) -> None:
        """Keep a copy of the image, if the newest kept one is at least `FRAME_NS` old.

        Before that time, an image that shows a target better replaces the newest kept one.
        """
        if self._capacity == 0 or detections.observation.rgb is None:
            return
        stamp_ns = detections.observation.stamp_ns
        is_soon = self._taken_ns is not None and 0 <= stamp_ns - self._taken_ns < FRAME_NS
        if is_soon:
            if not self._better_than_last(detections, targets):
                return
            self._frames = [f for f in self._frames if f.stamp_ns != self._taken_ns]
        self._frames.append(_copy(detections, targets))
        self._taken_ns = stamp_ns
        if len(self._frames) > self._capacity:
            self._frames.remove(self._next_to_drop())

    def _better_than_last(self, detections: Detections, targets: Collection[str]) -> bool:
        last = [f.target_score for f in self._frames if f.stamp_ns == self._taken_ns]
        return _target_score(detections, targets) > (last[0] if last else 0.0) + BETTER_SCORE

    def _next_to_drop(self) -> Keyframe:
        """Return the least useful frame that is no best view."""
        best = self._best_views()
        others = [f for f in self._frames if not any(f is b for b in best)]
        # Frames without boxes first, then the oldest.
        return min(others, key=lambda f: (len(f.labels) > 0, f.stamp_ns))

    def _best_views(self) -> list[Keyframe]:
        """Return the best view of each target, then the second best of each, and so on.

        At most `_n_best` frames are returned.
        """
        # (k, -score, -stamp, frame): the frame is the k-th best view of a label, from 0.
        ranks: list[tuple[int, float, int, Keyframe]] = []
        for label in dict.fromkeys(label for f in self._frames for label in f.best):
            views = [f for f in self._frames if label in f.best]
            views.sort(key=lambda f: (-f.best[label], -f.stamp_ns))
            ranks += [(k, -f.best[label], -f.stamp_ns, f) for k, f in enumerate(views)]
        ranks.sort(key=lambda rank: rank[:3])
        # Each frame once, in this order.
        return list({id(f): f for *_, f in ranks}.values())[: self._n_best]

    def frames(self) -> tuple[Keyframe, ...]:
        """Return the kept frames in order of time."""
        return tuple(sorted(self._frames, key=lambda f: f.stamp_ns))


def _target_score(detections: Detections, targets: Collection[str]) -> float:
    """Return the score of the best box of a target; 0 without one."""
    wanted = [
        i for i, prompt in enumerate(detections.prompts) if names.same_as_any(prompt, targets)
    ]
    if not wanted or not len(detections):
        return 0.0
    return float(detections.score[np.isin(detections.class_id, wanted)].max(initial=0.0))


def _copy(detections: Detections, targets: Collection[str]) -> Keyframe:
    """Return the image and its boxes, downsampled to at most `MAX_FRAME_PX`."""
    rgb = detections.observation.rgb
    assert rgb is not None  # `KeyframeBuffer.offer` has checked
    stride = -(-max(rgb.shape[:2]) // MAX_FRAME_PX)  # rounded up
    labels = tuple(detections.prompts[i] for i in detections.class_id)
    return Keyframe(
        detections.observation.stamp_ns,
        np.array(rgb[::stride, ::stride]),
        detections.xyxy_px / np.float32(stride),
        np.array(detections.score),
        labels,
        np.array([names.same_as_any(label, targets) for label in labels], dtype=bool),
    )
