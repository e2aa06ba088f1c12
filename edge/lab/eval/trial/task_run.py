"""Turns one instruction into a trajectory, for `edge trajectory` (OpenNav figure 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from edge.config import Config, WriterModel
from edge.errors import UserError
from edge.lab.eval.trial.scene_capture import SceneCapture
from edge.tasks import rules
from edge.tasks.functions import ScriptFunctions
from edge.tasks.refine import RefinedTrajectory, refine
from edge.tasks.scene import terrain
from edge.tasks.scene.scene import SceneObject
from edge.tasks.scene.value_map import PathMargins, value_map
from edge.tasks.write import PlanAttempt, WrittenTrajectory, write_trajectory
from edge.trajectory.costmap import CostMap
from edge.trajectory.pursuit import MotionLimits, length_m

GROUND_RANGE_M = 60.0  # ground farther from the robot is not estimated


@dataclass(frozen=True, slots=True, eq=False)
class TaskRun:
    """The results of an instruction, as far as it got.

    Attributes:
        view: the scene and its sensor data.
        rounds: the attempts of a model that writes; () for the rules.
        written: the coarse trajectory; None: there is none.
        refined: the refined trajectory, on the ground that the LiDAR saw; None: there is none.
        costmap: costs that the refinement used; None: there is none.
        error: one line; "" if all went well.
    """

    instruction: str
    view: SceneCapture
    config: Config
    rounds: tuple[PlanAttempt, ...] = ()
    written: WrittenTrajectory | None = None
    refined: RefinedTrajectory | None = None
    costmap: CostMap | None = None
    error: str = ""

    @property
    def coarse_m(self) -> np.ndarray | None:
        """(n, 2) float64 in `map`, the coarse trajectory from the robot's place."""
        if self.written is None:
            return None
        pose = self.view.scene.pose
        return np.vstack([(pose.x_m, pose.y_m), self.written.coarse.points_m])

    @property
    def length_m(self) -> float:
        """Length of the refined trajectory; 0 if there is none."""
        if self.refined is None:
            return 0.0
        return length_m(self.refined.poses[:, :2])

    def steps(self) -> list[rules.InstructionStep]:
        """Return the instruction's steps as the rules read them; [] if a model writes."""
        if self.written is None or isinstance(self.config.tasks.planner, WriterModel):
            return []
        return rules.parse_steps(self.instruction, self.view.scene)

    def mentioned_objects(self) -> list[SceneObject]:
        """Return the objects that the rules find in the instruction."""
        return list({obj.id: obj for step in self.steps() for obj in step.objects}.values())

    def object_at_end(self) -> tuple[SceneObject, float] | None:
        """Return an object and its distance from the trajectory's end; None without a trajectory.

        It is the nearest of the objects in the last step, or of all objects if that step names
        none.
        """
        last = [obj for step in self.steps()[-1:] for obj in step.objects]
        objects = [t for t in last or self.view.scene.objects.values() if len(t.points_m)]
        if self.refined is None or not objects:
            return None
        end = self.refined.poses[-1, :2]
        away = [float(np.hypot(*(obj.points_m[:, :2] - end).T).min()) for obj in objects]
        k = int(np.argmin(away))
        return objects[k], away[k]


def run_task(
    instruction: str, view: SceneCapture, config: Config
) -> tuple[TaskRun, UserError | None]:
    """Make the trajectory of an instruction; also return the error that stopped it, or None."""
    rounds: list[PlanAttempt] = []
    outcome, failed = TaskRun(instruction, view, config), None
    try:
        written = write_trajectory(
            instruction, view.scene, config.tasks, rounds.append,
            make_functions=partial(ScriptFunctions, detect=view.detect),
        )  # fmt: skip
        outcome = replace(outcome, written=written)
        margins = PathMargins(config.tasks.trajectory.clearance_m)
        limits = MotionLimits.of(config.robot)
        if (wanted_mps := written.coarse.speed_mps) is not None:
            limits = replace(limits, speed_mps=min(wanted_mps, limits.speed_mps))
        coarse = written.coarse
        refined = refine(
            written.reachable.scene, coarse.segments, coarse.regions, margins, limits,
            heading_rad=coarse.heading_rad,
        )  # fmt: skip
        scene = view.scene
        costmap = value_map(
            scene.occupancy, scene.regions_grid, refined.drivable, outcome.coarse_m, margins
        )
        outcome = replace(outcome, refined=on_ground(refined, view), costmap=costmap)
    except UserError as error:
        failed = error
    return replace(outcome, rounds=tuple(rounds), error=str(failed or "")), failed


def on_ground(refined: RefinedTrajectory, view: SceneCapture) -> RefinedTrajectory:
    """Return the trajectory with heights over the ground in place of the plane z = 0."""
    poses = refined.poses.copy()  # (n, 4): x, y, z [m] and heading [rad]
    poses[:, 2] += ground_heights_m(view, poses[:, :2])
    return replace(refined, poses=poses)


def ground_heights_m(view: SceneCapture, xy_m: np.ndarray) -> np.ndarray:
    """Return the height of the ground in `map` at points (n, 2): (n,) float64.

    It is the height of the nearest ground that the LiDAR saw around the robot. Ground next to an
    obstacle is ignored: `terrain` may take the bonnet of a car for ground.
    """
    scene, pose = view.scene, view.scene.pose
    ground = terrain.estimate_ground(
        view.cloud_m, pose.x_m, pose.y_m, view.base_z_m, GROUND_RANGE_M
    )  # fmt: skip
    rows, columns = np.nonzero(ground.seen.cells)
    centres_m = ground.seen.centres_m(rows, columns)
    cells = np.floor(scene.occupancy.to_cells(centres_m)).astype(np.int64)
    h, w = scene.occupancy.cells.shape
    kept = ((cells >= 0) & (cells < (w, h))).all(axis=1)
    # True up to 3 cells from an obstacle.
    near = cv2.dilate((scene.occupancy.cells > 0).astype(np.uint8), np.ones((7, 7), np.uint8))
    # Of the points on the grid, keep those that are not near an obstacle.
    kept[kept] = near[cells[kept, 1], cells[kept, 0]] == 0
    if not kept.any():
        return np.full(len(xy_m), view.base_z_m)
    known_m, height_m = centres_m[kept], ground.height_m.cells[rows, columns][kept]
    nearest = [int(np.argmin(((known_m - point) ** 2).sum(axis=1))) for point in xy_m]
    return height_m[nearest].astype(np.float64)
