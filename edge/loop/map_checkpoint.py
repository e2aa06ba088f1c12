"""The checkpoint of everything bound to the frame `map`: saved while the service runs, restored.

It holds the arrays of each part's `state_dict`, as `part/array`, and the map's tiles, all of one
tick. A file is tried on empty parts at the start, so that a bad one never meets a running service.

Not saved is what follows from the rest or passes within seconds. Inflation, bit planes and frontier
cells follow from the cells. The reach field, rooms (`prior`) and travel costs follow from the map
within some ticks. The scorers are asked again.
"""

from __future__ import annotations

import logging
import time
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from edge.config import Config
from edge.geometry import FARTHEST_M, SE2, wrap_angle
from edge.host.checkpoint import (
    Checkpoint,
    CheckpointFormat,
    CheckpointWriter,
    load,
    set_aside,
)
from edge.host.machine import boot_id
from edge.loop.candidates import CandidatePool
from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import SemanticMap
from edge.mapping.grid import MAX_FRONTIERS, RollingMap
from edge.mapping.tiles import MOST_PER_STEP, Batch, Copier, PackedTiles
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.sightings import SightingTracker
from edge.policies.base import Policy, Remembers

log = logging.getLogger("edge.loop.map_checkpoint")

PERIOD_S = 3.0
"""How often copying begins; the copy is on the disk some ticks and a write later."""
SUFFIX = ".map"
_LAST_S = 5.0  # for the last write
_HASTE = 1.5  # robots are faster than their limits say
_MAX_TURN_RAD = 1.0  # what a pose may be turned at once
_DRIVES_ON_S = 10.0
_SCALES: tuple[Literal["resolution_m", "obstacle_max_m"], ...] = ("resolution_m", "obstacle_max_m")
_NAMES = Annotated[tuple[Annotated[str, Field(max_length=1000)], ...], Field(max_length=64)]
_METRES = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
_STAMP = Annotated[int, Field(ge=-(1 << 61), le=1 << 61)]


@dataclass(frozen=True)
class MapState:
    """When, where and under which settings the arrays were taken.

    Attributes:
        boot: see `edge.host.machine.boot_id`.
        policy: its kind.
        targets: of the mission; `target` is the active one.
        pose: x_m, y_m, yaw_rad, at `stamp_ns` of the sensors' clock and `now_ns` of the loop's.
        resolution_m, obstacle_max_m: of `mapping`: what a cell's numbers mean.
        value_source, value_targets, value_side: the scorer of the value maps, a map for each of
            these, and cells on the side of a tile.
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


class Parts(NamedTuple):
    """The parts of a service that are bound to `map`."""

    map: SemanticMap
    goals: GoalTracker
    policy: Policy


class Sighted(NamedTuple):
    """An observation's pose and stamp on the sensors' clock, and the loop's time."""

    pose: SE2
    stamp_ns: int
    now_ns: int


def state_of(
    parts: Parts, sighted: Sighted, boot: str, targets: tuple[str, ...], target: str
) -> Checkpoint[MapState]:
    """Return all but the tiles, as it stands; see `MapState` for the arguments."""
    config, values, policy = parts.map.config, parts.map.grid.values, parts.policy
    x_m, y_m, yaw_rad = map(float, astuple(sighted.pose))
    state = MapState(
        boot, config.policy.kind, targets, target,
        (x_m, y_m, yaw_rad), sighted.stamp_ns, sighted.now_ns,
        config.mapping.resolution_m, config.mapping.obstacle_max_m,
        config.value_source or "", tuple(values.targets), values.side,
    )  # fmt: skip
    remembered = policy.state_dict() if isinstance(policy, Remembers) else {}
    every = {**parts.map.state_dict(), "goals": parts.goals.state_dict(), "policy": remembered}
    arrays = {f"{part}/{name}": a for part, of in every.items() for name, a in of.items()}
    return Checkpoint(state, arrays)


def make_map(checkpoint: Checkpoint[MapState], config: Config) -> RollingMap:
    """Make the map again, and try all else on empty parts; fast, yet not for a tick.

    Raises:
        ValueError: one line: the map has another resolution or scale of heights, or is none.
    """
    state, mapping, perception = checkpoint.state, config.mapping, config.perception
    for scale in _SCALES:
        was, now = getattr(state, scale), getattr(mapping, scale)
        if was != now:
            raise ValueError(f"made with mapping.{scale} {was:g}, which now is {now:g}")
    part, grid = checkpoint.part, RollingMap(mapping, config.robot)
    values = grid.values
    same = (state.value_source, state.value_side) == (config.value_source or "", values.side)
    if same and state.value_targets:
        values.begin(state.value_targets)
    size = grid.tile_bytes + 4 * state.value_side**2 * len(state.value_targets)
    sightings = SightingTracker(perception)
    tracker = InstanceTracker(perception, sightings)
    pool = CandidatePool(MAX_FRONTIERS, config.policy.r_assoc_m)
    goals = GoalTracker(config, pool, tracker, lambda goal: None, lambda text, now_ns: None)
    for name, owner, *others in (
        ("map", grid, part("tiles"), size, same), ("gain", grid.gain), ("bumps", grid.bumps, 0),
        ("sightings", sightings, 0), ("instances", tracker, 0), ("candidates", pool, 0, 0),
        ("goals", goals, state.target, 0),
    ):  # fmt: skip
        try:
            owner.load_state_dict(part(name), *others)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    return grid


def restore(
    parts: Parts,
    grid: RollingMap,
    checkpoint: Checkpoint[MapState],
    sighted: Sighted,
    goes_on: bool,
) -> None:
    """Have the parts go on with a checkpoint.

    A time limit keeps what was left of it. If a clock was set back, its stamps are moved with it.

    Args:
        grid: of `make_map`.
        goes_on: whether the mission does, and with it what was tried, and what the policy
            remembers if it is of the same kind.

    Raises:
        ValueError: the policy refuses what it is to remember; all else has been restored.
    """
    state, part = checkpoint.state, checkpoint.part
    later_ns = min(sighted.now_ns - state.now_ns, 0)
    parts.map.load_state_dict(grid, part, later_ns, min(sighted.stamp_ns - state.stamp_ns, 0))
    if not goes_on:
        return
    parts.goals.load_state_dict(part("goals"), state.target, sighted.now_ns)
    memory, policy = part("policy"), parts.policy
    if memory and isinstance(policy, Remembers) and state.policy == parts.map.config.policy.kind:
        try:
            policy.load_state_dict(memory)
        except (KeyError, TypeError) as error:
            raise ValueError(str(error)) from None


class MapCheckpoint:
    """Saves the map and what is bound to it; for the loop's thread.

    What the file held waits for the first observation, which shows whether `map` is still the same
    frame. Until then nothing is written.

    Attributes:
        problem: why the file that was there is of no use, "" if there was none such.
        loaded: content of the file, as long as it may be restored.
        waiting: its map, until the first observation.
        writer: of the file.
    """

    def __init__(self, config: Config, path: Path, fingerprint: str = "") -> None:
        """
        Args:
            fingerprint: of the configuration.

        Raises:
            CheckpointError: there is a file and it cannot be read, or none can be written.
        """
        self._config, self._path, self._boot = config, path, boot_id()
        self._fingerprint = fingerprint
        self.loaded, self.problem = load(path, MAP)
        self.waiting: RollingMap | None = None
        self.writer = CheckpointWriter(path, MAP, PERIOD_S)
        self._copier, self._packed = Copier(), PackedTiles()
        self._due = False
        self._last: tuple[Parts, Sighted, tuple[str, ...], str] | None = None

    def prepare(self) -> None:
        """Make the map, so that the first tick only has to take it."""
        if self.loaded is None:
            return
        try:
            self.waiting = make_map(self.loaded, self._config)
        except ValueError as error:
            self.loaded, self.problem = None, set_aside(self._path, str(error))

    def why_elsewhere(self, sighted: Sighted) -> str:
        """Return why `map` is not believed to be the saved frame; "" if it is the same.

        A pose of `source.localised` is always in the same frame. Odometry is, if it went on: the
        computer was not rebooted, and the robot stands where it was, or as far from there as it may
        have driven. Without a service it ends its last goal and goes no farther, so only the first
        seconds count. Odometry that began again at the very place and heading is not recognised.
        """
        source, robot = self._config.source, self._config.robot
        if source.localised or self.loaded is None:
            return ""
        state = self.loaded.state
        passed_s = (sighted.stamp_ns - state.stamp_ns) * 1e-9
        if state.boot != self._boot:
            return "the computer was started anew, and its odometry with it"
        if passed_s < 0.0:
            return "the sensors' clock began anew"
        x_m, y_m, yaw_rad = state.pose
        driving_s = _HASTE * min(passed_s, _DRIVES_ON_S)
        moved_m = sighted.pose.distance_to(x_m, y_m)
        turned_rad = abs(wrap_angle(sighted.pose.yaw_rad - yaw_rad))
        if moved_m > source.max_pose_jump_m + robot.max_speed_mps * driving_s:
            return f"the robot is {moved_m:.1f} m from where it was"
        if turned_rad > _MAX_TURN_RAD + robot.max_turn_radps * driving_s:
            return f"the robot is turned by {turned_rad:.1f} rad from how it stood"
        return ""

    def take(self, elsewhere: str) -> tuple[RollingMap, Checkpoint[MapState]] | None:
        """Return what waits, once.

        Args:
            elsewhere: why the robot's frame is another, "" if it is the same. If it is another,
                what waits is dropped.
        """
        grid, self.waiting = self.waiting, None
        loaded = self.loaded
        if not self._config.source.localised:  # nothing goes back to it any more
            self.loaded = None
        if grid is None or loaded is None:
            return None
        if elsewhere:
            log.info("%s: what was mapped and seen before the restart is dropped", elsewhere)
            return None
        if loaded.arrays["map/cells"] != grid.window.n:
            log.info("mapping.extent_m is another than before the restart: the map is cut to it")
        return grid, loaded

    def jumped(self) -> None:
        """Handle a jump of the pose. With a pose in a map that lasts, only what was mapped since
        the start is void: the robot may have found only now where it is."""
        if self._config.source.localised:
            self._last = None
            self.prepare()

    def note(
        self, parts: Parts, sighted: Sighted, targets: tuple[str, ...], target: str, changed: bool
    ) -> None:
        """Copy a share if it is time, and hand a whole copy to the writer; never blocks.

        Args:
            targets: of the mission; `target` is the active one.
            changed: in a way that is worth saving at once.
        """
        if self.waiting is not None:  # nothing was observed yet
            return
        self._last = parts, sighted, targets, target
        self._due = self._due or changed or self.writer.due(sighted.now_ns)
        if self._due and self.writer.idle:
            self._copy(MOST_PER_STEP + parts.map.grid.tiles_of_update)

    def close(self) -> None:
        """Write how it stands, if there is time."""
        until_s = time.monotonic() + _LAST_S
        while not self.writer.idle and time.monotonic() < until_s:
            time.sleep(0.005)
        if self._last is not None and self.writer.idle:
            self._copy(self._last[0].map.grid.window.written.size)
        self.writer.close()

    def _copy(self, most: int) -> None:
        assert self._last is not None
        parts, sighted, targets, target = self._last
        grid = parts.map.grid
        if not self._copier.step(grid.window, grid.planes, most):
            return
        self._due = False
        state = state_of(parts, sighted, self._boot, targets, target)
        self.writer.post(
            partial(self._pack, state, grid.window.n, *self._copier.take()), sighted.now_ns
        )

    def _pack(
        self, checkpoint: Checkpoint[MapState], n: int, anew: bool, batches: list[Batch]
    ) -> Checkpoint[MapState]:
        """Add the tiles; on the writer's thread."""
        if anew:
            self._packed = PackedTiles()
        self._packed.update(batches)
        tiles = self._packed.state_dict(checkpoint.arrays["map/origin"], n)
        arrays = checkpoint.arrays | {f"tiles/{name}": array for name, array in tiles.items()}
        for name, array in arrays.items():  # the good file stays if a part has gone wrong
            own = not name.startswith("policy/") and array.dtype.kind == "f"
            if own and not np.isfinite(array).all():
                raise ValueError(f"{name} is not finite")
        return replace(checkpoint, arrays=arrays, config=self._fingerprint)
