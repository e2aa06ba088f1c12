"""Load shedding: decides when to drop work under overload, and when to add it again.

This module only computes: the caller passes the time, and there is no access to models. At level 0,
all configured work runs. At level n, the first n entries of `perception.load_shedding.levels` are
applied: each one names a cheaper detector, or a scorer to pause.
"""

from __future__ import annotations

from typing import NamedTuple

OVER_S = 3.0
"""More work is dropped after this time of overload."""
DWELL_S = 15.0
"""Shortest time between two changes of the level."""
LOW_S = 60.0
"""Work is added again after this time of low load."""
LOW_LOAD = 0.7
"""The load is low if the detector takes at most this share of its budget."""
MOST_DOUBLINGS = 6
"""`LOW_S` is doubled after each failed attempt to add work, at most this often (64 minutes)."""
UNLIKELY_DOUBLINGS = 4
"""If earlier detector times predict no low load with the added work, `LOW_S` is doubled at least
this often. The work is then tried rarely, but it is tried: the load may have changed."""


class LoadSample(NamedTuple):
    """The load of the last interval, about a second.

    Attributes:
        detect_ms: Median time of the detector; None if it finished no image.
        distress: Other reason to shed load, apart from `detect_ms`; "" if there is none.
        has_headroom: True if the board is far from its limits.
    """

    detect_ms: float | None
    distress: str = ""
    has_headroom: bool = True


class LevelChange(NamedTuple):
    """A change to a neighbouring level, with the reason. A higher level drops more work."""

    level: int
    why: str


class DegradationLevels:
    """Chooses how much work to drop.

    Level 0 drops nothing. Each higher level applies one more entry of
    `perception.load_shedding.levels`. There are at least `DWELL_S` between two changes. The load
    must be low for some time (at first `LOW_S`) before work is added again. If work must then be
    dropped within twice that time, it was added too early, and the next wait is doubled.

    Args:
        n_levels: Number of levels, without level 0.

    Attributes:
        budget_ms: Time budget of the detector; may be set.

    Example:
        >>> levels = DegradationLevels(n_levels=2, budget_ms=33.0)
        >>> moves = [levels.update(LoadSample(50.0), k * 1_000_000_000) for k in range(4)]
        >>> moves[:3], moves[3].level
        ([None, None, None], 1)
    """

    def __init__(self, n_levels: int, budget_ms: float) -> None:
        self.level, self.budget_ms = 0, budget_ms
        self._n_levels = n_levels
        self._over_ns, self._dwell_ns, self._low_for_ns = map(_ns, (OVER_S, DWELL_S, LOW_S))
        self._overload_since_ns: int | None = None  # start of the present overload
        self._low_since_ns: int | None = None  # start of the present low load
        self._changed_ns: int | None = None  # time of the newest change of the level
        # Time when work was last added, and time for which it must stay.
        self._added: tuple[int, int] | None = None
        self._doublings = 0  # of `LOW_S`; one more after each attempt that failed
        self._ms_before_change: float | None = None  # detector time before the newest higher level
        # By level: detector time on it, divided by that on the next higher level (at least 1). It
        # predicts how much slower the detector becomes if the service goes back to this level.
        self._slowdown = [1.0] * self._n_levels

    def update(self, sample: LoadSample, now_ns: int) -> LevelChange | None:
        """Return the change of the level that is due, or None.

        After a change was returned, the caller must call `arrived` or `change_failed` before the
        next call.
        """
        took_ms = sample.detect_ms
        if took_ms is not None and self._ms_before_change is not None:
            self._slowdown[self.level - 1] = max(1.0, self._ms_before_change / max(took_ms, 1e-3))
            self._ms_before_change = None
        why = self._overload_reason(sample)
        low = not why and sample.has_headroom and self._is_low(took_ms)
        self._overload_since_ns = _since(self._overload_since_ns, bool(why), now_ns)
        self._low_since_ns = _since(self._low_since_ns, low, now_ns)
        if self._changed_ns is not None and now_ns - self._changed_ns < self._dwell_ns:
            return None
        if self._overload_since_ns is not None and self.level < self._n_levels:
            if now_ns - self._overload_since_ns < self._over_ns:
                return None
            self._ms_before_change = took_ms
            return LevelChange(self.level + 1, f"{why}, for over {OVER_S:g} s")
        if self._low_since_ns is not None and took_ms is not None and self.level > 0:
            waited_ns = now_ns - self._low_since_ns
            if waited_ns >= self._wait_ns(took_ms):
                return LevelChange(self.level - 1, f"the load was low for {waited_ns * 1e-9:.0f} s")
        return None

    def arrived(self, level: int, now_ns: int) -> None:
        """Record that a level was reached."""
        if level < self.level:
            self._added = now_ns, 2 * (self._low_for_ns << self._doublings)
        elif self._added is not None:
            added_ns, must_stay_ns = self._added
            self._count_attempt(failed=now_ns - added_ns < must_stay_ns)
            self._added = None
        self.level = level
        self._restart(now_ns)

    def change_failed(self, now_ns: int) -> None:
        """Record that the change cannot be made."""
        self._ms_before_change = None
        self._count_attempt(failed=True)
        self._restart(now_ns)

    def reset_times(self) -> None:
        """Forget the measured times, since the computer has become faster or slower."""
        self._slowdown = [1.0] * self._n_levels
        self._doublings = 0

    def _overload_reason(self, sample: LoadSample) -> str:
        """Return the reason why the computer is overloaded; "" if it is not."""
        if sample.distress or sample.detect_ms is None or sample.detect_ms <= self.budget_ms:
            return sample.distress
        return (
            f"detect takes {sample.detect_ms:.0f} ms (median), above perception.swap.budget_ms "
            f"({self.budget_ms:g})"
        )

    def _is_low(self, detect_ms: float | None) -> bool:
        return detect_ms is not None and detect_ms <= LOW_LOAD * self.budget_ms

    def _wait_ns(self, took_ms: float) -> int:
        """Return how long the load must be low before work is added again."""
        would_be_low = self._is_low(took_ms * self._slowdown[self.level - 1])
        return self._low_for_ns << (
            self._doublings if would_be_low else max(self._doublings, UNLIKELY_DOUBLINGS)
        )

    def _count_attempt(self, failed: bool) -> None:
        self._doublings = min(self._doublings + 1, MOST_DOUBLINGS) if failed else 0

    def _restart(self, now_ns: int) -> None:
        self._changed_ns, self._overload_since_ns, self._low_since_ns = now_ns, None, None


def _since(before_ns: int | None, is_true: bool, now_ns: int) -> int | None:
    """Return the time since which a condition has been true without a break; None if it is not."""
    if not is_true:
        return None
    return now_ns if before_ns is None else before_ns


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
