"""Shapes of objects: each category as an assembly of primitives, for any size and colour.

A row describes one primitive: (shape, centre, size, material[, texture]). Centres and sizes are
fractions of the object's depth, width and height: x points forward (the side that people use it
from), y left, z up from its underside, so (0, 0, 0.5) is the middle. `main` is the object's colour,
`dark` and `light` are derived from it, and all other materials are fixed.
"""

from __future__ import annotations

import numpy as np

from edge.lab.sim.boxworld import Primitive
from edge.lab.sim.category import RGB, Category
from edge.lab.sim.furniture import FURNITURE
from edge.lab.sim.household import HOUSEHOLD

CATEGORIES: dict[str, Category] = {**FURNITURE, **HOUSEHOLD}

# Colours of the materials that do not depend on the object's colour.
FIXED: dict[str, RGB] = {
    "black": (28, 28, 32),
    "steel": (176, 180, 186),
    "chrome": (208, 212, 218),
    "white": (238, 238, 236),
    "wood": (150, 104, 62),
    "pine": (196, 156, 104),
    "leaf": (62, 128, 56),
    "soil": (72, 52, 40),
    "glow": (255, 244, 214),
    "screen": (24, 32, 52),
    "glass": (58, 70, 82),
    "sheet": (240, 240, 244),
    "water": (196, 220, 232),
    "brass": (196, 160, 82),
}


def build(category: str, size_m: tuple[float, float, float], color: RGB) -> list[Primitive]:
    """Return the primitives of an object that stands at the origin and faces +x.

    Raises:
        KeyError: no such category.
    """
    materials = {
        **FIXED,
        "main": color,
        "dark": tuple(0.62 * c for c in color),
        "light": tuple(c + 0.18 * (255.0 - c) for c in color),
    }
    scale = np.asarray(size_m)
    parts = []
    for shape, center, size, material, *texture in CATEGORIES[category].rows:
        x, y, z = (float(v) for v in scale * center)
        a, b, c = (float(v) for v in scale * size)
        parts.append(Primitive(shape, (x, y, z), (a, b, c), materials[material], *texture))
    return parts
