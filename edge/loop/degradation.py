"""Decision when to shed load and when to restore it.

This module only computes: the caller passes the time, and there is no access to models. At level 0,
all configured work runs. At level n, the first n entries of the
list `perception.governor.ladder` are dropped.
"""

from __future__ import annotations

from typing import NamedTuple

OVER_S, DWELL_S, ROOM_S = 3.0, 15.0, 60.0
"""Time of overload before a step down, shortest time between two steps, and time of low load before
a step up."""
ROOM = 0.7
"""The load is low if the detector takes at most this share of its budget."""
MOST_DOUBLINGS = 6
"""Largest number of doublings of `ROOM_S` after failed steps up: about an hour."""
UNLIKELY = 4
"""Doublings of `ROOM_S` before a step up that should not fit, by the earlier times of that level.
The step is tried seldom, because the load may have changed."""


class LoadSample(NamedTuple):
    """The load of the last interval, about a second.

    Attributes:
        detect_ms: Median time of the detector; None if it finished no image.
        distress: Other reason to shed load, apart from `detect_ms`; "" if there is none.
        cool: True if the board is far from its limits.
    """

    detect_ms: float | None
    distress: str = ""
    cool: bool = True


class LevelChange(NamedTuple):
    """A step to a neighbouring degradation level, with the reason."""

    rung: int
    why: str


class DegradationLevels:
    """Choice of the degradation level: one higher under overload, one lower at low load.

    There are at least `DWELL_S` between two steps. A step up has failed if it does not last twice
    as long as the wait before it. The next wait is then doubled.

    Args:
        rungs: Number of levels, without level 0.
        budget_ms: See `Attributes`.

    Attributes:
        rung: Current level.
        budget_ms: Time budget of the detector; may be set.

    Example:
        >>> levels = DegradationLevels(rungs=2, budget_ms=33.0)
        >>> moves = [levels.look(LoadSample(50.0), k * 1_000_000_000) for k in range(4)]
        >>> moves[:3], moves[3].rung
        ([None, None, None], 1)
    """

    def __init__(self, rungs: int, budget_ms: float) -> None:
        self.rung, self.budget_ms = 0, budget_ms
        self._rungs = rungs
        self._over_ns, self._dwell_ns, self._room_ns = map(_ns, (OVER_S, DWELL_S, ROOM_S))
        self._strained_ns: int | None = None  # since when, without a break
        self._roomy_ns: int | None = None
        self._moved_ns: int | None = None
        self._rose: tuple[int, int] | None = (
            None  # time of the last step up, and how long it must last
        )
        self._doublings = 0
        self._left_ms: float | None = None  # detector time on the previous rung, when it was left
        self._ratio = [1.0] * self._rungs  # detector time on a rung, divided by that on the next

    def look(self, second: LoadSample, now_ns: int) -> LevelChange | None:
        """Return the step that is due, or None.

        The caller must call `arrived` or `refused` before the next call.
        """
        took_ms = second.detect_ms
        if took_ms is not None and self._left_ms is not None:
            self._ratio[self.rung - 1] = max(1.0, self._left_ms / max(took_ms, 1e-3))
            self._left_ms = None
        why = self._strain(second)
        roomy = not why and second.cool and self._fits(took_ms)
        self._strained_ns = _since(self._strained_ns, bool(why), now_ns)
        self._roomy_ns = _since(self._roomy_ns, roomy, now_ns)
        if self._moved_ns is not None and now_ns - self._moved_ns < self._dwell_ns:
            return None
        if self._strained_ns is not None and self.rung < self._rungs:
            if now_ns - self._strained_ns < self._over_ns:
                return None
            self._left_ms = took_ms
            return LevelChange(self.rung + 1, f"{why}, for over {OVER_S:g} s")
        if self._roomy_ns is not None and took_ms is not None and self.rung > 0:
            waited_ns = now_ns - self._roomy_ns
            if waited_ns >= self._wait_ns(took_ms):
                return LevelChange(self.rung - 1, f"the load was low for {waited_ns * 1e-9:.0f} s")
        return None

    def arrived(self, rung: int, now_ns: int) -> None:
        """Record that a step was taken."""
        if rung < self.rung:
            self._rose = now_ns, 2 * (self._room_ns << self._doublings)
        elif self._rose is not None:
            rose_ns, lasting_ns = self._rose
            self._count(failed=now_ns - rose_ns < lasting_ns)
            self._rose = None
        self.rung = rung
        self._restart(now_ns)

    def refused(self, now_ns: int) -> None:
        """Record that a step cannot be taken."""
        self._left_ms = None
        self._count(failed=True)
        self._restart(now_ns)

    def forget(self) -> None:
        """Forget the measured times, since the computer has become faster or slower."""
        self._ratio = [1.0] * self._rungs
        self._doublings = 0

    def _strain(self, second: LoadSample) -> str:
        if second.distress or second.detect_ms is None or second.detect_ms <= self.budget_ms:
            return second.distress
        return (
            f"detect takes {second.detect_ms:.0f} ms (median), above perception.swap.budget_ms "
            f"({self.budget_ms:g})"
        )

    def _fits(self, detect_ms: float | None) -> bool:
        return detect_ms is not None and detect_ms <= ROOM * self.budget_ms

    def _wait_ns(self, took_ms: float) -> int:
        """Return how long the load must be low before the next step up."""
        fits = self._fits(took_ms * self._ratio[self.rung - 1])
        return self._room_ns << (self._doublings if fits else max(self._doublings, UNLIKELY))

    def _count(self, failed: bool) -> None:
        self._doublings = min(self._doublings + 1, MOST_DOUBLINGS) if failed else 0

    def _restart(self, now_ns: int) -> None:
        self._moved_ns, self._strained_ns, self._roomy_ns = now_ns, None, None


def _since(before_ns: int | None, holds: bool, now_ns: int) -> int | None:
    if not holds:
        return None
    return now_ns if before_ns is None else before_ns


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
