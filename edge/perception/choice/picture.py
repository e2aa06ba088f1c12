"""A view as a picture with lettered marks (ViTL fig. 3a), for a vision-language model."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from edge.perception.choice.question import LETTERS, MAX_MARKS, Mark

ENLARGED_PX = 320  # smaller images are shown larger, so that letters leave something to be seen
JPEG_QUALITY = 90
_RADIUS_SHARE, _MIN_RADIUS_PX = 0.035, 7
_RINGS, _SPOKES = 24, 24


def draw(
    rgb: np.ndarray, marks: Sequence[Mark], max_px: int
) -> tuple[np.ndarray, tuple[Mark, ...]]:
    """A copy of the image with a letter at each mark.

    A letter whose spot is taken moves to the nearest that is free, with a line to where it belongs.

    Args:
        rgb: (h, w, 3) uint8.
        marks: from left to right, in pixels of `rgb`.
        max_px: the longer side of the copy is at most so long.

    Returns:
        The copy, and the marks that have the letters A, B, … in this order: at most `MAX_MARKS`,
        and none for which no room is left.
    """
    height, width = rgb.shape[:2]
    scale = min(max(1.0, ENLARGED_PX / max(width, height)), max_px / max(width, height))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    image = rgb.copy() if scale == 1.0 else cv2.resize(rgb, size, interpolation=how)
    radius = max(_MIN_RADIUS_PX, round(_RADIUS_SHARE * max(size)))
    spots = [((m.u_px + 0.5) * scale - 0.5, (m.v_px + 0.5) * scale - 0.5) for m in marks]
    places = place(spots[:MAX_MARKS], size, radius)
    shown = [i for i, at in enumerate(places) if at is not None]
    for i in shown:
        spot, at = _whole(spots[i]), _whole(places[i])
        cv2.line(image, spot, at, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.line(image, spot, at, (255, 255, 255), 1, cv2.LINE_AA)
        cv2.circle(image, spot, 2, (255, 255, 255), -1, cv2.LINE_AA)
    for letter, i in zip(LETTERS, shown, strict=False):
        _letter(image, letter, _whole(places[i]), radius)
    return image, tuple(marks[i] for i in shown)


def place(
    spots: Sequence[tuple[float, float]], size: tuple[int, int], radius: int
) -> list[tuple[float, float] | None]:
    """Where the centres of discs go: as near as can be to their spots, none over another.

    Args:
        spots: (u, v) each.
        size: width and height; discs stay inside.

    Returns:
        A centre for each spot, or None where no room was found.
    """
    taken: list[tuple[float, float]] = []
    places: list[tuple[float, float] | None] = []
    apart = 2.0 * radius + 2.0  # their borders, and rounding to whole pixels
    for spot in spots:
        free = (
            at
            for at in _around(spot, radius)
            if _fits(at, size, radius) and all(math.dist(at, other) >= apart for other in taken)
        )
        at = next(free, None)
        places.append(at)
        if at is not None:
            taken.append(at)
    return places


def data_url(rgb: np.ndarray) -> str:
    """An image as a JPEG in a `data:` URL."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()


def _around(spot: tuple[float, float], radius: int) -> Iterator[tuple[float, float]]:
    """The spot itself, then places on rings around it, the nearest first."""
    yield spot
    for ring in range(1, _RINGS + 1):
        reach = 0.5 * ring * radius
        for spoke in range(_SPOKES):
            turn = 2.0 * math.pi * spoke / _SPOKES
            yield spot[0] + reach * math.sin(turn), spot[1] - reach * math.cos(turn)


def _fits(at: tuple[float, float], size: tuple[int, int], radius: int) -> bool:
    return all(radius <= x <= side - 1 - radius for x, side in zip(at, size, strict=True))


def _whole(at: tuple[float, float]) -> tuple[int, int]:
    return round(at[0]), round(at[1])


def _letter(image: np.ndarray, letter: str, at: tuple[int, int], radius: int) -> None:
    """A black letter on a white disc with a black border, drawn in place."""
    cv2.circle(image, at, radius, (255, 255, 255), -1, cv2.LINE_AA)
    cv2.circle(image, at, radius, (0, 0, 0), 1, cv2.LINE_AA)
    font, thickness = cv2.FONT_HERSHEY_SIMPLEX, max(1, radius // 6)
    (_, height), _ = cv2.getTextSize(letter, font, 1.0, thickness)
    scale = 1.1 * radius / height
    (width, height), _ = cv2.getTextSize(letter, font, scale, thickness)
    corner = (round(at[0] - width / 2), round(at[1] + height / 2))
    cv2.putText(image, letter, corner, font, scale, (0, 0, 0), thickness, cv2.LINE_AA)
