"""What masks are worth to lifting, where a thing stands behind another in one box.

python -m exporters.mask_study [HOUSES.jsonl.gz] [--houses N] [--first K]

Without a file the houses are generated ones, from seed `--first` on. Views are taken all over each
house; the simulator tells which thing each pixel shows. A box is `hidden` where other things, at
least 0.3 m nearer than its own, have at least 15 % of it, else `plain`. Each box is lifted in the
same frame without masks, with GrabCut's, and with the simulator's own, which is as well as any
segmenter can do; with the boxes of all else as context, and alone. The error is how far from the
thing's footprint the lifted centre lies.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from time import thread_time

import numpy as np

from edge import config
from edge.eval.intervals import Interval, bootstrap
from edge.perception import kernels
from edge.perception.lift import Lifter
from edge.perception.masks.masker import Masker, make_segmenter
from edge.perception.masks.segmenter import Deadline, rasterise
from edge.sim.base import World, WorldError, free_poses
from edge.sim.generator.house import HELD_OUT, generated_house
from edge.sim.house import build_house
from edge.sim.procthor import build_procthor, read_houses
from edge.sim.sensors import CameraRig
from edge.types import ContextBoxes, Detections, Observation
from exporters.files import tells_errors

LEAST_PX, MOST_M, JITTER = 40, 6.0, 0.05
NEARER_M, HIDDEN = 0.3, 0.15
FAR_M = 1.0
_PLAIN_OF_A_VIEW = 4
ARMS = ("none", "grabcut", "truth")


class TrueMasks:
    """The simulator's own masks, in the place of a segmenter's."""

    name = "truth"

    def __init__(self) -> None:
        self.ids, self.wanted = np.zeros((1, 1), np.uint16), 0

    def segment(
        self, rgb: np.ndarray, boxes: np.ndarray, out: np.ndarray, deadline: Deadline
    ) -> int:
        """Of one box, of the thing `wanted`."""
        rasterise((self.ids == self.wanted) - np.float32(0.5), (0, 0), (1, 1), boxes[0], out[0])
        return 1

    def close(self) -> None:
        """Nothing to let go."""


class Study:
    """Errors by arm, with and without context, of the boxes of one view after another."""

    def __init__(self) -> None:
        grabcut = config.SegmenterGrabcut()
        self._truth = TrueMasks()
        self._maskers = {
            "none": None,
            "grabcut": Masker(make_segmenter(grabcut), grabcut, timed=False),
            "truth": Masker(self._truth, grabcut, timed=False),
        }
        self._lifter = Lifter(config.Perception(detector=config.DetectorSim()))
        self.house: list[int] = []
        self.hidden: list[bool] = []
        self.error_m: list[list[list[float]]] = []
        self.grabcut_ms: list[float] = []
        self.iou: list[float] = []

    def see(self, house: int, world: World, rig: CameraRig, seen: Observation,
            random: np.random.Generator) -> None:  # fmt: skip
        """Lift the boxes of one view: all that are hidden, and a few of the others."""
        n, (h, w) = len(world.objects), rig.ids.shape
        box, pixels = np.empty((n, 4), np.int32), np.empty(n, np.int32)
        distance = np.empty(n, np.float32)
        kernels.object_boxes(rig.ids, rig.depth_m, box, pixels, distance)
        there = np.flatnonzero((pixels >= LEAST_PX) & (distance > 0) & (distance <= MOST_M))
        size = np.tile(box[:, 2:] - box[:, :2], 2)
        boxes = box + random.uniform(-JITTER, JITTER, (n, 4)) * size
        boxes = np.clip(boxes, 0, (w, h, w, h)).astype(np.float32)
        labels = tuple(dict.fromkeys(world.objects[i].label for i in there))
        word = {i: labels.index(world.objects[i].label) for i in there}
        plain = 0
        self._truth.ids = rig.ids
        for i in there:
            hidden = self._is_hidden(rig, boxes[i], i)
            if hidden is None or (not hidden and plain == _PLAIN_OF_A_VIEW):
                continue
            plain += not hidden
            others = [j for j in there if word[j] != word[i]]
            context = ContextBoxes(
                boxes[others], np.ones(len(others), np.float32),
                np.array([word[j] for j in others], np.int32), labels,
            )  # fmt: skip
            one = np.ones(1, np.float32)
            found = Detections(
                seen, boxes[[i]], one, np.zeros(1, np.int32), ("target",), context=context
            )
            self.house.append(house)
            self.hidden.append(hidden)
            self.error_m.append(self._errors(found, world, int(i)))

    def _is_hidden(self, rig: CameraRig, box: np.ndarray, i: int) -> bool | None:
        """None: too little of the thing is left in its box."""
        x0, y0, x1, y1 = box.astype(int)
        ids, depth = rig.ids[y0 : y1 + 1, x0 : x1 + 1], rig.depth_m[y0 : y1 + 1, x0 : x1 + 1]
        mine = ids == i + 1
        if mine.sum() < LEAST_PX:
            return None
        nearer = (ids > 0) & ~mine & (depth < np.nanmedian(depth[mine]) - NEARER_M)
        return bool(nearer.mean() >= HIDDEN)

    def _errors(self, found: Detections, world: World, i: int) -> list[list[float]]:
        """By arm, with context and alone; NaN where it could not be lifted."""
        self._truth.wanted, rows, masks = i + 1, [], {}
        for arm, masker in self._maskers.items():
            begin_s = thread_time()
            masked = found if masker is None else masker.add(found)
            if arm == "grabcut":
                self.grabcut_ms.append(1e3 * (thread_time() - begin_s))
            masks[arm] = masked.mask
            row = []
            for context in (found.context, None):
                detections = Detections(
                    found.observation, found.xyxy_px, found.score, found.class_id, found.prompts,
                    context=context, mask=masked.mask,
                )  # fmt: skip
                lifted, _ = self._lifter.lift(detections)
                x_m, y_m, _ = lifted.center_m[0]
                error_m = world.objects[i].distance_m(float(x_m), float(y_m))
                row.append(error_m if lifted.valid[0] else np.nan)
            rows.append(row)
        both = (masks["grabcut"] & masks["truth"]).sum()
        self.iou.append(float(both / max(1, (masks["grabcut"] | masks["truth"]).sum())))
        return rows


@tells_errors
def main(argv: list[str] | None) -> None:
    """Lift the same boxes with and without masks."""
    parser = argparse.ArgumentParser(
        prog="python -m exporters.mask_study", description=main.__doc__
    )
    parser.add_argument("file", type=Path, nargs="?", help="houses, .jsonl or .jsonl.gz")
    parser.add_argument("--houses", type=int, default=30)
    parser.add_argument("--first", type=int, help=f"by default 0, of generated ones {HELD_OUT}")
    parser.add_argument("--views", type=int, default=40, help="of each house")
    args = parser.parse_args(argv)
    study, settings = Study(), config.load("demo")
    for number, world in enumerate(_worlds(args.file, args.first, args.houses, settings)):
        rig, random = CameraRig(settings, world), np.random.default_rng(number)
        try:
            poses = free_poses(world, args.views, 7, settings.robot.radius_m)
        except WorldError as error:
            print(f"passed over: {error}", file=sys.stderr)
            continue
        for pose in poses:
            rig.look(pose)
            seen = Observation(
                0, 0, pose.matrix(), rig.rgb, rig.depth_m, rig.model, rig.T_base_camera
            )
            study.see(number, world, rig, seen, random)
    tell(study)


def _worlds(
    file: Path | None, first: int | None, count: int, settings: config.Config
) -> Iterator[World]:
    if file is None:
        begin = HELD_OUT if first is None else first
        for seed in range(begin, begin + count):
            yield build_house(generated_house(seed), settings)
    else:
        for house in islice(read_houses(file), first or 0, (first or 0) + count):
            yield build_procthor(house, settings)


def tell(study: Study) -> None:
    """Print a table; intervals by resampling whole houses."""
    error_m = np.array(study.error_m).reshape(-1, len(ARMS), 2)
    hidden, house = np.array(study.hidden, bool), np.array(study.house, int)
    ms = np.array(study.grabcut_ms)
    took = f"{np.median(ms):.2f} ms a box (p95 {np.quantile(ms, 0.95):.2f})"
    print(f"{len(set(house))} houses; grabcut: {took}, IoU with the truth {np.mean(study.iou):.2f}")
    print("boxes   context  masks    n     not lifted  median m  90 % m  over 1 m, %        "
          "less than none, %")  # fmt: skip
    for kind, rows in (("hidden", hidden), ("plain", ~hidden)):
        for k, context in enumerate(("all", "none")):
            some = error_m[rows][:, :, k]
            lifted = np.isfinite(some).all(axis=1)
            some, cluster = some[lifted], np.unique(house[rows][lifted], return_inverse=True)[1]
            far = (some > FAR_M).astype(float)
            for a, arm in enumerate(ARMS):
                above = np.stack([far[:, a], far[:, 0] - far[:, a]])
                share, gain = bootstrap(above, np.ones_like(above), cluster)
                print(f"{kind:7} {context:8} {arm:8} {len(some):5} {int((~lifted).sum()):11} "
                      f"{np.median(some[:, a]):9.2f} {np.quantile(some[:, a], 0.9):7.2f}  "
                      f"{_percent(share):19} {_percent(gain) if a else '-'}")  # fmt: skip


def _percent(x: Interval) -> str:
    return f"{100 * x.value:.1f} [{100 * x.low:.1f}, {100 * x.high:.1f}]"


if __name__ == "__main__":
    sys.exit(main())
