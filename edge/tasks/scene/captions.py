"""Captions of objects without a captioning model: colour, size, place (OpenNav III-B)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from edge.geometry import SE2
from edge.types import Detections

_GREYS = ("black", "gray", "white")
COLOURS = (*_GREYS, "red", "orange", "yellow", "green", "blue", "purple", "pink",
           "brown")  # fmt: skip
_HUES = ((8, "red"), (20, "orange"), (34, "yellow"), (85, "green"), (128, "blue"), (148, "purple"),
         (170, "pink"), (180, "red"))  # fmt: skip
"""Upper limit of each colour's hue in OpenCV's half degrees."""
_DARK = 55
"""Value (brightness) below which a pixel is black."""
_LIGHT = 165
"""Value from which a grey pixel is white."""
_PALE = 55
"""Saturation below which a pixel is grey; dark pixels are noisier and need more."""
_SHADED, _SHADED_SPREAD = 128, 12
"""Least saturation, and least difference of the channels, of a dark pixel that is not black.

Such a pixel shows paint in the shade."""
_BROWN_BELOW = 150
"""Value below which an orange pixel, or a red one near orange, is brown."""
_INNER = 0.6
"""Share of a box's width and height that shows the object, if there is no mask."""
_LEAST_SHARE = 0.35
"""Smallest share of an object's pixels for its colour."""
_PAINT_SHARE = 0.25
"""An object that is mostly black gets its most frequent other colour above this share of pixels.

The black pixels are then tyres, windows and shadow.
"""
_DIM, _BRIGHT, _MOST_GAIN = 110, 235, 4.0
"""A picture whose bright pixels are below `_DIM` was taken in dim light.

Its values are multiplied until they reach `_BRIGHT`, at most by `_MOST_GAIN`.
"""
_CAST, _MOST_CAST = 0.2, 0.55
"""Saturation (0 to 1) of neutral ground from which on the light has a colour, and its largest."""
_NEUTRAL_SHARE = 0.02
"""Share of the lower half of a picture that must be neutral, to judge the colour of the light."""
_LIGHT_SHARE = 0.5
"""A neutral pixel is at least this share as bright as the brightest ones of that order."""
_STEP_PX = 4  # spacing of the pixels that are looked at
STRAIGHT_WITHIN_M = 1.0
"""An object less far to the side is straight ahead or behind."""


def light_gains(rgb: np.ndarray) -> np.ndarray:
    """Return the factors (3,) on red, green and blue that give a picture white, bright light.

    The light is warm or cool as a lamp or the sky is: its green is between its red and blue. So the
    least saturated bright pixels of that order are taken for neutral, from the lower half of the
    picture: a blue sky is no neutral. Dim light is seen in the bright pixels of the entire picture.

    Args:
        rgb: (h, w, 3) uint8.
    """
    pixels = rgb[::_STEP_PX, ::_STEP_PX].astype(np.float32)
    bright = float(np.percentile(pixels.max(axis=2), 98))
    lower = pixels[len(pixels) // 2 :].reshape(-1, 3)
    least, green, most = lower.min(axis=1), lower[:, 1], lower.max(axis=1)
    saturation = 1.0 - least / np.maximum(most, 1.0)
    between = (green >= lower[:, ::2].min(axis=1)) & (green <= lower[:, ::2].max(axis=1))
    neutral = np.flatnonzero(between & (saturation <= _MOST_CAST))
    gains, needed = np.ones(3, np.float32), math.ceil(_NEUTRAL_SHARE * len(lower))
    if len(neutral) >= needed:
        brightest = np.percentile(most[neutral], 98)
        neutral = neutral[most[neutral] >= _LIGHT_SHARE * brightest]
        chosen = neutral[np.argsort(saturation[neutral], kind="stable")[:needed]]
        light = np.median(lower[chosen], axis=0)
        if light.min() < (1.0 - _CAST) * light.max():
            gains = light.max() / light
    if bright < _DIM:
        gains = gains * min(_BRIGHT / max(bright, 1.0), _MOST_GAIN)
    return gains.astype(np.float32)


def in_white_light(rgb: np.ndarray) -> np.ndarray:
    """Return a picture (h, w, 3) uint8 as in white, bright light; see `light_gains`."""
    gains = light_gains(rgb)
    if (gains == 1.0).all():
        return rgb
    values = np.arange(256, dtype=np.float32)[:, None] * gains
    return cv2.LUT(rgb, np.clip(np.rint(values), 0, 255).astype(np.uint8)[None])


def colour_names(rgb: np.ndarray) -> np.ndarray:
    """Return the colour of each pixel, (h, w) uint8 index into `COLOURS`.

    `rgb` is (h, w, 3) uint8.
    """
    hue, saturation, value = (
        plane for plane in np.moveaxis(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), 2, 0)
    )
    ends, hue_names = zip(*_HUES, strict=True)
    table = np.array([COLOURS.index(name) for name in hue_names], np.uint8)
    out = table[np.searchsorted(ends, hue, side="right").clip(max=len(table) - 1)]
    # Dark orange looks brown, and so does dark red that is near to orange (hue over 4).
    orange, red = out == COLOURS.index("orange"), out == COLOURS.index("red")
    warm = orange | (red & (hue > 4) & (hue < 90))
    out[warm & (value < _BROWN_BELOW)] = COLOURS.index("brown")
    pale = saturation < np.where(value < 100, 2 * _PALE, _PALE)
    out[pale] = COLOURS.index("gray")
    out[pale & (value >= _LIGHT)] = COLOURS.index("white")
    spread = saturation.astype(np.int32) * value // 255
    is_shaded = (saturation >= _SHADED) & (spread >= _SHADED_SPREAD)
    out[(value < _DARK) & ~is_shaded] = COLOURS.index("black")
    return out


def colour_of(rgb: np.ndarray, box: np.ndarray, mask: np.ndarray | None = None) -> str:
    """Return the name of an object's main colour; "" if none dominates or too little is visible.

    Args:
        rgb: (h, w, 3) uint8.
        box: (4,) xyxy in pixels.
        mask: (rows, columns) bool over the box; None or empty: use the middle of the box.
    """
    h, w = rgb.shape[:2]
    masked = mask is not None and bool(mask.any())
    if not masked:
        middle, half = 0.5 * (box[:2] + box[2:]), 0.5 * _INNER * (box[2:] - box[:2])
        box = np.concatenate((middle - half, middle + half))
    x0, y0 = (max(0, int(np.floor(v))) for v in box[:2])
    x1, y1 = min(w, int(np.ceil(box[2]))), min(h, int(np.ceil(box[3])))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return ""
    named = colour_names(np.ascontiguousarray(rgb[y0:y1, x0:x1]))
    if masked:
        rows, columns = mask.shape
        v = ((np.arange(y0, y1) + 0.5 - box[1]) / (box[3] - box[1]) * rows).astype(np.intp)
        u = ((np.arange(x0, x1) + 0.5 - box[0]) / (box[2] - box[0]) * columns).astype(np.intp)
        named = named[mask[np.ix_(v.clip(0, rows - 1), u.clip(0, columns - 1))]]
    counts = np.bincount(named.ravel(), minlength=len(COLOURS))
    best = int(np.argmax(counts))
    if COLOURS[best] == "black":
        best_paint = len(_GREYS) + int(np.argmax(counts[len(_GREYS) :]))
        if counts[best_paint] > _PAINT_SHARE * counts.sum():
            return COLOURS[best_paint]
    return COLOURS[best] if counts[best] > _LEAST_SHARE * max(counts.sum(), 1) else ""


def compose_captions(found: Detections) -> tuple[str, ...]:
    """Return colour and label of each box, such as "white car": a captioner without a model."""
    rgb, masks = found.observation.rgb, found.mask
    rgb = in_white_light(rgb) if rgb is not None and len(found) else None
    out = []
    for i, box in enumerate(found.xyxy_px):
        colour = "" if rgb is None else colour_of(rgb, box, None if masks is None else masks[i])
        out.append(f"{colour} {found.prompts[found.class_id[i]]}".strip())
    return tuple(out)


def caption_with_place(caption: str, position_m: np.ndarray, size_m: np.ndarray, pose: SE2) -> str:
    """Return an object's caption with its size and its place as seen from the robot.

    >>> xyz_m, size_m = np.array([9.0, 4.0, 0.7]), np.array([4.2, 1.8, 1.5])
    >>> caption_with_place("white car", xyz_m, size_m, SE2(0, 0, 0))
    'white car, 4.2 x 1.8 x 1.5 m, 9 m ahead, 4 m to the left'
    """
    along, across, up = size_m
    return f"{caption}, {along:.1f} x {across:.1f} x {up:.1f} m, {place_of(position_m, pose)}"


def place_of(position_m: np.ndarray, pose: SE2) -> str:
    """Return the place of a point as seen from the robot, in metres, rounded."""
    c, s = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    dx, dy = position_m[0] - pose.x_m, position_m[1] - pose.y_m
    ahead, left = c * dx + s * dy, c * dy - s * dx
    parts = []
    if abs(ahead) >= STRAIGHT_WITHIN_M or abs(left) < STRAIGHT_WITHIN_M:
        parts.append(f"{abs(ahead):.0f} m {'ahead' if ahead >= 0 else 'behind'}")
    if abs(left) >= STRAIGHT_WITHIN_M:
        parts.append(f"{abs(left):.0f} m to the {'left' if left > 0 else 'right'}")
    return ", ".join(parts)
