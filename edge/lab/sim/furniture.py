"""3-D shapes of furniture for the simulator.

Each category has its usual depth, width and height [m], its usual colours, and its shape: rows of
boxes (`B`), cylinders (`C`) and ellipsoids (`E`). A row is (shape, centre, size, material[,
texture]). Centre and size are fractions of the depth, width and height; textures are constants of
`shading`. `edge.lab.sim.assemblies` explains more.
"""

from __future__ import annotations

from edge.lab.sim import shading as s
from edge.lab.sim.category import CLOTHS, VIVID, WHITES, WOODS, B, C, Category, E, legs


def _seat(*cushions: float) -> tuple[tuple, ...]:
    """Return the rows of a sofa with a cushion at each of the given y (fractions of the width)."""
    width = 0.78 / len(cushions) - 0.01
    return (
        (B, (0.03, 0, 0.22), (0.9, 0.96, 0.28), "dark", s.FABRIC),
        (B, (-0.38, 0, 0.52), (0.24, 1.0, 0.92), "main", s.FABRIC),
        (B, (0.04, 0.45, 0.38), (0.92, 0.1, 0.62), "main", s.FABRIC),
        (B, (0.04, -0.45, 0.38), (0.92, 0.1, 0.62), "main", s.FABRIC),
        *((B, (0.1, y, 0.43), (0.74, width, 0.16), "main", s.FABRIC) for y in cushions),
        *((B, (-0.22, y, 0.7), (0.14, width, 0.42), "light", s.FABRIC) for y in cushions),
        *legs(0.1, 0.05, "black", 0.06),
    )


def _drawers(count: int) -> tuple[tuple, ...]:
    """Return the rows of a chest with `count` drawer fronts."""
    step = 0.86 / count
    rows: list[tuple] = [
        (B, (0, 0, 0.5), (0.94, 0.98, 0.92), "main", s.GRAIN),
        (B, (0, 0, 0.975), (1.0, 1.0, 0.05), "dark", s.GRAIN),
        (B, (-0.02, 0, 0.03), (0.88, 0.92, 0.06), "dark"),
    ]
    for i in range(count):
        z = 0.09 + (i + 0.5) * step
        rows.append((B, (0.475, 0, z), (0.03, 0.9, step * 0.86), "light", s.GRAIN))
        rows.append((B, (0.495, 0, z), (0.03, 0.16, 0.03), "brass"))
    return tuple(rows)


def _doors(y_handles: tuple[float, float]) -> tuple[tuple, ...]:
    """Return the rows of a cupboard with two doors; `y_handles` are the y of their handles."""
    return (
        (B, (-0.01, 0, 0.51), (0.94, 0.98, 0.94), "main", s.GRAIN),
        (B, (0, 0, 0.985), (1.0, 1.0, 0.03), "dark", s.GRAIN),
        (B, (0.475, 0.245, 0.5), (0.03, 0.46, 0.88), "light", s.GRAIN),
        (B, (0.475, -0.245, 0.5), (0.03, 0.46, 0.88), "light", s.GRAIN),
        *((B, (0.495, y, 0.55), (0.03, 0.02, 0.12), "steel") for y in y_handles),
        (B, (-0.03, 0, 0.03), (0.86, 0.94, 0.06), "black"),
    )


def _wardrobe() -> tuple[tuple, ...]:
    """Return the rows of a wardrobe: two long doors over one wide drawer."""
    return (
        (B, (-0.02, 0, 0.5), (0.92, 0.96, 0.94), "main", s.GRAIN),
        (B, (0, 0, 0.975), (1.0, 1.0, 0.05), "dark", s.GRAIN),
        *((B, (0.455, y, 0.6), (0.03, 0.45, 0.68), "light", s.GRAIN) for y in (-0.235, 0.235)),
        *((B, (0.48, y, 0.6), (0.04, 0.02, 0.3), "steel") for y in (-0.05, 0.05)),
        (B, (0.455, 0, 0.15), (0.03, 0.92, 0.16), "dark", s.GRAIN),
        *((B, (0.48, y, 0.15), (0.04, 0.1, 0.015), "steel") for y in (-0.24, 0.24)),
        (B, (-0.03, 0, 0.02), (0.86, 0.92, 0.04), "black"),
    )


FURNITURE: dict[str, Category] = {
    "chair": Category(
        (0.46, 0.44, 0.92),
        (*WOODS, *VIVID),
        (
            (B, (0, 0, 0.49), (1.0, 1.0, 0.05), "main", s.GRAIN),
            *legs(0.47, 0.09, "dark"),
            (B, (-0.46, 0.42, 0.74), (0.08, 0.09, 0.5), "dark"),
            (B, (-0.46, -0.42, 0.74), (0.08, 0.09, 0.5), "dark"),
            (B, (-0.46, 0, 0.9), (0.06, 0.92, 0.17), "main", s.GRAIN),
            (B, (-0.46, 0, 0.7), (0.06, 0.92, 0.1), "main", s.GRAIN),
        ),
    ),
    "armchair": Category((0.82, 0.8, 0.86), CLOTHS, _seat(0.0)),
    "sofa": Category((0.9, 1.9, 0.84), CLOTHS, _seat(-0.26, 0.0, 0.26)),
    "bed": Category(
        (2.0, 1.5, 0.95),
        CLOTHS,
        (
            (B, (0, 0, 0.2), (0.98, 0.98, 0.22), "wood", s.GRAIN),
            (B, (-0.485, 0, 0.5), (0.03, 1.0, 1.0), "wood", s.GRAIN),
            (B, (0.01, 0, 0.41), (0.95, 0.94, 0.2), "sheet", s.FABRIC),
            (B, (0.13, 0, 0.45), (0.72, 0.97, 0.16), "main", s.FABRIC),
            (B, (-0.2, 0, 0.54), (0.08, 0.97, 0.03), "light", s.FABRIC),
            (E, (-0.36, 0.23, 0.58), (0.2, 0.4, 0.18), "sheet"),
            (E, (-0.36, -0.23, 0.58), (0.2, 0.4, 0.18), "sheet"),
            *legs(0.1, 0.04, "wood", 0.04),
        ),
    ),
    "table": Category(
        (0.9, 1.5, 0.75),
        WOODS,
        (
            (B, (0, 0, 0.97), (1.0, 1.0, 0.06), "main", s.GRAIN),
            (B, (0, 0, 0.9), (0.86, 0.9, 0.09), "dark", s.GRAIN),
            *legs(0.94, 0.07, "dark", 0.07),
        ),
    ),
    "coffee table": Category(
        (0.6, 1.1, 0.42),
        WOODS,
        (
            (B, (0, 0, 0.95), (1.0, 1.0, 0.1), "main", s.GRAIN),
            (B, (0, 0, 0.32), (0.84, 0.88, 0.06), "dark", s.GRAIN),
            *legs(0.9, 0.08, "dark"),
        ),
    ),
    "desk": Category(
        (0.65, 1.3, 0.75),
        WOODS,
        (
            (B, (0, 0, 0.97), (1.0, 1.0, 0.06), "main", s.GRAIN),
            (B, (0, 0.34, 0.47), (0.92, 0.28, 0.94), "dark", s.GRAIN),
            *((B, (0.47, 0.34, z), (0.02, 0.25, 0.24), "light") for z in (0.24, 0.5, 0.76)),
            *((B, (0.49, 0.34, z), (0.03, 0.08, 0.03), "steel") for z in (0.24, 0.5, 0.76)),
            (B, (0, -0.47, 0.47), (0.92, 0.04, 0.94), "dark", s.GRAIN),
            (B, (-0.44, -0.1, 0.65), (0.03, 0.7, 0.5), "dark", s.GRAIN),
        ),
    ),
    "tv stand": Category(
        (0.42, 1.6, 0.5),
        WOODS,
        (
            (B, (0, 0, 0.95), (1.0, 1.0, 0.1), "main", s.GRAIN),
            (B, (0, 0, 0.1), (0.98, 0.98, 0.08), "main", s.GRAIN),
            (B, (-0.46, 0, 0.5), (0.06, 0.96, 0.8), "dark"),
            *((B, (0, y, 0.5), (0.96, 0.03, 0.84), "main", s.GRAIN) for y in (-0.48, 0.48)),
            (B, (0.02, 0.33, 0.5), (0.92, 0.28, 0.76), "light", s.GRAIN),
            (B, (0.02, -0.33, 0.5), (0.92, 0.28, 0.76), "light", s.GRAIN),
            (B, (-0.1, 0, 0.22), (0.5, 0.24, 0.16), "black"),
        ),
    ),
    "bookshelf": Category(
        (0.3, 0.9, 1.8),
        WOODS,
        (
            (B, (-0.46, 0, 0.5), (0.08, 1.0, 1.0), "dark", s.GRAIN),
            (B, (0, 0.48, 0.5), (1.0, 0.04, 1.0), "main", s.GRAIN),
            (B, (0, -0.48, 0.5), (1.0, 0.04, 1.0), "main", s.GRAIN),
            *((B, (0, 0, z), (1.0, 0.94, 0.022), "main", s.GRAIN) for z in (0.02, 0.26, 0.5, 0.74)),
            (B, (0, 0, 0.99), (1.0, 1.0, 0.022), "main", s.GRAIN),
            *((B, (-0.08, 0.04, z), (0.66, 0.84, 0.16), "white", s.BOOKS) for z in (0.11, 0.59)),
            (B, (-0.08, -0.1, 0.35), (0.66, 0.68, 0.15), "white", s.BOOKS),
            (B, (-0.08, 0.12, 0.83), (0.66, 0.6, 0.15), "white", s.BOOKS),
        ),
    ),
    "cabinet": Category((0.45, 0.95, 1.1), (*WOODS, *WHITES), _doors((0.05, -0.05))),
    "wardrobe": Category((0.6, 1.4, 2.0), (*WOODS, *WHITES), _wardrobe()),
    "dresser": Category((0.48, 1.1, 0.85), (*WOODS, *WHITES), _drawers(4)),
    "nightstand": Category((0.4, 0.45, 0.5), (*WOODS, *WHITES), _drawers(2)),
    "stool": Category(
        (0.36, 0.36, 0.6),
        (*WOODS, *VIVID),
        (
            (C, (0, 0, 0.95), (1.0, 1.0, 0.1), "main", s.GRAIN),
            *legs(0.92, 0.1, "dark", 0.2),
            (C, (0, 0, 0.3), (0.7, 0.7, 0.03), "steel"),
        ),
    ),
}
