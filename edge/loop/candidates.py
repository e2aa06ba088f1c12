"""Gathers the candidates: frontier and instance target points with an identity that lasts.

A frontier moves as the map grows. It keeps its identity while it stays within `r_assoc_m` of where
it was first seen.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from edge.mapping.grid import Frontiers
from edge.policies.base import FRONTIER, INSTANCE, Candidates
from edge.types import Instance

_DISCARDED = 64


class CandidatePool:
    """Today's candidates, what they continue of yesterday's, and which are left alone.

    Attributes:
        candidates: refreshed in place by every update.
        shown: the same, read-only.
        anchor_m: (capacity, 2) float32, where each frontier was first seen.
    """

    def __init__(self, capacity: int, r_assoc_m: float) -> None:
        c = self.candidates = Candidates(capacity)
        self.shown = c.read_only()
        self.anchor_m = np.zeros((capacity, 2), np.float32)
        self._lasting = (c.xy_m, self.anchor_m, c.id, c.first_seen_ns)
        self._before = tuple(np.empty_like(array) for array in self._lasting)
        self._r_assoc_m = r_assoc_m
        self._next_id = 1
        self._match = np.full(capacity, -1, np.int32)
        self._claim = np.full(capacity, -1, np.int32)
        self._discarded_xy_m = np.zeros((_DISCARDED, 2), np.float32)
        self._discarded_kind = np.zeros(_DISCARDED, np.int8)
        self._discarded_id = np.zeros(_DISCARDED, np.int64)
        self._discarded_until_ns = np.zeros(_DISCARDED, np.int64)
        self._discarded_next = 0

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
        c = self.candidates
        capacity = len(c.id)
        n_old = int(np.count_nonzero(c.kind[: c.n] == FRONTIER))
        n_instances = min(len(instances), capacity)
        n_new = min(frontiers.n, capacity - n_instances)
        for array, saved in zip(self._lasting, self._before, strict=True):
            saved[:n_old] = array[:n_old]
        old_xy_m, *before = self._before
        _associate(
            old_xy_m, before[0], n_old, frontiers.xy_m, n_new,
            self._r_assoc_m, self._match, self._claim,
        )  # fmt: skip
        c.xy_m[:n_new] = frontiers.xy_m[:n_new]
        c.kind[:n_new] = FRONTIER
        c.sure[:n_new] = False
        c.confidence[:n_new] = 0.0
        self._next_id = _carry_over(
            self._match, n_new, self._next_id, stamp_ns, *before,
            c.xy_m, self.anchor_m, c.id, c.first_seen_ns,
        )  # fmt: skip
        # Where the sensors' clock was set back, nothing was first seen in the future.
        first_seen_ns = c.first_seen_ns[:n_new]
        np.minimum(first_seen_ns, stamp_ns, out=first_seen_ns)
        c.stamp_ns = stamp_ns
        for i, instance in enumerate(instances[:n_instances], start=n_new):
            c.xy_m[i] = instance.center_m[:2]
            c.kind[i] = INSTANCE
            c.id[i] = instance.id
            c.first_seen_ns[i] = instance.first_seen_ns
            c.confidence[i] = instance.score
            c.sure[i] = instance.state in ("confirmed", "reached")
        c.n = n_new + n_instances
        _mark_blocked(
            c.xy_m, c.kind, c.id, c.n,
            self._discarded_xy_m, self._discarded_kind, self._discarded_id,
            self._discarded_until_ns, now_ns, self._r_assoc_m, c.blocked,
        )  # fmt: skip
        self.shown.n, self.shown.stamp_ns = c.n, c.stamp_ns

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

    def lift_discards(self) -> None:
        """Give every discarded candidate another chance."""
        self._discarded_until_ns[:] = 0

    def clear(self) -> None:
        """Forget every candidate and every discarded point."""
        self.candidates.n = self.shown.n = 0
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
    match, n_new, next_id, stamp_ns, old_anchor, old_id, old_seen, xy, anchor, ids, seen
):
    """Fill the new entries from the old ones they continue; returns the next free id."""
    for i in range(n_new):
        j = match[i]
        if j >= 0:
            anchor[i] = old_anchor[j]
            ids[i] = old_id[j]
            seen[i] = old_seen[j]
        else:
            anchor[i] = xy[i]
            ids[i] = next_id
            seen[i] = stamp_ns
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
