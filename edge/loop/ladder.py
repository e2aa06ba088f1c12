"""When to give something up so that the computer keeps up, and when to take it back.

Arithmetic alone: time is handed in, and nothing is known of models. Rung 0 of the ladder is all
that is configured; on rung n the first n things of it are given up.
"""

from __future__ import annotations

from typing import NamedTuple

OVER_S, DWELL_S, ROOM_S = 3.0, 15.0, 60.0
"""How long it is too much before a step down, how long between steps, and how long there is room
before a step up."""
ROOM = 0.7
"""There is room if the detector takes less than this share of its budget."""
MOST_DOUBLINGS = 6
"""Of `ROOM_S`, however often a step up was in vain: an hour or so."""
UNLIKELY = 4
"""Doublings to wait for a step up that should not fit, by what its rung cost before: the load may
be another by now, so it is tried all the same, but seldom."""


class Second(NamedTuple):
    """What the last second or so was like.

    Attributes:
        detect_ms: the detector's median time; None: it has found nothing out.
        distress: why it must not go on like this, but for that time; empty where it may.
        cool: the board is far from distress.
    """

    detect_ms: float | None
    distress: str = ""
    cool: bool = True


class Move(NamedTuple):
    """A step to the rung before or after the present one, and why."""

    rung: int
    why: str


class Ladder:
    """Steps down what is too much, and up again where there is room.

    No two steps come within `DWELL_S`. A step up that does not last as long as twice what was
    waited for it was in vain, and doubles the next wait.

    Attributes:
        rung: the present one.
        budget_ms: what the detector may take; may be set.
    """

    def __init__(self, rungs: int, budget_ms: float) -> None:
        self.rung, self.budget_ms = 0, budget_ms
        self._rungs = rungs
        self._over_ns, self._dwell_ns, self._room_ns = map(_ns, (OVER_S, DWELL_S, ROOM_S))
        self._strained_ns: int | None = None  # since when, without a break
        self._roomy_ns: int | None = None
        self._moved_ns: int | None = None
        self._rose: tuple[int, int] | None = None  # when, and how long that must last
        self._doublings = 0
        self._left_ms: float | None = None  # what detect took on the rung above, when it was left
        self._ratio = [1.0] * self._rungs  # what detect takes on a rung, by what on the next

    def look(self, second: Second, now_ns: int) -> Move | None:
        """The step that is due.

        Whoever takes it says so by `arrived`, or `refused`, before the next look.
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
            return Move(self.rung + 1, f"{why}, for {OVER_S:g} s and more")
        if self._roomy_ns is not None and took_ms is not None and self.rung > 0:
            waited_ns = now_ns - self._roomy_ns
            if waited_ns >= self._wait_ns(took_ms):
                return Move(self.rung - 1, f"there was room for {waited_ns * 1e-9:.0f} s")
        return None

    def arrived(self, rung: int, now_ns: int) -> None:
        """A step was taken."""
        if rung < self.rung:
            self._rose = now_ns, 2 * (self._room_ns << self._doublings)
        elif self._rose is not None:
            rose_ns, lasting_ns = self._rose
            self._count(in_vain=now_ns - rose_ns < lasting_ns)
            self._rose = None
        self.rung = rung
        self._begin_anew(now_ns)

    def refused(self, now_ns: int) -> None:
        """A step cannot be taken."""
        self._left_ms = None
        self._count(in_vain=True)
        self._begin_anew(now_ns)

    def forget(self) -> None:
        """What was learnt of this computer is void: it has become faster or slower."""
        self._ratio = [1.0] * self._rungs
        self._doublings = 0

    def _strain(self, second: Second) -> str:
        if second.distress or second.detect_ms is None or second.detect_ms <= self.budget_ms:
            return second.distress
        return (
            f"detect takes {second.detect_ms:.0f} ms at the median, perception.swap.budget_ms is "
            f"{self.budget_ms:g}"
        )

    def _fits(self, detect_ms: float | None) -> bool:
        return detect_ms is not None and detect_ms <= ROOM * self.budget_ms

    def _wait_ns(self, took_ms: float) -> int:
        """How long there must be room before the next step up."""
        fits = self._fits(took_ms * self._ratio[self.rung - 1])
        return self._room_ns << (self._doublings if fits else max(self._doublings, UNLIKELY))

    def _count(self, in_vain: bool) -> None:
        self._doublings = min(self._doublings + 1, MOST_DOUBLINGS) if in_vain else 0

    def _begin_anew(self, now_ns: int) -> None:
        self._moved_ns, self._strained_ns, self._roomy_ns = now_ns, None, None


def _since(before_ns: int | None, holds: bool, now_ns: int) -> int | None:
    if not holds:
        return None
    return now_ns if before_ns is None else before_ns


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)
