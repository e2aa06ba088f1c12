"""The candidate pool: frontier and instance target points with an identity that lasts.

A frontier moves as the map grows. It keeps its identity, and with it the VL scores from first
sight (VL-Nav III.D), while it stays within `r_assoc_m` of where it was first seen. It has one VL
score for each target of the mission (channels, ViTL eq. 3), so that nothing that was seen is lost
when the plan turns to another target.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from edge.mapping.grid import Frontiers
from edge.types import Instance

FRONTIER, INSTANCE = 0, 1
_DISCARDED = 64


class CandidatePool:
    """Parallel arrays of capacity `capacity`; the first `n` entries are alive.

    Attributes:
        xy_m: (capacity, 2) float32 in `map`.
        anchor_m: (capacity, 2) float32, where the candidate was first seen.
        kind: (capacity,) int8, `FRONTIER` or `INSTANCE`.
        id: (capacity,) int64; frontiers count up, instances carry their instance's id.
        first_seen_ns: (capacity,) int64, on the clock of `stamp_ns`.
        stamp_ns: of the observation that `update` was last called for.
        vl: (channels, capacity) float32, S_VL of each target from first sight; NaN until a
            detector looked there. Instances have theirs in the active channel.
        channel: index of the target that is pursued now.
        score: (capacity,) float32, what the policy made of it.
        sure: (capacity,) bool, instances that the detector has confirmed.
        blocked: (capacity,) bool, discarded for a while.
    """

    def __init__(self, capacity: int, r_assoc_m: float, channels: int = 1) -> None:
        self.n = 0
        self.channel = 0
        self.stamp_ns = 0
        self.xy_m = np.zeros((capacity, 2), np.float32)
        self.anchor_m = np.zeros((capacity, 2), np.float32)
        self.kind = np.zeros(capacity, np.int8)
        self.id = np.zeros(capacity, np.int64)
        self.first_seen_ns = np.zeros(capacity, np.int64)
        self.vl = np.full((channels, capacity), np.nan, np.float32)
        self.score = np.zeros(capacity, np.float32)
        self.sure = np.zeros(capacity, np.bool_)
        self.blocked = np.zeros(capacity, np.bool_)
        self._r_assoc_m = r_assoc_m
        self._next_id = 1
        self._match = np.full(capacity, -1, np.int32)
        self._claim = np.full(capacity, -1, np.int32)
        self._old = {
            name: np.empty_like(getattr(self, name))
            for name in ("xy_m", "anchor_m", "id", "first_seen_ns")
        }
        self._old_vl = np.empty_like(self.vl)
        self._discarded_xy_m = np.zeros((_DISCARDED, 2), np.float32)
        self._discarded_kind = np.zeros(_DISCARDED, np.int8)
        self._discarded_id = np.zeros(_DISCARDED, np.int64)
        self._discarded_until_ns = np.zeros(_DISCARDED, np.int64)
        self._discarded_next = 0

    def set_channels(self, channels: int) -> None:
        """Begin anew with the VL scores of so many targets; frontiers keep their identity."""
        self.channel = 0
        self.vl = np.full((channels, len(self.id)), np.nan, np.float32)
        self._old_vl = np.empty_like(self.vl)

    def update(
        self, frontiers: Frontiers, instances: Sequence[Instance], stamp_ns: int, now_ns: int
    ) -> None:
        """Replace the candidates by today's, carrying identities over.

        Args:
            frontiers: target points of the map; more than fit are left out, smallest id last.
            instances: the live instances of the active target.
            stamp_ns: of the observation that the map was updated from; what is new was first
                seen then.
            now_ns: the loop's time, which `discard` counts in.
        """
        n_old = int(np.count_nonzero(self.kind[: self.n] == FRONTIER))
        n_instances = min(len(instances), len(self.id))
        n_new = min(frontiers.n, len(self.id) - n_instances)
        for name, saved in self._old.items():
            saved[:n_old] = getattr(self, name)[:n_old]
        self._old_vl[:, :n_old] = self.vl[:, :n_old]
        old = self._old
        _associate(
            old["xy_m"], old["anchor_m"], n_old, frontiers.xy_m, n_new,
            self._r_assoc_m, self._match, self._claim,
        )  # fmt: skip
        self.xy_m[:n_new] = frontiers.xy_m[:n_new]
        self.kind[:n_new] = FRONTIER
        self.sure[:n_new] = False
        self._next_id = _carry_over(
            self._match, n_new, self._next_id, stamp_ns,
            old["anchor_m"], old["id"], old["first_seen_ns"], self._old_vl,
            self.xy_m, self.anchor_m, self.id, self.first_seen_ns, self.vl,
        )  # fmt: skip
        # Where the sensors' clock was set back, nothing was first seen in the future.
        first_seen_ns = self.first_seen_ns[:n_new]
        np.minimum(first_seen_ns, stamp_ns, out=first_seen_ns)
        self.stamp_ns = stamp_ns
        for i, instance in enumerate(instances[:n_instances], start=n_new):
            self.xy_m[i] = instance.center_m[:2]
            self.anchor_m[i] = instance.center_m[:2]
            self.kind[i] = INSTANCE
            self.id[i] = instance.id
            self.first_seen_ns[i] = instance.first_seen_ns
            self.vl[:, i] = np.nan
            self.vl[self.channel, i] = instance.score
            self.sure[i] = instance.state in ("confirmed", "reached")
        self.n = n_new + n_instances
        _mark_blocked(
            self.xy_m, self.kind, self.id, self.n,
            self._discarded_xy_m, self._discarded_kind, self._discarded_id,
            self._discarded_until_ns, now_ns, self._r_assoc_m, self.blocked,
        )  # fmt: skip

    def discard(
        self, kind: int, candidate_id: int, xy_m: tuple[float, float], until_ns: int
    ) -> None:
        """Leave a candidate alone until `until_ns`.

        An instance is known by its id; frontiers are redrawn, so all within `r_assoc_m` of the
        point are left alone.
        """
        i = self._discarded_next
        self._discarded_xy_m[i] = xy_m
        self._discarded_kind[i] = kind
        self._discarded_id[i] = candidate_id
        self._discarded_until_ns[i] = until_ns
        self._discarded_next = (i + 1) % _DISCARDED

    def index_of(self, kind: int, candidate_id: int) -> int:
        """Where a candidate stands now, or -1 when it is gone."""
        found = np.flatnonzero((self.id[: self.n] == candidate_id) & (self.kind[: self.n] == kind))
        return int(found[0]) if len(found) else -1

    def nearest(self, kind: int, xy_m: tuple[float, float], within_m: float) -> int:
        """The candidate of a kind that is nearest to a point, or -1 when none is so near."""
        apart = np.hypot(self.xy_m[: self.n, 0] - xy_m[0], self.xy_m[: self.n, 1] - xy_m[1])
        apart[self.kind[: self.n] != kind] = np.inf
        if self.n == 0 or apart.min() > within_m:
            return -1
        return int(apart.argmin())

    def lift_discards(self) -> None:
        """Give every discarded candidate another chance."""
        self._discarded_until_ns[:] = 0

    def clear(self) -> None:
        """Forget every candidate and every discarded point."""
        self.n = 0
        self.lift_discards()


@njit(nogil=True, cache=True)
def _associate(old_xy, old_anchor, n_old, new_xy, n_new, radius, match, claim):
    """match[new] = the old entry it continues, or -1; each old one is continued at most once.

    Of all pairs within the radius the nearest are joined first: a new entry that loses its old
    one to a nearer rival looks for another.
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


@njit(nogil=True, cache=True)
def _nearest_unclaimed(old_xy, old_anchor, n_old, new_xy, i, r2, claim):
    """The nearest old entry within reach of a new one that no nearer entry has claimed, or -1."""
    found, best = -1, r2
    for j in range(n_old):
        ax, ay = new_xy[i, 0] - old_anchor[j, 0], new_xy[i, 1] - old_anchor[j, 1]
        if ax * ax + ay * ay >= r2:
            continue
        dx, dy = new_xy[i, 0] - old_xy[j, 0], new_xy[i, 1] - old_xy[j, 1]
        d2 = dx * dx + dy * dy
        if d2 >= best:
            continue
        rival = claim[j]
        if rival >= 0:
            rx, ry = new_xy[rival, 0] - old_xy[j, 0], new_xy[rival, 1] - old_xy[j, 1]
            if rx * rx + ry * ry <= d2:
                continue
        found, best = j, d2
    return found


@njit(nogil=True, cache=True)
def _carry_over(
    match, n_new, next_id, stamp_ns, old_anchor, old_id, old_seen, old_vl,
    xy, anchor, ids, seen, vl,
):  # fmt: skip
    """Fill the new entries from the old ones they continue; returns the next free id."""
    for i in range(n_new):
        j = match[i]
        if j >= 0:
            anchor[i] = old_anchor[j]
            ids[i] = old_id[j]
            seen[i] = old_seen[j]
            vl[:, i] = old_vl[:, j]
        else:
            anchor[i] = xy[i]
            ids[i] = next_id
            seen[i] = stamp_ns
            vl[:, i] = np.nan
            next_id += 1
    return next_id


@njit(nogil=True, cache=True)
def _mark_blocked(
    xy, kind, ids, n, discarded_xy, discarded_kind, discarded_id, until_ns, now_ns, radius, blocked
):
    for i in range(n):
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
