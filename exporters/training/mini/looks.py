"""Words of the small detector's phrases, and the answers to the question if a phrase is true.

A phrase is three numbers (category, colour, size), each an index into the words from 1, or 0 for no
word. A style is the size word that an object was made with. The answer for an object is YES, NO or
UNSURE. Unsure answers are neither taught nor measured
(is a teal object blue? is a tall one large?).
"""

from __future__ import annotations

import cv2
import numpy as np

from edge import names
from edge.lab.sim import assemblies
from edge.perception.embedding.attributes import ALIKE, Vocabulary

# Colour word -> its typical r, g, b.
PALETTE: dict[str, tuple[float, float, float]] = {
    "red": (200, 48, 44),
    "orange": (236, 140, 38),
    "yellow": (238, 208, 62),
    "green": (60, 146, 82),
    "blue": (46, 102, 186),
    "purple": (122, 70, 162),
    "pink": (234, 150, 178),
    "brown": (124, 82, 50),
    "beige": (206, 184, 148),
    "white": (236, 236, 234),
    "gray": (126, 129, 133),
    "black": (34, 34, 38),
}
STYLES: dict[str, tuple[float, float, float, float]] = {
    "tall": (1.0, 1.0, 1.35, 1.7),
    "short": (1.0, 1.0, 0.5, 0.7),
    "wide": (1.35, 1.7, 1.0, 1.0),
    "narrow": (0.5, 0.7, 1.0, 1.0),
    "large": (1.25, 1.5, 1.25, 1.5),
    "small": (0.55, 0.75, 0.55, 0.75),
}
"""Size word → smallest and largest factor on the width, and on the height."""

CATEGORIES: tuple[str, ...] = tuple(names.canonical(name) for name in assemblies.CATEGORIES)
COLORS: tuple[str, ...] = tuple(PALETTE)
SIZES: tuple[str, ...] = tuple(STYLES)

VOCABULARY = Vocabulary(CATEGORIES, COLORS, SIZES)

NO, YES, UNSURE = 0, 1, -1
"""Answers to the question if a phrase is true of an object."""

NEARLY_AS_NEAR = (1.35, 3.0)
"""If the nearest colour of the palette is at the distance d [CIE76], others up to 1.35 d + 3 are as
good a name: then the answer for all of them is UNSURE."""

_NOT_SAID: dict[str, tuple[str, ...]] = {
    "rug": ("tall", "short", "wide", "narrow"),
    "ball": ("tall", "short", "wide", "narrow"),
    "door": ("wide", "narrow"),
    "armchair": ("wide", "large"),
    "sofa": ("narrow", "small"),
    "wardrobe": ("short", "small", "narrow"),
    "cabinet": ("tall", "large"),
    "dresser": ("narrow", "small"),
    "nightstand": ("tall", "wide", "large"),
    "table": ("short", "small"),
    "coffee table": ("tall", "large"),
}
"""Category → size words that no person uses for it, or that make another kind of object of it: a
wide armchair is a sofa."""


def _lab(rgb: np.ndarray) -> np.ndarray:
    """Convert (n, 3) sRGB in 0..255 to (n, 3) CIELAB."""
    return cv2.cvtColor(np.float32(rgb)[None] / 255.0, cv2.COLOR_RGB2LAB)[0]


_PALETTE_LAB = _lab(np.array(list(PALETTE.values())))


def has_color(category: str) -> bool:
    """Return True if an object of the simulator's `category` has a variable colour."""
    return any("main" in row for row in assemblies.CATEGORIES[category].rows)


def styles_of(category: str) -> tuple[str, ...]:
    """Return the size words that people use for a category."""
    return tuple(s for s in SIZES if s not in _NOT_SAID.get(category, ()))


def color_answers(rgb: np.ndarray) -> np.ndarray:
    """Return (1 + colours,) int8, the answers for all colour words; entry 0 (no word) is YES."""
    distance = np.linalg.norm(_PALETTE_LAB - _lab(np.asarray(rgb)[None]), axis=1)
    near = NEARLY_AS_NEAR[0] * distance.min() + NEARLY_AS_NEAR[1]
    answers = np.where(distance <= near, UNSURE, NO).astype(np.int8)
    if (answers == UNSURE).sum() == 1:
        answers[distance.argmin()] = YES
    return np.concatenate([[np.int8(YES)], answers])


def unsure_color() -> np.ndarray:
    """Return the answers for all colour words, for an object without a single colour."""
    answers = np.full(1 + len(COLORS), UNSURE, np.int8)
    answers[0] = YES
    return answers


def size_answers(style: str | None, category: str) -> np.ndarray:
    """Return (1 + sizes,) int8, the answers for all size words; entry 0, for no word, is YES.

    `style` is the size word that the object was made with; None for the usual size.
    """
    answers = np.zeros(1 + len(SIZES), np.int8)
    answers[0] = YES
    for index, word in enumerate(SIZES, 1):
        if word == style:
            answers[index] = YES
        elif (style and word in ALIKE[style]) or word not in styles_of(category):
            answers[index] = UNSURE
    return answers


def kinds() -> np.ndarray:
    """Return the answers of objects (rows) to category words (columns).

    An answer is UNSURE, both ways, between a kind and its broader name: an armchair is a chair to
    some people. Row and column 0 stand for no category.

    Returns:
        (1 + categories, 1 + categories) int8.
    """
    n = len(CATEGORIES)
    answers = np.zeros((1 + n, 1 + n), np.int8)
    for i, a in enumerate(CATEGORIES, 1):
        for j, b in enumerate(CATEGORIES, 1):
            if i == j:
                answers[i, j] = YES
            elif names.is_kind_of(a, b) or names.is_kind_of(b, a):
                answers[i, j] = UNSURE
    return answers


KINDS = kinds()
"""See `kinds`."""


def answers(
    category: np.ndarray, color: np.ndarray, size: np.ndarray, phrases: np.ndarray
) -> np.ndarray:
    """Return the answers to phrases, for each object, (o, k) int8.

    An answer is NO if one word is wrong, else UNSURE if one is unsure, else YES.

    Args:
        category: (o,) int, from 1.
        color: (o, 1 + colours) int8 from `color_answers`.
        size: (o, 1 + sizes) int8 from `size_answers`.
        phrases: (k, 3) int (category, colour, size).
    """
    words = np.stack(
        [KINDS[category][:, phrases[:, 0]], color[:, phrases[:, 1]], size[:, phrases[:, 2]]]
    )  # (3, o, k)
    unsure = np.where((words == UNSURE).any(axis=0), UNSURE, YES)
    return np.where((words == NO).any(axis=0), NO, unsure).astype(np.int8)
