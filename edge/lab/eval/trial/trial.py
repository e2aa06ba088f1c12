"""A task and what becomes of it (OpenNav figure 1, all of it once)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge.config import Config, WriterModel
from edge.errors import UserError
from edge.lab.eval.trial.views import View
from edge.tasks import rules, terrain
from edge.tasks.refine import Refined, refine
from edge.tasks.scene import SceneObject
from edge.tasks.value_map import Body, value_map
from edge.tasks.write import Round, Written, write
from edge.trajectory.costmap import CostMap
from edge.trajectory.pursuit import MotionLimits

GROUND_RANGE_M = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What became of a task, as far as it came.

    Attributes:
        rounds: of a model.
        written: None: nothing was written; `refined`, `costmap`: None: nothing was refined.
        refined: on the ground that the LiDAR saw.
        error: one line; "" where all went well.
    """

    instruction: str
    view: View
    config: Config
    rounds: tuple[Round, ...] = ()
    written: Written | None = None
    refined: Refined | None = None
    costmap: CostMap | None = None
    error: str = ""

    @property
    def coarse_m(self) -> np.ndarray | None:
        """(n, 2) float64 in `map`, from where the robot stands."""
        if self.written is None:
            return None
        pose = self.view.scene.pose
        return np.vstack([(pose.x_m, pose.y_m), self.written.coarse.points_m])

    @property
    def length_m(self) -> float:
        """Of the refined trajectory."""
        if self.refined is None:
            return 0.0
        return float(np.hypot(*np.diff(self.refined.poses[:, :2], axis=0).T).sum())

    def steps(self) -> list[rules.Step]:
        """Of the instruction, as the rules read it; of a model none is told."""
        if self.written is None or isinstance(self.config.tasks.planner, WriterModel):
            return []
        return rules.read(self.instruction, self.view.scene)

    def named(self) -> list[SceneObject]:
        """The objects that the rules find named."""
        return list({thing.id: thing for step in self.steps() for thing in step.things}.values())

    def ends_at(self) -> tuple[SceneObject, float] | None:
        """The object that the last step names, else the one nearest to where the trajectory ends,
        and how far its points are from there."""
        last = [thing for step in self.steps()[-1:] for thing in step.things]
        things = [t for t in last or self.view.scene.objects.values() if len(t.points_m)]
        if self.refined is None or not things:
            return None
        end = self.refined.poses[-1, :2]
        away = [float(np.hypot(*(thing.points_m[:, :2] - end).T).min()) for thing in things]
        k = int(np.argmin(away))
        return things[k], away[k]


def carry_out(instruction: str, view: View, config: Config) -> tuple[Outcome, UserError | None]:
    """The trajectory of an instruction, as far as it comes, and what kept it from its end."""
    rounds: list[Round] = []
    outcome, failed = Outcome(instruction, view, config), None
    try:
        written = write(instruction, view.scene, config.tasks, rounds.append)
        outcome = replace(outcome, written=written)
        body = Body(config.tasks.trajectory.clearance_m)
        limits = MotionLimits.of(config.robot)
        if (asked := written.coarse.speed_mps) is not None:
            limits = replace(limits, speed_mps=min(asked, limits.speed_mps))
        coarse = written.coarse
        refined = refine(view.scene, coarse.segments, coarse.regions, body, limits)
        scene = view.scene
        costmap = value_map(
            scene.occupancy, scene.regions_grid, refined.drivable, outcome.coarse_m, body
        )
        outcome = replace(outcome, refined=laid_down(refined, view), costmap=costmap)
    except UserError as error:
        failed = error
    return replace(outcome, rounds=tuple(rounds), error=str(failed or "")), failed


def laid_down(refined: Refined, view: View) -> Refined:
    """The same trajectory, its heights over the ground and not over the plane z = 0."""
    poses = refined.poses.copy()
    poses[:, 2] += ground_heights_m(view, poses[:, :2])
    return replace(refined, poses=poses)


def ground_heights_m(view: View, xy_m: np.ndarray) -> np.ndarray:
    """(n,) float64 of the ground in `map` at points (n, 2), as the LiDAR saw it around the robot;
    where it did not, of what is nearest to there.

    Only ground that nothing stands on counts: the ground of `terrain` may climb a bonnet.
    """
    scene, pose = view.scene, view.scene.pose
    ground = terrain.ground_around(
        view.cloud_m, pose.x_m, pose.y_m, view.base_z_m, GROUND_RANGE_M
    )  # fmt: skip
    rows, columns = np.nonzero(ground.seen.cells)
    centres_m = ground.seen.centres_m(rows, columns)
    at = np.floor(scene.occupancy.of_metres(centres_m)).astype(np.int64)
    h, w = scene.occupancy.cells.shape
    inside = ((at >= 0) & (at < (w, h))).all(axis=1)
    near = cv2.dilate((scene.occupancy.cells > 0).astype(np.uint8), np.ones((7, 7), np.uint8))
    inside[inside] = near[at[inside, 1], at[inside, 0]] == 0
    if not inside.any():
        return np.full(len(xy_m), view.base_z_m)
    known_m, height_m = centres_m[inside], ground.height_m.cells[rows, columns][inside]
    nearest = [int(np.argmin(((known_m - point) ** 2).sum(axis=1))) for point in xy_m]
    return height_m[nearest].astype(np.float64)
