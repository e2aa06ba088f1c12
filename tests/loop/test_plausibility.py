"""The plausibility stage: a robot whose data is wrong stands, says why, and drives on later."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated import simulated

from edge.eval.closed_loop import ClosedLoop
from edge.types import Observation

Tamper = Callable[[Observation], Observation]
SMALL = {"width_px": 160, "height_px": 128, "rate_hz": 10.0}


def driving(**sections: Any) -> ClosedLoop:
    """A robot at speed, in a house that holds nothing it looks for."""
    data = {
        "loop": {"lockstep": True}, "mission": {"target": "surfboard"},
        "sensors": {"camera": SMALL}, **sections,
    }  # fmt: skip
    loop = ClosedLoop(simulated(data))
    while loop.drive.motion.v_mps < 0.45:
        loop.step()
    return loop


def tampered(loop: ClosedLoop, tamper: Tamper) -> Callable[[], None]:
    """Let the loop see other data from now on, until what is returned is called."""
    true = loop.observe
    loop.observe = lambda: tamper(true())
    return lambda: setattr(loop, "observe", true)


def always(**fields: Callable[[Observation], np.ndarray]) -> Callable[[], Tamper]:
    return lambda: lambda seen: replace(seen, **{k: make(seen) for k, make in fields.items()})


def frozen(*fields: str) -> Callable[[], Tamper]:
    """The first of these arrays again and again."""

    def make() -> Tamper:
        first: dict[str, np.ndarray] = {}

        def tamper(seen: Observation) -> Observation:
            for name in fields:
                first.setdefault(name, getattr(seen, name).copy())
            return replace(seen, **first)

        return tamper

    return make


def late(frames: int) -> Callable[[], Tamper]:
    """Observations of so many frames ago, under their own stamps."""

    def make() -> Tamper:
        kept: deque[Observation] = deque(maxlen=frames + 1)

        def tamper(seen: Observation) -> Observation:
            kept.append(replace(seen, rgb=seen.rgb.copy(), depth_m=seen.depth_m.copy()))
            return replace(kept[0], lag_ns=seen.stamp_ns - kept[0].stamp_ns)

        return tamper

    return make


TAMPERED = {
    "frozen": (frozen("rgb", "depth_m"), "camera/depth: the same to the bit"),
    "depth frozen": (frozen("depth_m"), "camera/depth: the same to the bit"),
    "colour frozen": (frozen("rgb"), "camera/rgb: the same to the bit"),
    "depth zero": (always(depth_m=lambda o: np.zeros_like(o.depth_m)), "camera/depth: only 0.0%"),
    "depth NaN": (always(depth_m=lambda o: o.depth_m * np.float32(np.nan)), "camera/depth: only"),
    "black": (always(rgb=lambda o: np.zeros_like(o.rgb)), "camera/rgb: the image has one colour"),
    "grey": (always(rgb=lambda o: np.full_like(o.rgb, 128)), "camera/rgb: the image has one"),
    "dark": (always(rgb=lambda o: o.rgb // 32), "camera/rgb: the image is dark"),
    "millimetres": (always(depth_m=lambda o: o.depth_m * 1000), "cannot be in metres"),
    "late": (late(20), "sensors: frames come"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "why"), TAMPERED.values(), ids=TAMPERED)
def test_a_robot_with_wrong_data_stands_says_why_and_drives_on_when_it_is_right(make, why):
    loop = driving()
    before, begun_s, path_m, stood = len(loop.notes.events), loop.seconds, 0.0, None
    restore = tampered(loop, make())
    last = loop.drive.motion.pose
    while loop.seconds < begun_s + 6.0:
        loop.step()
        motion = loop.drive.motion
        path_m += math.dist((motion.pose.x_m, motion.pose.y_m), (last.x_m, last.y_m))
        last = motion.pose
        if stood is None and motion.v_mps == 0.0 and loop.service.goal is None:
            stood = loop.seconds - begun_s, path_m
    assert stood is not None
    assert stood[0] <= 1.5 or stood[1] <= 0.5
    assert path_m - stood[1] < 0.1, "it drove on, or back"
    assert any(why in event and "standing still" in event for event in loop.notes.events[before:])
    restore()
    while loop.drive.motion.v_mps < 0.3 and loop.seconds < begun_s + 30.0:
        loop.step()
    assert loop.drive.motion.v_mps >= 0.3
    assert loop.service.plausibility.failed == ()
