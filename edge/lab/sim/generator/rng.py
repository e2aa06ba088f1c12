"""Random draws and rectangles for generated worlds that are the same on every computer.

Draws use uniform doubles only, because NumPy does not keep other streams stable between versions.
Objects are turned by quarter turns only, because a sine may differ in its last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

T = TypeVar("T")

QUARTERS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""(x, y) of the direction after 0 … 3 quarter turns from +x."""


class PortableRng:
    """Random numbers that depend only on the key, a sequence of integers such as a seed."""

    def __init__(self, *key: int) -> None:
        self._generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))

    def unit(self) -> float:
        """Draw from [0, 1), uniformly."""
        return float(self._generator.random())

    def between(self, low: float, high: float) -> float:
        """Draw from [low, high), uniformly."""
        return low + self.unit() * (high - low)

    def chance(self, p: float) -> bool:
        """Draw True with the probability `p`."""
        return self.unit() < p

    def count(self, low: int, high: int) -> int:
        """Draw an integer from `low` to `high`, both included."""
        return low + int(self.unit() * (high - low + 1))

    def pick(self, choices: Sequence[T]) -> T:
        """Draw one of the choices, each with the same probability."""
        return choices[self.count(0, len(choices) - 1)]

    def shuffled(self, items: Sequence[T]) -> list[T]:
        """Return the items in random order."""
        keys = [self.unit() for _ in items]
        return [items[k] for k in sorted(range(len(items)), key=keys.__getitem__)]


@dataclass(frozen=True, slots=True)
class Rect:
    """An axis-parallel rectangle, in metres."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width_m(self) -> float:
        return self.x1 - self.x0

    @property
    def depth_m(self) -> float:
        return self.y1 - self.y0

    def grown(self, by_m: float) -> Rect:
        """Return the rectangle with each side moved outwards; inwards if `by_m` is negative."""
        return Rect(self.x0 - by_m, self.y0 - by_m, self.x1 + by_m, self.y1 + by_m)

    def meets(self, other: Rect) -> bool:
        """Return True if the rectangles share more than an edge."""
        return (
            self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1
        )

    def holds(self, other: Rect) -> bool:
        """Return True if the other rectangle is inside this one."""
        return (
            self.x0 <= other.x0
            and self.y0 <= other.y0
            and other.x1 <= self.x1
            and other.y1 <= self.y1
        )


def wall_span_m(room: Rect, side: int) -> float:
    """Return the length of a wall: 0 at x0, 1 at y0, 2 at x1, 3 at y1.

    This number is also the quarter turns of furniture that has its back to the wall.
    """
    return room.width_m if side % 2 else room.depth_m


def at_wall(room: Rect, side: int, along_m: float, off_m: float) -> tuple[float, float]:
    """Return x and y of a place in a room, relative to one of its walls (see `wall_span_m`).

    `along_m` counts from the wall's end with the smaller coordinate, `off_m` from the wall.
    """
    return (
        (room.x0 + off_m, room.y0 + along_m),
        (room.x0 + along_m, room.y0 + off_m),
        (room.x1 - off_m, room.y0 + along_m),
        (room.x0 + along_m, room.y1 - off_m),
    )[side]
