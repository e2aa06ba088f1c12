"""A quarter of an hour of missions in one house, in one service, in simulated time: `python
mission_soak.py` prints what went wrong and what the process has grown to."""

from __future__ import annotations

import itertools
import json

from fresh_process import descriptors, resident_mb
from simulated import simulated

from edge.eval.closed_loop import START_NS, ClosedLoop
from edge.mission.brief import prepare

# Kinds of the built-in house, and two that are not there.
PRESENT = (
    "toilet", "bed", "sofa", "television", "refrigerator", "desk", "wardrobe", "washing machine",
    "bathtub", "microwave", "armchair", "laptop", "trash can", "houseplant",
)  # fmt: skip
ABSENT = ("surfboard", "piano")
MISSIONS = (*PRESENT[:5], ABSENT[0], *PRESENT[5:10], ABSENT[1], *PRESENT[10:])
SOAK_S = 900.0
SETTLED = 4  # missions after which caches are filled


def start() -> ClosedLoop:
    config = {
        "loop": {"lockstep": True},
        "sim": {"lockstep": True},
        "sensors": {"camera": {"width_px": 160, "height_px": 128}},
        "perception": {"detector": {"kind": "sim", "false_positive_rate": 0.001}},
        "mission": {"target": MISSIONS[0], "time_limit_s": 600.0, "path_limit_m": 300.0},
    }
    return ClosedLoop(simulated(config))


def run(loop: ClosedLoop, target: str, first: bool) -> str:
    """One mission to its end; "" or what is wrong with that end."""
    if not first:
        brief = prepare(loop.config.mission.model_copy(update={"target": target}))
        loop.service.begin(brief, loop.drive.motion.stamp_ns)
    while not loop.service.status.done:
        loop.step()
    status = loop.service.status
    if target in ABSENT:
        told = status.reason.startswith(
            ("explored all that can be reached, looked", "no way to the")
        )
        why, _, _ = status.reason.partition("; held up at ")
        return "" if told and why.endswith(f"found no {target}") else str(status)
    there = status.phase == "reached" and loop.distance_m(target) <= 1.0
    return "" if there else str(status)


def soak() -> dict:
    """Megabytes and descriptors are those after `SETTLED` missions, and after all."""
    loop, wrong, sizes = start(), [], []
    for count, target in enumerate(itertools.cycle(MISSIONS), start=1):
        if trouble := run(loop, target, count == 1):
            wrong.append(trouble)
        soaked_s = (loop.drive.motion.stamp_ns - START_NS) * 1e-9
        over = count >= len(MISSIONS) and soaked_s >= SOAK_S
        if count == SETTLED or over:
            sizes.append((resident_mb(), descriptors()))
        if over:
            break
    resident, opened = zip(*sizes, strict=True)
    return {
        "wrong": wrong,
        "collisions": loop.drive.motion.collisions,
        "resident_mb": resident,
        "descriptors": opened,
    }


if __name__ == "__main__":
    print(json.dumps(soak()))
