"""Training data of the choice model: views of a robot that explores generated houses.

    views = load_views(make_views(range(100), Path("..."), workers=2))

A view is an image, the frontiers at that time, and the true distance from each to every kind of
object. Frontiers in the image are marks. The robot searches for an object that the house does not
have, so it explores the entire house.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from edge import names
from edge.config import Camera, parse
from edge.host.files import replace_atomically
from edge.lab.eval import geodesic
from edge.lab.eval.closed_loop import ClosedLoop
from edge.lab.eval.metrics import REACHED_M
from edge.lab.sim.base import World, free_poses
from edge.lab.sim.generator.house import HELD_OUT
from edge.lab.sim.worlds import load_world
from edge.loop.result import TickResult
from edge.perception.scoring.choice.picture import visible_marks
from edge.perception.scoring.choice.question import MAX_MARKS
from edge.policies.base import FRONTIER
from exporters.training.mini import looks

ABSENT = "piano"
"""No generated house has one."""
POLICIES = ("nearest_frontier", "search")
"""Policies to explore with, in turn: one prefers near frontiers, the other large ones."""
EXPLORE_S = 200.0
"""Longest exploration of a house."""
STEP_S = 0.1
"""Simulated period of the controller."""
TICK_EVERY = 8
"""The service ticks once in this many periods of the controller."""
HW = (256, 320)
"""Height and width of the stored images [px]."""
COARSE = 2
"""The robot maps and detects with images that are smaller than `HW` by this factor."""
SNAP_M = 0.6
"""Largest distance from a frontier to the nearest cell where the robot fits."""
SEEN_PX = 10
"""An object counts as seen with at least this many pixels in the smaller image (`COARSE`)."""
SEEN_M = 6.0
"""Pixels of an object that are farther away do not count."""
NEVER, BEFORE, NOW = 0, 1, 2
"""Values of `Views.seen`."""
_KEY = 31  # added to the seed of the start pose, so that it differs from other draws


@dataclass(frozen=True, slots=True)
class Views:
    """Views of one or more houses: n views, t kinds of object (`looks.CATEGORIES`).

    `left` is the distance that is left to drive, not a side.

    Attributes:
        png: (n,) object, the encoded images, BGR as OpenCV writes them.
        house: (n,) int32, seed of the house.
        count: (n,) uint8, number of marks, at least 1.
        marks: (n, MAX_MARKS, 4) float32: u and v [px], bearing [rad], distance [m]; 0 beyond
            `count`.
        path_m: (n, MAX_MARKS) float32, driving distance from the robot to the mark on its own map.
        gain_m2: (n, MAX_MARKS) float32, unknown area that the robot would see at the mark [m²].
        others: (n, 3) float32, figures of the frontiers without a mark: number, least `path_m` (0
            if there are none), largest `gain_m2`.
        left_m: (n, MAX_MARKS, t) float32, true driving distance from a mark to the nearest object
            of the kind; inf if there is none.
        else_m: (n, t) float32, least `left_m` of all frontiers without a mark.
        else_path_m: (n, t) float32, least `path_m` + `left_m` of these frontiers.
        here_m: (n, t) float32, true driving distance from the robot to the nearest object of the
            kind.
        seen: (n, t) uint8, when an object of the kind was seen: `NEVER`, `BEFORE` or `NOW`.
        lift: (n, MAX_MARKS, t) float32, likelihood ratio (`edge.loop.scoring.prior`) for each mark,
            from the objects seen so far. Only in held-out houses, since it takes time; 1 elsewhere.
    """

    png: np.ndarray
    house: np.ndarray
    count: np.ndarray
    marks: np.ndarray
    path_m: np.ndarray
    gain_m2: np.ndarray
    others: np.ndarray
    left_m: np.ndarray
    else_m: np.ndarray
    else_path_m: np.ndarray
    here_m: np.ndarray
    seen: np.ndarray
    lift: np.ndarray

    def __len__(self) -> int:
        return len(self.house)

    def rgb(self, i: int) -> np.ndarray:
        """Return image i, (h, w, 3) uint8."""
        return cv2.cvtColor(cv2.imdecode(self.png[i], cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


class _Collector:
    """Sink of the service that stores a view at each tick whose image shows a frontier.

    Attributes:
        loop: the running service and robot; set before the first tick.
        rows: one tuple for each view so far, in the order of the fields of `Views`.
    """

    def __init__(self, seed: int, world: World, radius_m: float) -> None:
        self._seed, self._world = seed, world
        self._camera = Camera(height_px=HW[0], width_px=HW[1]).intrinsics()
        self.loop: ClosedLoop | None = None
        self._seen = np.zeros(len(looks.CATEGORIES), bool)  # kinds seen so far
        labels = [names.canonical(o.label) for o in world.objects]
        # (objects,) index of the kind of each object of the house.
        self._kind = np.array([looks.CATEGORIES.index(label) for label in labels])
        # For each kind, the driving distance from every cell; None if the house has no such object.
        self._fields = [
            geodesic.distance_field(
                world.plan, [o for o, k in zip(world.objects, self._kind, strict=True) if k == t],
                radius_m, REACHED_M,
            )
            if t in self._kind else None
            for t in range(len(looks.CATEGORIES))
        ]  # fmt: skip
        self.rows: list[tuple] = []

    def tick(self, result: TickResult) -> None:
        observation, loop = result.observation, self.loop
        if observation is None or loop is None:
            return
        in_view = self._kinds_in_view(loop.rig.ids, loop.rig.depth_m)
        c = loop.service.map.pool.candidates  # arrays, of which the first c.n entries are valid
        is_frontier = (c.kind == FRONTIER) & ~c.blocked & np.isfinite(c.path_m)
        frontiers = np.flatnonzero(is_frontier[: c.n])
        xy_m, ids = c.xy_m[frontiers], c.id[frontiers]
        marks = visible_marks(observation, xy_m, ids)
        if marks:
            # Index of each mark among the frontiers.
            at = np.array([int(np.flatnonzero(ids == mark.id)[0]) for mark in marks])
            self._store_view(marks, at, xy_m, c.path_m[frontiers], c.gain_m2[frontiers], in_view)
        self._seen |= in_view

    def close(self) -> None:
        """Do nothing."""

    def _kinds_in_view(self, ids: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Return (t,) bool: True for each kind of object that the image shows.

        Args:
            ids: (h, w), number of the object at each pixel, from 1; 0 for none.
            depth_m: (h, w).
        """
        near = ids[depth_m < SEEN_M]
        px = np.bincount(near, minlength=1 + len(self._kind))[1:]
        in_view = np.zeros(len(looks.CATEGORIES), bool)
        in_view[self._kind[px >= SEEN_PX]] = True
        return in_view

    def _store_view(
        self,
        marks: tuple,
        at: np.ndarray,
        xy_m: np.ndarray,
        path_m: np.ndarray,
        gain_m2: np.ndarray,
        in_view: np.ndarray,
    ) -> None:
        """Add the row of a view, in the order of the fields of `Views`.

        Args:
            marks: marks in the image.
            at: (m,) index of each mark among the frontiers.
            xy_m: (k, 2), the frontiers.
            path_m: (k,), driving distances to the frontiers.
            gain_m2: (k,), expected unknown areas at the frontiers.
            in_view: (t,) bool, kinds of object in the image.
        """
        loop, t = self.loop, len(looks.CATEGORIES)
        assert loop is not None
        rig, pose = loop.rig, loop.drive.motion.pose
        # The robot's own image is smaller and has no colours: render the scene again.
        rgb, T_map_camera = np.empty((*HW, 3), np.uint8), pose.matrix() @ rig.T_base_camera
        unused = np.empty(HW, np.float32), np.empty(HW, np.uint16)  # depth and ids
        self._world.render(self._camera, T_map_camera, rgb, *unused)
        bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
        png = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
        left_m = self._left_m(xy_m)
        n, others = len(marks), np.setdiff1d(np.arange(len(xy_m)), at)  # frontiers without a mark
        # Arrays for all MAX_MARKS marks, of which the first n exist.
        mark, mark_path, mark_gain, mark_left = (
            np.zeros((MAX_MARKS, 4), np.float32), np.zeros(MAX_MARKS, np.float32),
            np.zeros(MAX_MARKS, np.float32), np.full((MAX_MARKS, t), np.inf, np.float32),
        )  # fmt: skip
        mark[:n] = [one[1:] for one in marks]  # without the id
        mark[:n, :2] = (mark[:n, :2] + 0.5) * COARSE - 0.5  # pixels of the larger image
        mark_path[:n], mark_gain[:n], mark_left[:n] = path_m[at], gain_m2[at], left_m[at]
        least_m = path_m[others].min() if len(others) else 0.0
        other_figures = (len(others), least_m, gain_m2[others].max(initial=0.0))
        total_m = left_m + path_m[:, None]  # from the robot to the object, by way of a frontier
        row = (
            png, self._seed, n, mark, mark_path, mark_gain, other_figures, mark_left,
            left_m[others].min(axis=0, initial=np.inf),
            total_m[others].min(axis=0, initial=np.inf),
            self._left_m(np.array([[pose.x_m, pose.y_m]]))[0],
            np.where(in_view, NOW, np.where(self._seen, BEFORE, NEVER)),
            self._likelihood_ratios(xy_m[at]),
        )  # fmt: skip
        self.rows.append(row)

    def _likelihood_ratios(self, xy_m: np.ndarray) -> np.ndarray:
        """Return the prior's likelihood ratios at the marks, (MAX_MARKS, t) float32."""
        n, out = len(xy_m), np.ones((len(looks.CATEGORIES), MAX_MARKS), np.float32)
        prior = self.loop.service.map.prior
        if prior is not None:
            for category, ratio in zip(looks.CATEGORIES, out, strict=True):
                prior.likelihood_ratio(category, np.ascontiguousarray(xy_m, np.float32), n, ratio)
        return out.T

    def _left_m(self, xy_m: np.ndarray) -> np.ndarray:
        """Return the true driving distances from places (n, 2) to each kind of object, (n, t).

        A place may be too near to an obstacle for the robot: it drives from a cell within `SNAP_M`.
        """
        plan, out = self._world.plan, np.full((len(xy_m), len(self._fields)), np.inf, np.float32)
        resolution_m = plan.grid.resolution_m
        reach = round(SNAP_M / resolution_m)
        for i, (x_m, y_m) in enumerate(xy_m.tolist()):
            cell = plan.grid.cell_of(x_m, y_m)
            if cell is None:
                continue
            r0, c0 = max(cell[0] - reach, 0), max(cell[1] - reach, 0)
            window = (slice(r0, cell[0] + reach + 1), slice(c0, cell[1] + reach + 1))
            rows, cols = np.indices(plan.clearance_m[window].shape)
            away = np.hypot(rows + r0 - cell[0], cols + c0 - cell[1]) * resolution_m
            for t, field in enumerate(self._fields):
                if field is not None:
                    out[i, t] = (field[window] + away).min()
        return out


def collect(seed: int) -> Views:
    """Return the views of a robot that explores the house of a seed, repeatably."""
    data = {
        "perception": {
            "detector": {"kind": "sim"}, "prior": "both" if seed >= HELD_OUT else "none",
        },
        "policy": {"kind": POLICIES[seed % len(POLICIES)]},
        "mission": {"target": ABSENT, "time_limit_s": EXPLORE_S},
        "sim": {"world": {"kind": "generated", "seed": seed}, "lockstep": True, "step_s": STEP_S},
        "sensors": {"camera": {"height_px": HW[0] // COARSE, "width_px": HW[1] // COARSE}},
        "loop": {"lockstep": True},
        "report": {"map_hz": 1.0},
    }  # fmt: skip
    config = parse(data)
    world, radius_m = load_world(config), config.robot.radius_m
    start = free_poses(world, 1, _KEY + seed, radius_m)[0]
    data["sim"]["start"] = (start.x_m, start.y_m, start.yaw_rad)
    config = parse(data)
    collector = _Collector(seed, world, radius_m)
    loop = ClosedLoop(config, sinks=[collector], world=world, colour=False)
    collector.loop = loop
    try:
        while loop.seconds < EXPLORE_S and not loop.service.status.done:
            loop.step()
            for _ in range(TICK_EVERY - 1):
                _drive_on(loop)
    finally:
        loop.close()
    # From rows to columns; without rows, an empty column for each field.
    values = list(zip(*collector.rows, strict=True)) or [()] * len(fields(Views))
    return _as_views(values)


def _drive_on(loop: ClosedLoop) -> None:
    """Run the controller's next step, without a tick of the service."""
    motion = loop.drive.motion
    command, answers = loop.controller.step(
        motion.odometry, motion.v_mps, motion.w_radps, motion.stamp_ns
    )
    for answer in answers:
        loop.service.on_goal_status(answer)
    loop.drive.step(STEP_S, command.v_mps, command.w_radps)


# Types of the arrays of `Views` but for the first.
_TYPES = {
    "house": np.int32, "count": np.uint8, "marks": np.float32, "path_m": np.float32,
    "gain_m2": np.float32, "others": np.float32, "left_m": np.float32, "else_m": np.float32,
    "else_path_m": np.float32, "here_m": np.float32, "seen": np.uint8, "lift": np.float32,
}  # fmt: skip


def _as_views(values: Sequence[Sequence]) -> Views:
    """Return views from the values of each field, in the order of the fields of `Views`."""
    # numpy would stack images of equal length into one array, so fill an array of objects.
    png = np.empty(len(values[0]), object)
    png[:] = list(values[0])
    named = zip(fields(Views)[1:], values[1:], strict=True)
    rest = (np.array(value, _TYPES[f.name]) for f, value in named)
    return Views(png, *rest)


def make_views(seeds: Sequence[int], folder: Path, workers: int = 1) -> list[Path]:
    """Write a file with the views of each house; existing files are not made again."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{seed}.npz" for seed in seeds]
    jobs = [job for job in zip(seeds, paths, strict=True) if not job[1].is_file()]
    if workers > 1 and jobs:
        os.environ.update(dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"), "1"))
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            list(pool.map(_write, jobs))
    else:
        for job in jobs:
            _write(job)
    return paths


def _write(job: tuple[int, Path]) -> None:
    """Write the file of one house; a job is its seed and path. The images are one after another."""
    cv2.setNumThreads(1)
    seed, path = job
    views = collect(seed)
    # Image i is encoded[ends[i]:ends[i + 1]].
    ends = np.cumsum([0, *(len(png) for png in views.png)])
    encoded = np.concatenate([np.zeros(0, np.uint8), *(png.ravel() for png in views.png)])
    with replace_atomically(path) as part, part.open("wb") as file:
        rest = {f.name: getattr(views, f.name) for f in fields(Views)[1:]}
        np.savez(file, encoded=encoded, ends=ends, **rest)


def load_views(paths: Sequence[Path]) -> Views:
    """Return the views of several files as one."""
    parts = [_read(path) for path in paths]
    parts = [part for part in parts if len(part)]
    joined = (np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Views))
    return Views(*joined)


def _read(path: Path) -> Views:
    """Return the views of a file that `_write` has written."""
    with np.load(path) as data:
        ends, encoded = data["ends"], data["encoded"]
        png = np.empty(len(ends) - 1, object)
        png[:] = [encoded[a:b] for a, b in pairwise(ends)]
        return Views(png, *(data[f.name] for f in fields(Views)[1:]))
