"""The picture that a model is shown: each object outlined in its own colour and numbered
(OpenNav III-B)."""

from __future__ import annotations

import cv2
import numpy as np

from edge.perception.scoring.choice.picture import place
from edge.tasks.scene import Scene

SHOWN_PX = 960
"""Smaller pictures are enlarged until their longer side is so long: numbers want room."""
_RADIUS_SHARE, _LEAST_RADIUS_PX = 0.011, 10
_GOLDEN = 0.618034
"""Hues this share of a turn apart differ, however many there are."""
_BLACK, _WHITE = (0, 0, 0), (255, 255, 255)


def annotated(scene: Scene, longest_px: int = 1280) -> np.ndarray | None:
    """The scene's picture with the contours and numbers of its objects.

    A number goes to the middle of the thing's largest outline, or as near to it as there is room,
    with a line to there; one for which there is none is left out.

    Args:
        longest_px: the longer side is at most so long.

    Returns:
        (h, w, 3) uint8; None where the scene has no picture.
    """
    if scene.rgb is None:
        return None
    height, width = scene.rgb.shape[:2]
    longer = max(height, width)
    scale = min(max(1.0, SHOWN_PX / longer), longest_px / longer)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    image = scene.rgb.copy() if scale == 1.0 else cv2.resize(scene.rgb, size, interpolation=how)
    lines = {
        i: [np.rint(line * scale).astype(np.int32) for line in outlines]
        for i, outlines in scene.contours.items()
        if outlines
    }
    for i, outlines in lines.items():
        cv2.polylines(image, outlines, True, _BLACK, 3, cv2.LINE_AA)
        cv2.polylines(image, outlines, True, colour(i), 2, cv2.LINE_AA)
    radius = max(_LEAST_RADIUS_PX, round(_RADIUS_SHARE * max(size)))
    spots = [_middle(max(outlines, key=cv2.contourArea), size) for outlines in lines.values()]
    for i, spot, at in zip(lines, spots, place(spots, size, radius), strict=True):
        if at is not None:
            _number(image, i, spot, at, radius)
    return image


def colour(number: int) -> tuple[int, int, int]:
    """A bright colour (RGB) of an object's own."""
    hsv = np.array([[[int(180 * (number * _GOLDEN % 1.0)), 190, 255]]], np.uint8)
    red, green, blue = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return red, green, blue


def _middle(outline: np.ndarray, size: tuple[int, int]) -> tuple[float, float]:
    """Of what an outline has inside the picture."""
    inside = np.clip(outline, 0, np.array(size) - 1)
    x, y, w, h = cv2.boundingRect(inside)
    return x + 0.5 * w, y + 0.5 * h


def _number(
    image: np.ndarray,
    number: int,
    spot: tuple[float, float],
    at: tuple[float, float],
    radius: int,
) -> None:
    """A number on a black disc, with a line to the spot that it belongs to; drawn in place."""
    own = colour(number)
    here, centre = ((round(x), round(y)) for x, y in (spot, at))
    if np.hypot(here[0] - centre[0], here[1] - centre[1]) > radius:
        cv2.line(image, here, centre, own, 1, cv2.LINE_AA)
        cv2.circle(image, here, 2, own, -1, cv2.LINE_AA)
    cv2.circle(image, centre, radius, _BLACK, -1, cv2.LINE_AA)
    cv2.circle(image, centre, radius, own, 1, cv2.LINE_AA)
    text, font = str(number), cv2.FONT_HERSHEY_SIMPLEX
    (wide, high), _ = cv2.getTextSize(text, font, 1.0, 1)
    scale = min(1.1 * radius / high, 1.5 * radius / wide)
    (wide, high), _ = cv2.getTextSize(text, font, scale, 1)
    corner = round(centre[0] - wide / 2), round(centre[1] + high / 2)
    cv2.putText(image, text, corner, font, scale, _WHITE, 1, cv2.LINE_AA)
