"""Checkpoint of all data in the frame `map`: saved while the service runs, restored at the start.

It holds the arrays of each part's `state_dict`, as `part/array`, and the map's tiles, all of one
tick. At the start, a file is first loaded into empty parts, so that a bad file cannot damage the
service.

Data that can be computed from the rest, or that lasts only seconds, is not saved. Inflation, bit
planes and frontier cells are computed from the cells. The travel-cost field, the shapes of rooms
and travel costs are computed from the map within some ticks. The scorers are queried again.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from edge.config import Config
from edge.geometry import FARTHEST_M, SE2, wrap_angle
from edge.host.checkpoint import Checkpoint, CheckpointFormat, CheckpointWriter, load, quarantine
from edge.host.machine import boot_id
from edge.loop.goals.candidates import CandidatePool
from edge.loop.goals.goal_choice import GoalChooser
from edge.loop.semantic_map import SemanticMap
from edge.mapping.clusters import MAX_FRONTIERS
from edge.mapping.grid import RollingMap
from edge.mapping.tiles import MOST_PER_STEP, PackedTiles, TileBatch, TileCopier
from edge.memory import RoomMemory
from edge.perception.prior.table import load as load_table
from edge.perception.prior.words import PriorWordIndex
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.object_tracker import ObjectTracker
from edge.policies.base import Policy, StatefulPolicy

log = logging.getLogger("edge.loop.checkpoints.map_checkpoint")

PERIOD_S = 3.0
"""Period of the copies. A copy takes some ticks, and is then written to the disk."""
SUFFIX = ".map"
_CLOSE_TIMEOUT_S = 5.0  # longest wait for the last write
_SPEED_MARGIN = 1.5  # robots may drive faster than their limits by this factor
_MAX_TURN_RAD = 1.0  # largest sudden turn of a pose in the same frame
_MAX_DRIVE_ALONE_S = 10.0  # longest time that a robot drives after the service ended
# Keys of `mapping` that must not change: the saved cells depend on them.
_FIXED_KEYS: tuple[Literal["resolution_m", "obstacle_max_m"], ...] = (
    "resolution_m",
    "obstacle_max_m",
)
# Types of the fields of a file, with limits.
_NAMES = Annotated[tuple[Annotated[str, Field(max_length=1000)], ...], Field(max_length=64)]
_METRES = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
_STAMP = Annotated[int, Field(ge=-(1 << 61), le=1 << 61)]


@dataclass(frozen=True)
class MapState:
    """Time, pose and settings of the saved arrays.

    Attributes:
        boot: See `edge.host.machine.boot_id`.
        pose: x_m, y_m, yaw_rad at `stamp_ns`.
        stamp_ns: Stamp of the observation on the sensors' clock.
        resolution_m: Value of `mapping.resolution_m`.
        obstacle_max_m: Value of `mapping.obstacle_max_m`.
        value_source: Scorer of the value maps; "" if there is none.
        value_side: Cells on the side of a tile of the value maps.
    """

    __pydantic_config__ = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

    boot: str
    policy: str
    targets: _NAMES
    target: str
    pose: tuple[_METRES, _METRES, _METRES]
    stamp_ns: _STAMP
    now_ns: _STAMP
    resolution_m: float
    obstacle_max_m: float
    value_source: str
    value_targets: _NAMES
    value_side: Annotated[int, Field(ge=1, le=64)]


MAP = CheckpointFormat("edge-map", "map", MapState, 96 << 20)
"""Format of the map's file: at most 96 MiB."""


class MapParts(NamedTuple):
    """The parts of a service with data in the frame `map`."""

    map: SemanticMap
    goals: GoalChooser
    policy: Policy


class StampedPose(NamedTuple):
    """Pose and stamp of an observation (sensors' clock), with the loop time."""

    pose: SE2
    stamp_ns: int
    now_ns: int


def state_of(
    parts: MapParts, last_pose: StampedPose, boot: str, targets: tuple[str, ...], target: str
) -> Checkpoint[MapState]:
    """Return the current state without the tiles; see `MapState` for the arguments."""
    config, values, policy = parts.map.config, parts.map.grid.values, parts.policy
    pose = last_pose.pose
    state = MapState(
        boot, config.policy.kind, targets, target,
        (float(pose.x_m), float(pose.y_m), float(pose.yaw_rad)),
        last_pose.stamp_ns, last_pose.now_ns,
        config.mapping.resolution_m, config.mapping.obstacle_max_m,
        config.value_source or "", tuple(values.targets), values.n_side_cells,
    )  # fmt: skip
    remembered = policy.state_dict() if isinstance(policy, StatefulPolicy) else {}
    states = {**parts.map.state_dict(), "goals": parts.goals.state_dict(), "policy": remembered}
    arrays = {
        f"{part}/{name}": array for part, state_dict in states.items()
        for name, array in state_dict.items()
    }  # fmt: skip
    return Checkpoint(state, arrays)


def make_map(checkpoint: Checkpoint[MapState], config: Config) -> RollingMap:
    """Return the map of a checkpoint, and test all other data on empty parts.

    The function is fast, but too slow for a tick.

    Raises:
        ValueError: The map has another resolution or height scale, or the data is invalid. The
            message is one line.
    """
    state, mapping, perception = checkpoint.state, config.mapping, config.perception
    for key in _FIXED_KEYS:
        was, now = getattr(state, key), getattr(mapping, key)
        if was != now:
            raise ValueError(f"made with mapping.{key} {was:g}, which is now {now:g}")
    part, grid = checkpoint.part, RollingMap(mapping, config.robot)
    values = grid.values
    same_values = (state.value_source, state.value_side) == (
        config.value_source or "",
        values.n_side_cells,
    )
    if same_values and state.value_targets:
        values.set_targets(state.value_targets)
    # Unpacked size of a tile, with value and weight (2 bytes each) of each target.
    size = grid.tile_bytes + 4 * state.value_side**2 * len(state.value_targets)
    objects = ObjectTracker(perception)
    tracker = InstanceTracker(perception)
    pool = CandidatePool(MAX_FRONTIERS, config.policy.r_assoc_m)
    rooms = RoomMemory(load_table(), PriorWordIndex(load_table()))
    goals = GoalChooser(config, pool, tracker)
    # Name of the arrays, the part that loads them, and its other arguments; 0: a shift of a clock.
    for name, owner, *others in (
        ("map", grid, part("tiles"), size, same_values),
        ("gain", grid.gain), ("bumps", grid.bumps, 0),
        ("sightings", objects, 0), ("instances", tracker, 0), ("candidates", pool, 0, 0),
        ("goals", goals, state.target, 0), ("rooms", rooms),
    ):  # fmt: skip
        try:
            owner.load_state_dict(part(name), *others)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    return grid


def restore(
    parts: MapParts,
    grid: RollingMap,
    checkpoint: Checkpoint[MapState],
    last_pose: StampedPose,
    continues: bool,
) -> None:
    """Restore the parts from a checkpoint.

    Time limits keep their remaining time. If a clock was set back, its stamps are shifted with it.

    Args:
        parts: Parts to restore.
        grid: Map from `make_map`.
        checkpoint: The checkpoint.
        last_pose: Pose and stamp of the first observation after the start.
        continues: True if the mission continues. Then the failed attempts are restored too, and the
            policy's memory if the policy is of the same kind.

    Raises:
        ValueError: The policy rejects its memory. All other parts have been restored.
    """
    state, part = checkpoint.state, checkpoint.part
    clock_shift_ns = min(last_pose.now_ns - state.now_ns, 0)
    stamp_shift_ns = min(last_pose.stamp_ns - state.stamp_ns, 0)
    parts.map.load_state_dict(grid, part, clock_shift_ns, stamp_shift_ns)
    if not continues:
        return
    parts.goals.load_state_dict(part("goals"), state.target, last_pose.now_ns)
    memory, policy = part("policy"), parts.policy
    if (
        memory
        and isinstance(policy, StatefulPolicy)
        and state.policy == parts.map.config.policy.kind
    ):
        try:
            policy.load_state_dict(memory)
        except (KeyError, TypeError) as error:
            raise ValueError(str(error)) from None


class MapCheckpoint:
    """The checkpoint of the map and all data in its frame; for the loop's thread.

    The loaded data is kept until the first observation, which shows whether `map` is still the same
    frame. Until then nothing is written.

    Attributes:
        problem: Reason why an existing file cannot be used; "" if there is no problem.
        loaded: Content of the file while it can still be restored, else None.
        waiting: Map of the file, until the first observation.
    """

    def __init__(self, config: Config, path: Path, fingerprint: str = "") -> None:
        """Load the file and start its writer.

        Raises:
            CheckpointError: The file cannot be read, or cannot be written.
        """
        self._config, self._path, self._boot = config, path, boot_id()
        self._fingerprint = fingerprint
        self.loaded, self.problem = load(path, MAP)
        self.waiting: RollingMap | None = None
        self.writer = CheckpointWriter(path, MAP, PERIOD_S)
        self._copier, self._packed = TileCopier(), PackedTiles()
        self._due = False
        # Arguments of the newest `step`: parts, pose, targets, active target.
        self._last: tuple[MapParts, StampedPose, tuple[str, ...], str] | None = None

    def prepare(self) -> None:
        """Make the map, so that the first tick need not do it."""
        if self.loaded is None:
            return
        try:
            self.waiting = make_map(self.loaded, self._config)
        except ValueError as error:
            self.loaded, self.problem = None, quarantine(self._path, str(error))

    def frame_mismatch(self, last_pose: StampedPose) -> str:
        """Return why `map` is probably not the saved frame; "" if it is the same.

        With `source.localised`, the frame is always the same. Odometry has the same frame if the
        computer was not rebooted and the robot is within the distance that it may have driven.
        Without the service it only ends its last goal, so only the first seconds count. Odometry
        that restarted at the same place and heading is not detected.
        """
        source, robot = self._config.source, self._config.robot
        if source.localised or self.loaded is None:
            return ""
        state = self.loaded.state
        passed_s = (last_pose.stamp_ns - state.stamp_ns) * 1e-9
        if state.boot != self._boot:
            return "the computer was rebooted, so its odometry restarted"
        if passed_s < 0.0:
            return "the sensors' clock restarted"
        x_m, y_m, yaw_rad = state.pose
        driving_s = _SPEED_MARGIN * min(passed_s, _MAX_DRIVE_ALONE_S)
        moved_m = last_pose.pose.distance_to(x_m, y_m)
        turned_rad = abs(wrap_angle(last_pose.pose.yaw_rad - yaw_rad))
        if moved_m > source.max_pose_jump_m + robot.max_speed_mps * driving_s:
            return f"the robot is {moved_m:.1f} m from where it was"
        if turned_rad > _MAX_TURN_RAD + robot.max_turn_radps * driving_s:
            return f"the robot has turned by {turned_rad:.1f} rad"
        return ""

    def take(self, mismatch: str) -> tuple[RollingMap, Checkpoint[MapState]] | None:
        """Return the loaded map and data, to restore them; None if there are none, or no longer.

        Args:
            mismatch: Reason why the frame is another; "" if it is the same. If it is another, the
                data is dropped.
        """
        grid, self.waiting = self.waiting, None
        loaded = self.loaded
        if not self._config.source.localised:  # it cannot be used later
            self.loaded = None
        if grid is None or loaded is None:
            return None
        if mismatch:
            log.info("%s: the map and objects of the checkpoint are not used", mismatch)
            return None
        if loaded.arrays["map/cells"] != grid.window.n:
            log.info("mapping.extent_m has changed since the checkpoint: the map is cut to it")
        return grid, loaded

    def on_pose_jump(self) -> None:
        """Handle a pose jump.

        With `source.localised`, only the data since the start is wrong, because the robot may have
        been localised only now. The loaded map is then prepared again.
        """
        if self._config.source.localised:
            self._last = None
            self.prepare()

    def step(
        self,
        parts: MapParts,
        last_pose: StampedPose,
        targets: tuple[str, ...],
        target: str,
        changed: bool,
    ) -> None:
        """Copy some tiles of the map if a copy is due; pass a complete copy to the writer.

        Never block.

        Args:
            parts: The parts to save.
            last_pose: Pose and stamp of the newest observation.
            targets: Targets of the mission.
            target: Active target.
            changed: True if the mission changed, so that the state should be saved at once.
        """
        if self.waiting is not None:  # there was no observation yet
            return
        self._last = parts, last_pose, targets, target
        self._due = self._due or changed or self.writer.is_due(last_pose.now_ns)
        if self._due and self.writer.idle:
            self._copy(MOST_PER_STEP + parts.map.grid.tiles_of_update)

    def close(self) -> None:
        """Write the current state, if there is time, and stop the writer."""
        until_s = time.monotonic() + _CLOSE_TIMEOUT_S
        while not self.writer.idle and time.monotonic() < until_s:
            time.sleep(0.005)
        if self._last is not None and self.writer.idle:
            self._copy(self._last[0].map.grid.window.written.size)
        self.writer.close()

    def _copy(self, most: int) -> None:
        """Copy at most this many tiles; when all are copied, queue the state for the writer."""
        assert self._last is not None
        parts, last_pose, targets, target = self._last
        grid = parts.map.grid
        if not self._copier.step(grid.window, grid.planes, most):
            return
        self._due = False
        state = state_of(parts, last_pose, self._boot, targets, target)
        self.writer.post(
            partial(self._pack, state, grid.window.n, *self._copier.collect()), last_pose.now_ns
        )

    def _pack(
        self, checkpoint: Checkpoint[MapState], n: int, is_new: bool, batches: list[TileBatch]
    ) -> Checkpoint[MapState]:
        """Return the checkpoint with the tiles; on the writer's thread."""
        if is_new:
            self._packed = PackedTiles()
        self._packed.update(batches)
        tiles = self._packed.state_dict(checkpoint.arrays["map/origin"], n)
        arrays = checkpoint.arrays | {f"tiles/{name}": array for name, array in tiles.items()}
        for name, array in arrays.items():  # do not replace a good file by bad data
            # A policy plugin may save what it likes.
            checked = not name.startswith("policy/") and array.dtype.kind == "f"
            if checked and not np.isfinite(array).all():
                raise ValueError(f"the array {name} has values that are not finite")
        return replace(checkpoint, arrays=arrays, config=self._fingerprint)
