"""Ground truth of the simulator: found by stamp, whatever else comes on its topics."""

from __future__ import annotations

import json

import numpy as np
import pytest
from fake_zenoh import Flooded
from simulated import simulated

from edge.bus.wire import messages
from edge.perception.detection.sim import Segmentation
from edge.sources.truth import SegmentationInbox, parse_labels

MS = 1_000_000
LABELS = b'["chair", "bed"]'


class Simulator:
    """A session on which a simulator's words are ready."""

    def __init__(self, pictures=(), labels=()) -> None:
        self._sent = {
            "edge/sim/segmentation": Flooded("edge/sim/segmentation", pictures),
            "edge/sim/labels": Flooded("edge/sim/labels", labels),
        }

    def declare_subscriber(self, key: str, ring: object) -> Flooded:
        return self._sent[key]


def picture(stamp_ms: int, value: int = 1) -> bytes:
    return messages.encode_image(stamp_ms * MS, "camera", np.full((2, 3), value, np.uint16))


def at(inbox: SegmentationInbox, stamp_ms: int) -> int | None:
    found = inbox.at(stamp_ms * MS)
    return None if found is None else int(found.ids[0, 0])


def test_an_empty_inbox_returns_nothing():
    assert SegmentationInbox(simulated(), Simulator()).at(0) is None


def test_the_inbox_keeps_the_newest_images_in_a_flood():
    inbox = SegmentationInbox(simulated(), Simulator(picture(100 * k, k) for k in range(10**9)))
    assert at(inbox, 700) == 7
    assert at(inbox, 1500) == 15
    assert at(inbox, 700) is None


def test_labels_and_nonsense():
    pictures = [b"", b"junk", picture(100)[:-1], b"\0\1\0\0" + b"\xff" * 40, picture(200)]
    inbox = SegmentationInbox(simulated(), Simulator(pictures, [b"{}", LABELS]))
    assert at(inbox, 200) == 1
    found = inbox.at(200 * MS)
    assert isinstance(found, Segmentation)
    assert found.labels == ("chair", "bed")
    with pytest.raises(ValueError, match=r"outside|bytes"):
        inbox.at(100 * MS)


@pytest.mark.parametrize(
    "payload", [b"", b"{}", b"[" * 10**5, b'["a", 3]']
    + [json.dumps(["tv", no_name]).encode() for no_name in ("-", "tv\n", "\x1b[2Jtv", "b" * 201)],
)  # fmt: skip
def test_invalid_labels_are_refused(payload):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        parse_labels(payload)
    assert str(caught.value).isprintable()
