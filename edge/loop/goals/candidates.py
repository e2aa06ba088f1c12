"""Candidates: goal points of frontiers and instances, with ids that last over ticks.

An *instance* is an object that was detected as a target.
A frontier moves as the map grows. It keeps its id while it stays within `r_assoc_m` of its first
position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge.geometry import SE2, wrap_angle
from edge.host.checkpoint import Arrays, check_arrays
from edge.jit import jit
from edge.mapping.grid import RollingMap
from edge.mapping.results import Frontiers
from edge.policies.base import FRONTIER, INSTANCE, SNAP_M, SPIN, Candidates
from edge.types import Instance

_MAX_DISCARDED = 64  # largest number of discarded candidates; the oldest are overwritten
# Names of the arrays that are carried over from tick to tick, as in a checkpoint.
_CARRIED = ("xy_m", "anchor_m", "id", "first_seen_ns", "gain_m2")
_DISCARDED = ("discarded_xy_m", "discarded_kind", "discarded_id", "discarded_until_ns")
_UNMEASURED = np.float32(-1.0)  # gain (`Candidates.gain_m2`) of a frontier before it is computed
# Number of frontiers whose gain is measured again in a tick, in addition to new ones.
_MEASURED_PER_TICK = 12
SPIN_MIN_M2 = 1.5
"""A spin that would show less than this area is no candidate."""
TURN_M_PER_RAD = 0.15
"""Cost of a turn as path length."""
_SAME_SPIN_RAD = 0.6  # a spin keeps its id and heading while the best heading is this near


class DiscardedCandidates:
    """Candidates that are blocked for some time, at most `_MAX_DISCARDED`."""

    def __init__(self) -> None:
        self._xy_m = np.zeros((_MAX_DISCARDED, 2), np.float32)
        self._kind = np.zeros(_MAX_DISCARDED, np.int8)
        self._id = np.zeros(_MAX_DISCARDED, np.int64)
        self._until_ns = np.zeros(_MAX_DISCARDED, np.int64)
        self._next = 0

    def add(self, kind: int, candidate_id: int, xy_m: tuple[float, float], until_ns: int) -> None:
        """Block a candidate until `until_ns`; see `mark`."""
        i = self._next
        self._xy_m[i], self._kind[i] = xy_m, kind
        self._id[i], self._until_ns[i] = candidate_id, until_ns
        self._next = (i + 1) % _MAX_DISCARDED

    def mark(self, c: Candidates, rows: slice, radius_m: float, now_ns: int) -> None:
        """Write to `c.blocked` if each candidate of these rows is blocked now.

        An instance is blocked by its id. For other kinds, all candidates of the kind within
        `radius_m` of the point are blocked, because frontiers change their points.
        """
        _mark_blocked(
            c.xy_m[rows], c.kind[rows], c.id[rows],
            self._xy_m, self._kind, self._id, self._until_ns, now_ns, radius_m, c.blocked[rows],
        )  # fmt: skip

    def clear(self) -> None:
        """Unblock all."""
        self._until_ns[:] = 0

    def state_dict(self) -> Arrays:
        """Return the blocked candidates."""
        blocked = self._until_ns > 0
        arrays: tuple[np.ndarray, ...] = (self._xy_m, self._kind, self._id, self._until_ns)
        return {name: a[blocked] for name, a in zip(_DISCARDED, arrays, strict=True)}

    def load_state_dict(self, state: Arrays, clock_shift_ns: int) -> None:
        """Add the blocked candidates of a `state_dict` that was checked."""
        for xy_m, kind, i, until_ns in zip(*(state[name] for name in _DISCARDED), strict=True):
            self.add(int(kind), int(i), (float(xy_m[0]), float(xy_m[1])), until_ns + clock_shift_ns)


class CandidatePool:
    """The candidates of the current tick, with their ids and the discarded ones.

    Attributes:
        candidates: The candidates, updated in place.
        discarded: Blocked candidates.
        read_only: The same candidates, in arrays that cannot be written.
        anchor_m: (capacity, 2) float32, first position of each frontier.
        r_assoc_m: Distance from its first position within which a frontier keeps its id; may be
            set.
    """

    def __init__(self, capacity: int, r_assoc_m: float) -> None:
        c = self.candidates = Candidates(capacity)
        self.read_only = c.read_only()
        self.anchor_m = np.zeros((capacity, 2), np.float32)
        carried = c.xy_m, self.anchor_m, c.id, c.first_seen_ns, c.gain_m2
        self._carried: tuple[np.ndarray, ...] = carried
        self._old_arrays = tuple(np.empty_like(array) for array in self._carried)
        self.r_assoc_m = r_assoc_m
        self._next_id = 1
        # Rotation of the measurement of gains (see `_select_to_measure`): first frontier of this
        # tick, and stamp of the observation at which it last advanced.
        self._next_to_measure = 0
        self._rotated_ns: int | None = None
        self._selected = np.zeros(capacity, np.int32)
        self._spin: tuple[int, float] | None = None  # id and heading of the last spin
        self._old_index = np.full(capacity, -1, np.int32)
        self._new_index = np.full(capacity, -1, np.int32)
        self.discarded = DiscardedCandidates()

    def update(
        self, frontiers: Frontiers, instances: Sequence[Instance], stamp_ns: int, now_ns: int
    ) -> None:
        """Replace the candidates by those of this tick, and keep the ids of known frontiers.

        Args:
            frontiers: Frontiers of the map. Those beyond the capacity are left out.
            instances: Instances of the active target.
            stamp_ns: Stamp of the observation; new frontiers were first seen then.
            now_ns: Loop time, on the clock of `discarded`.
        """
        c = self.candidates
        capacity = len(c.id)
        n_old = int(np.count_nonzero(c.kind[: c.n] == FRONTIER))
        n_instances = min(len(instances), capacity)
        n_new = min(frontiers.n, capacity - n_instances)
        for array, saved in zip(self._carried, self._old_arrays, strict=True):
            saved[:n_old] = array[:n_old]
        old_xy_m, anchor_m, old_id, first_seen_ns, gain_m2 = self._old_arrays
        _associate(
            old_xy_m, anchor_m, n_old, frontiers.xy_m, n_new,
            self.r_assoc_m, self._old_index, self._new_index,
        )  # fmt: skip
        c.xy_m[:n_new] = frontiers.xy_m[:n_new]
        c.kind[:n_new] = FRONTIER
        c.confirmed[:n_new] = False
        c.confidence[:n_new] = 0.0
        self._next_id = _carry_over(
            self._old_index, n_new, self._next_id, stamp_ns,
            anchor_m, old_id, first_seen_ns, gain_m2,
            c.xy_m, self.anchor_m, c.id, c.first_seen_ns, c.gain_m2,
        )  # fmt: skip
        # If the sensors' clock was set back, no frontier may have been seen in the future.
        np.minimum(c.first_seen_ns[:n_new], stamp_ns, out=c.first_seen_ns[:n_new])
        c.stamp_ns = stamp_ns
        for i, instance in enumerate(instances[:n_instances], start=n_new):
            c.xy_m[i] = instance.center_m[:2]
            c.kind[i] = INSTANCE
            c.id[i] = instance.id
            c.first_seen_ns[i] = instance.first_seen_ns
            c.confidence[i] = instance.score
            c.confirmed[i] = instance.state in ("confirmed", "reached")
            c.gain_m2[i] = 0.0
        c.n = n_new + n_instances
        self.discarded.mark(c, slice(0, c.n), self.r_assoc_m, now_ns)
        self.read_only.n, self.read_only.stamp_ns = c.n, c.stamp_ns

    @property
    def out_of_reach(self) -> int:
        """Number of frontiers without a known path."""
        c = self.candidates
        frontiers = c.kind[: c.n] == FRONTIER
        return int(np.count_nonzero(frontiers & np.isinf(c.path_m[: c.n])))

    def measure(self, grid: RollingMap) -> None:
        """Compute the path lengths of the candidates and the gains of frontiers."""
        c = self.candidates
        grid.travel_cost.path_lengths_m(c.xy_m, c.kind, SNAP_M, c.n, c.path_m)
        n = int(np.count_nonzero(c.kind[: c.n] == FRONTIER))
        if c.stamp_ns != self._rotated_ns:  # the rotation advances once per observation
            self._rotated_ns = c.stamp_ns
            self._next_to_measure = (self._next_to_measure + _MEASURED_PER_TICK) % max(n, 1)
        k = _select_to_measure(
            c.gain_m2, n, self._next_to_measure, _MEASURED_PER_TICK, self._selected
        )
        if k and grid.window.placed:
            grid.gain.around(c.xy_m, self._selected, k, c.gain_m2)

    def add_spin(self, grid: RollingMap, pose: SE2, fov_rad: float, now_ns: int) -> None:
        """Add the spin that would show the largest area, if it is large enough."""
        c = self.candidates
        if c.n == len(c.id):
            return
        yaw = grid.coverage.camera_yaw_rad
        grid.gain.on_view(pose, yaw, fov_rad)
        heading, turn_rad, area_m2 = grid.gain.best_spin(pose, yaw, fov_rad)
        if area_m2 < SPIN_MIN_M2:
            self._spin = None
            return
        if self._spin is None or abs(wrap_angle(self._spin[1] - heading)) > _SAME_SPIN_RAD:
            self._spin = (self._next_id, heading)
            self._next_id += 1
        i, (spin_id, heading) = c.n, self._spin
        c.xy_m[i] = pose.x_m + math.cos(heading), pose.y_m + math.sin(heading)
        c.kind[i] = SPIN
        c.id[i] = spin_id
        c.first_seen_ns[i] = c.stamp_ns
        c.confidence[i] = 0.0
        c.confirmed[i] = False
        c.path_m[i] = TURN_M_PER_RAD * turn_rad
        c.gain_m2[i] = area_m2
        c.n = self.read_only.n = i + 1
        self.discarded.mark(c, slice(i, i + 1), self.r_assoc_m, now_ns)

    def state_dict(self) -> Arrays:
        """Return the ids of the frontiers and the discarded candidates."""
        n = int(np.count_nonzero(self.candidates.kind[: self.candidates.n] == FRONTIER))
        return {
            **{name: a[:n].copy() for name, a in zip(_CARRIED, self._carried, strict=True)},
            "next_id": np.array(self._next_id),
            "measure_next": np.array(self._next_to_measure),
            # A spin; checkpoints have its older name.
            "look_id": np.array([] if self._spin is None else self._spin[:1], np.int64),
            "look_rad": np.array([] if self._spin is None else self._spin[1:], np.float64),
            **self.discarded.state_dict(),
        }

    def load_state_dict(self, state: Arrays, clock_shift_ns: int, stamp_shift_ns: int) -> None:
        """Restore a `state_dict` into an empty pool. Rows beyond the capacity are left out.

        Args:
            state: The arrays.
            clock_shift_ns: Added to saved times of the clock of `discarded`.
            stamp_shift_ns: Added to saved stamps of the sensors' clock.
        """
        c, spin_keys = self.candidates, ("look_id", "look_rad")
        rows = {_CARRIED: 1 << 14, spin_keys: 1, _DISCARDED: _MAX_DISCARDED}
        max_values = {"discarded_kind": SPIN, "measure_next": 1 << 16}
        check_arrays(state, self.state_dict(), rows, max_values, ("id",))
        c.n = min(len(state["id"]), len(c.id))
        c.kind[: c.n] = FRONTIER
        for name, array in zip(_CARRIED, self._carried, strict=True):
            array[: c.n] = state[name][: c.n]
        c.first_seen_ns[: c.n] += stamp_shift_ns
        self._next_id = max(self._next_id, int(state["next_id"]))
        self._next_to_measure = int(state["measure_next"])
        for spin_id, heading in zip(*(state[name] for name in spin_keys), strict=True):
            self._spin = (int(spin_id), float(heading))
        self.discarded.load_state_dict(state, clock_shift_ns)

    def clear(self) -> None:
        """Remove all candidates and all discarded points."""
        self.candidates.n = self.read_only.n = 0
        self.discarded.clear()


@jit
def _associate(old_xy, old_anchor, n_old, new_xy, n_new, radius, match, claim):
    """Match new frontiers to old ones; each old one is matched at most once.

    Of all pairs within the radius, the nearest are matched first. If a new frontier loses its old
    frontier to a nearer new one, it searches for another.

    Args:
        old_xy: (cap, 2), points of the old frontiers.
        old_anchor: (cap, 2), first points of the old frontiers.
        n_old: Number of old frontiers.
        new_xy: (cap, 2), points of the new frontiers.
        n_new: Number of new frontiers.
        radius: Largest distance of a new frontier from the first point of its old one, in metres.
        match: Output, old index for each new frontier, or -1.
        claim: Output, new index for each old frontier, or -1.
    """
    for j in range(n_old):
        claim[j] = -1
    for start in range(n_new):
        i = start
        while i >= 0:
            match[i] = _nearest_unclaimed(
                old_xy, old_anchor, n_old, new_xy, i, radius * radius, claim
            )
            loser = -1
            if match[i] >= 0:
                loser = claim[match[i]]
                claim[match[i]] = i
            i = loser


@jit
def _nearest_unclaimed(old_xy, old_anchor, n_old, new_xy, i, r2, claim):
    """Return the nearest old frontier that no nearer new frontier has claimed, or -1."""
    found, best = -1, r2
    for j in range(n_old):
        ax, ay = new_xy[i, 0] - old_anchor[j, 0], new_xy[i, 1] - old_anchor[j, 1]
        if ax * ax + ay * ay >= r2:
            continue
        dx, dy = new_xy[i, 0] - old_xy[j, 0], new_xy[i, 1] - old_xy[j, 1]
        d2 = dx * dx + dy * dy
        if d2 >= best:
            continue
        claimer = claim[j]
        if claimer >= 0:
            rx, ry = new_xy[claimer, 0] - old_xy[j, 0], new_xy[claimer, 1] - old_xy[j, 1]
            if rx * rx + ry * ry <= d2:
                continue
        found, best = j, d2
    return found


@jit
def _carry_over(
    match, n_new, next_id, stamp_ns, old_anchor, old_id, old_seen, old_gain,
    xy, anchor, ids, seen, gain,
):  # fmt: skip
    """Fill the new frontiers from their matches; return the next free id."""
    for i in range(n_new):
        j = match[i]
        if j >= 0:
            anchor[i] = old_anchor[j]
            ids[i] = old_id[j]
            seen[i] = old_seen[j]
            gain[i] = old_gain[j]
        else:
            anchor[i] = xy[i]
            ids[i] = next_id
            seen[i] = stamp_ns
            gain[i] = _UNMEASURED
            next_id += 1
    return next_id


@jit
def _mark_blocked(
    xy, kind, ids, discarded_xy, discarded_kind, discarded_id, until_ns, now_ns, radius, blocked
):
    """Write to `blocked` if each candidate is discarded now; see `DiscardedCandidates.mark`."""
    for i in range(len(blocked)):
        blocked[i] = False
        for j in range(len(until_ns)):
            if until_ns[j] <= now_ns or discarded_kind[j] != kind[i]:
                continue
            if kind[i] == INSTANCE:
                blocked[i] = discarded_id[j] == ids[i]
            else:
                dx, dy = xy[i, 0] - discarded_xy[j, 0], xy[i, 1] - discarded_xy[j, 1]
                blocked[i] = dx * dx + dy * dy < radius * radius
            if blocked[i]:
                break


@jit
def _select_to_measure(gain, n, start, n_rotating, out):
    """Write to `out` the indices of the frontiers to measure; return their number.

    These are all frontiers that were never measured, and the `n_rotating` frontiers from index
    `start` on, so that all are measured in turn.
    """
    k = 0
    for i in range(n):
        if gain[i] < 0.0 or (i - start) % n < n_rotating:
            out[k] = i
            k += 1
    return k
