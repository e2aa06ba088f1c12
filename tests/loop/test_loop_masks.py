"""Masks in an entire run: made in the detector, used to lift, reported, and the same each time."""

from __future__ import annotations

import numpy as np
from simulated import simulated

from edge.lab.eval.closed_loop import ClosedLoop, wants_colour
from edge.loop.status import status_message

STEPS = 6


def settings(segmenter):
    return simulated(
        {
            "loop": {"lockstep": True},
            "sim": {"lockstep": True},
            "mission": {"target": "sofa"},
            "perception": {"segmenter": segmenter},
        }
    )


class Seen:
    """A sink that keeps the detections."""

    def __init__(self):
        self.detections = []

    def tick(self, result):
        self.detections += [] if result.detections is None else [result.detections]

    def close(self): ...


def seen_by(config):
    """Return detections of a few steps, and the segmenter's status."""
    loop = ClosedLoop(config, sinks=[sink := Seen()])
    for _ in range(STEPS):
        loop.step()
    status = status_message(loop.service.result())["segmenter"]
    loop.close()
    return sink.detections, status


def test_masks_come_with_detections_and_replay_identically():
    config = settings({"kind": "grabcut"})
    assert wants_colour(config)
    (seen, status), (again, _) = seen_by(config), seen_by(config)
    assert status["made"] > 0
    assert (status["late"], status["failed"]) == (0, 0)
    assert len(seen) == len(again) == STEPS
    for one, other in zip(seen, again, strict=True):
        assert len(one.mask) == len(one)
        np.testing.assert_array_equal(one.mask, other.mask)
