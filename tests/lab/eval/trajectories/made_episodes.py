"""Episodes and outcomes that are made by hand."""

from __future__ import annotations

import numpy as np
from task_scenes import STREET, street

from edge.geometry import SE2, Grid
from edge.lab.eval.trajectories.episodes import TrajectoryEpisode
from edge.lab.eval.trajectories.outcomes import EpisodeFacts, TrajectoryOutcome
from edge.lab.eval.trajectories.references import (
    Landmark,
    ReferenceScene,
    TrajectoryTask,
    box_outline_m,
)

ROBOT_M = 0.4


def landmark(number: int, label: str, x_m: float, y_m: float, look: str = "", side_m=(2.0, 2.0)):
    at = np.array([x_m, y_m])
    return Landmark(number, label, look, at, box_outline_m(at, np.array(side_m), 0.0))


def place(*landmarks: Landmark, walls=()) -> ReferenceScene:
    """Ground of 40 m by 40 m in cells of 0.2 m, with objects and walls (x0, x1, y0, y1)."""
    grid = Grid(np.zeros((200, 200), np.int8), (-20.0, -20.0), 0.2)
    x, y = np.moveaxis(grid.centres_m(*np.indices((200, 200))), -1, 0)
    ends = [(one.outline_m.min(axis=0), one.outline_m.max(axis=0)) for one in landmarks]
    boxes = [(low[0], high[0], low[1], high[1]) for low, high in ends]
    for x0, x1, y0, y1 in (*boxes, *walls):
        grid.cells[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = 100
    drivable = np.ones(grid.cells.shape, bool)
    return ReferenceScene(SE2(0.0, 0.0, 0.0), landmarks, grid, drivable, ROBOT_M, (3.0, 18.0))


def episode(
    instruction: str, to_m=(14.8, 2.0), kind="past", category="high-level"
) -> TrajectoryEpisode:
    """Return an episode in the street of `task_scenes`; its reference is a straight line."""
    scene = street(*STREET, picture=True)
    reference_m = np.array([(0.0, 0.0), to_m])
    task = TrajectoryTask(kind, category, instruction, (1,), (reference_m[1:],), reference_m)
    van = landmark(1, "van", 8.0, 0.0, side_m=(4.0, 2.0))
    return TrajectoryEpisode("e", "streets", "w", task, scene, scene.occupancy, ROBOT_M, (van,))


def facts(
    number: int, category: str = "specific", kind: str = "to", world: str = ""
) -> EpisodeFacts:
    return EpisodeFacts(
        f"e{number}", "streets", world or f"w{number}", kind, category, "go to <b>$x$</b>", 0.4,
        [[0.0, 0.0], [5.0, 0.0]], [[[4.0, 1.0], [5.0, 1.0], [5.0, 2.0]]], [], "van", True,
    )  # fmt: skip


def outcome(
    number: int, method: str = "ours", error_m: float = 0.5, **changed
) -> TrajectoryOutcome:
    numbers = {"writer": "rules", "frechet_m": 2.0, "ndtw": 0.5, "contacts": 0, "length_m": 5.0,
               "true_contacts": 0, "at_thing": error_m <= 1.0,
               "true_depth_m": 0.0}  # fmt: skip
    more = {"refused": "", "reason": "", "seconds": 0.1, "path": [[0.0, 0.0], [5.0, error_m]]}
    return TrajectoryOutcome(
        f"e{number}", method, success=error_m <= 1.0, error_m=error_m,
        **{**numbers, **more, **changed},
    )  # fmt: skip
