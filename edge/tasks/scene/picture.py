"""Picture for a model: each object is outlined in its own colour and numbered (OpenNav III-B)."""

from __future__ import annotations

import cv2
import numpy as np

from edge.perception.scoring.choice.picture import place_discs, scaled_copy
from edge.tasks.scene.scene import Scene

SHOWN_PX = 960
"""The longer side of a smaller picture is enlarged to this, to make room for the numbers."""
_RADIUS_SHARE = 0.011  # radius of a number's disc, as a share of the picture's longer side
_MIN_RADIUS_PX = 10
_HUE_STEP = 0.618034
"""Step between hues as a share of the colour circle; any number of such hues differ."""
_BLACK, _WHITE = (0, 0, 0), (255, 255, 255)


def draw_marks(scene: Scene, longest_px: int = 1280) -> np.ndarray | None:
    """Draw the contours and numbers of the objects into the scene's picture.

    A number is drawn in the middle of the object's largest outline, or in the nearest free place
    with a line to the middle. If there is no free place, the number is left out.

    Returns:
        (h, w, 3) uint8; None if the scene has no picture.
    """
    if scene.rgb is None:
        return None
    image, scale = scaled_copy(scene.rgb, SHOWN_PX, longest_px)
    size = image.shape[1], image.shape[0]
    lines = {
        i: [np.rint(line * scale).astype(np.int32) for line in outlines]
        for i, outlines in scene.contours.items()
        if outlines
    }
    for i, outlines in lines.items():
        cv2.polylines(image, outlines, True, _BLACK, 3, cv2.LINE_AA)
        cv2.polylines(image, outlines, True, colour(i), 2, cv2.LINE_AA)
    radius = max(_MIN_RADIUS_PX, round(_RADIUS_SHARE * max(size)))
    spots = [_middle(max(outlines, key=cv2.contourArea), size) for outlines in lines.values()]
    for i, spot, at in zip(lines, spots, place_discs(spots, size, radius), strict=True):
        if at is not None:
            _draw_number(image, i, spot, at, radius)
    return image


def colour(number: int) -> tuple[int, int, int]:
    """Return a bright RGB colour for an object's number."""
    hsv = np.array([[[int(180 * (number * _HUE_STEP % 1.0)), 190, 255]]], np.uint8)
    red, green, blue = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return red, green, blue


def _middle(outline: np.ndarray, size: tuple[int, int]) -> tuple[float, float]:
    """Return the centre of the part of an outline inside the picture."""
    inside = np.clip(outline, 0, np.array(size) - 1)
    x, y, w, h = cv2.boundingRect(inside)
    return x + 0.5 * w, y + 0.5 * h


def _draw_number(
    image: np.ndarray, number: int, spot: tuple[float, float], at: tuple[float, float], radius: int
) -> None:
    """Draw a number on a black disc, with a line to its object, in place."""
    own_colour = colour(number)
    spot_px, centre = ((round(x), round(y)) for x, y in (spot, at))
    if np.hypot(spot_px[0] - centre[0], spot_px[1] - centre[1]) > radius:
        cv2.line(image, spot_px, centre, own_colour, 1, cv2.LINE_AA)
        cv2.circle(image, spot_px, 2, own_colour, -1, cv2.LINE_AA)
    cv2.circle(image, centre, radius, _BLACK, -1, cv2.LINE_AA)
    cv2.circle(image, centre, radius, own_colour, 1, cv2.LINE_AA)
    text, font = str(number), cv2.FONT_HERSHEY_SIMPLEX
    (text_width, text_height), _ = cv2.getTextSize(text, font, 1.0, 1)
    scale = min(1.1 * radius / text_height, 1.5 * radius / text_width)
    (text_width, text_height), _ = cv2.getTextSize(text, font, scale, 1)
    corner = round(centre[0] - text_width / 2), round(centre[1] + text_height / 2)
    cv2.putText(image, text, corner, font, scale, _WHITE, 1, cv2.LINE_AA)
