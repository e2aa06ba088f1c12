"""Ground-truth segmentation from the simulator, for the detector `sim`."""

from __future__ import annotations

import logging
from collections import deque

import numpy as np
import zenoh

from edge import names
from edge.bus import topics
from edge.bus.session import Ring
from edge.bus.wire import DecodeError, messages
from edge.config import Config
from edge.perception.detection.sim import Segmentation, TruthAt
from edge.text import read_json

log = logging.getLogger("edge.sources.truth")

_KEPT = 8  # messages
_MAX_LABELS_BYTES = 1 << 20


class SegmentationInbox:
    """The newest segmentations of one camera, by stamp; for the detector's thread.

    The inbox polls only when an image is requested. A full ring is then normal, because not every
    image is searched.
    """

    def __init__(self, config: Config, session: zenoh.Session, camera_index: int = 0) -> None:
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        self._tolerance_ns = int(0.5e9 / config.sensors.cameras[camera_index].rate_hz)
        self._labels: tuple[str, ...] = ()  # as `parse_labels` returns them
        self._ids = np.zeros((0, 0), np.uint16)
        self._newest: deque[tuple[int, bytes]] = deque(maxlen=_KEPT)  # (stamp in ns, message)
        key = config.zenoh.key(topics.SEGMENTATIONS[camera_index].key)
        self._segmentations = session.declare_subscriber(key, zenoh.handlers.RingChannel(_KEPT))
        self._label_ring = Ring(session, config.zenoh.key(topics.LABELS.key), 1)

    def at(self, stamp_ns: int) -> Segmentation | None:
        """Return the segmentation of the image nearest to an instant; valid until the next call.

        Raises:
            ValueError: the message is malformed; one line.
        """
        self._receive()
        nearest = min(self._newest, key=lambda kept: abs(kept[0] - stamp_ns), default=None)
        if nearest is None or abs(nearest[0] - stamp_ns) > self._tolerance_ns:
            return None
        header = messages.decode_image_header(nearest[1])
        if self._ids.shape != (header.height, header.width):
            self._ids = np.zeros((header.height, header.width), np.uint16)
        messages.decode_image_into(nearest[1], header, self._ids)
        return Segmentation(self._ids, self._labels)

    def _receive(self) -> None:
        """Take the labels and segmentations that have arrived."""
        for sample in self._label_ring.take():
            try:
                self._labels = parse_labels(sample.payload.to_bytes())
            except ValueError as error:
                log.warning("%s: %s", topics.LABELS.key, error)
        for _ in range(_KEPT):
            if (sample := self._segmentations.try_recv()) is None:
                break
            if len(sample.payload) > self._max_bytes:
                continue
            payload = sample.payload.to_bytes()
            try:
                self._newest.append((messages.peek_stamp_ns(payload), payload))
            except DecodeError as error:
                log.debug("%s: %s", topics.SEGMENTATION.key, error)


def make_ground_truth(config: Config, session: zenoh.Session) -> TruthAt | None:
    """Return the ground truth for the detector `sim`; None for other detectors."""
    if config.perception.detector.kind != "sim":
        return None
    inboxes = [SegmentationInbox(config, session, i) for i in range(len(config.sensors.cameras))]
    return lambda seen: inboxes[seen.camera_index].at(seen.stamp_ns)


def parse_labels(payload: bytes) -> tuple[str, ...]:
    """Parse a JSON list of names; the label of id i is at index i - 1.

    Raises:
        ValueError: with one line that names the fault.
    """
    if len(payload) > _MAX_LABELS_BYTES:
        raise ValueError(
            f"a list of labels with {len(payload)} bytes, at most {_MAX_LABELS_BYTES} are allowed"
        )
    labels = read_json(payload)
    if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
        raise ValueError("not a JSON list of words")
    for label in labels:
        names.normalise(label)
    return tuple(labels)
