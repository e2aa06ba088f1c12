"""Building blocks of the tables of object shapes (`furniture`, `household`).

`edge.lab.sim.assemblies` explains the rows of these tables and builds objects from them.
"""

from __future__ import annotations

from dataclasses import dataclass

from edge.lab.sim import kernels as k

B, C, E = k.BOX, k.CYLINDER, k.ELLIPSOID  # shapes; short names for the long tables
RGB = tuple[float, float, float]
"""Red, green and blue, 0 to 255."""

# Usual colours of objects made of a material; VIVID is for plastic and the like.
WOODS: tuple[RGB, ...] = ((150, 104, 62), (112, 74, 46), (196, 156, 104), (90, 60, 42))
CLOTHS: tuple[RGB, ...] = ((86, 108, 142), (150, 66, 58), (122, 132, 98), (168, 150, 126))
WHITES: tuple[RGB, ...] = ((236, 236, 234), (222, 226, 228))
METALS: tuple[RGB, ...] = ((182, 186, 192), (228, 230, 230), (64, 68, 76))
VIVID: tuple[RGB, ...] = ((206, 62, 48), (46, 104, 186), (236, 150, 34), (58, 150, 90))


@dataclass(frozen=True, slots=True)
class Category:
    """Shape of one kind of object.

    Attributes:
        size_m: usual depth, width, height.
        colors: usual colours; the first is the default.
        rows: primitives, each (shape, centre, size, material[, texture]); centre and size are
            fractions of `size_m`, see `edge.lab.sim.assemblies`.
    """

    size_m: tuple[float, float, float]
    colors: tuple[RGB, ...]
    rows: tuple[tuple, ...]


def legs(height: float, size: float, material: str, inset: float = 0.08) -> tuple[tuple, ...]:
    """Return the rows of four legs, up to `height`, with a square section of side `size`.

    The middle of a leg is `inset` from the object's sides. All are fractions of the object's size.
    """
    d = 0.5 - inset  # from the object's middle to a leg's
    return tuple(
        (B, (x, y, height / 2), (size, size, height), material)
        for x, y in ((d, d), (d, -d), (-d, d), (-d, -d))
    )
