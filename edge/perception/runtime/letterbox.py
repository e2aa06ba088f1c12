"""Letterbox: scales an image to fit into a network's input, on a uniform background."""

from __future__ import annotations

from typing import Literal, NamedTuple

import cv2
import numpy as np

At = Literal["centre", "corner"]
"""Place of the image in the input; see `Preprocess`."""


class Fit(NamedTuple):
    """Scale and place of an image in a network's input.

    Attributes:
        image_hw: height and width of the image.
        scale: input pixels per image pixel.
        hw: height and width of the scaled image.
        top, left: its first row and column in the input.
    """

    image_hw: tuple[int, int]
    scale: float
    hw: tuple[int, int]
    top: int
    left: int


def fit_into(image_hw: tuple[int, int], hw: tuple[int, int], at: At) -> Fit:
    """Fit an image into an input of (h, w) pixels."""
    (height, width), (h, w) = image_hw, hw
    scale = min(w / width, h / height)
    inner_h, inner_w = max(1, round(height * scale)), max(1, round(width * scale))
    top, left = ((h - inner_h) // 2, (w - inner_w) // 2) if at == "centre" else (0, 0)
    return Fit(image_hw, scale, (inner_h, inner_w), top, left)


def scaled(rgb: np.ndarray, fit: Fit, out: np.ndarray | None = None) -> np.ndarray:
    """Return the scaled image, in `out` if that is given; at scale 1, `rgb` itself."""
    if fit.scale == 1.0:
        return rgb
    how = cv2.INTER_AREA if fit.scale < 1.0 else cv2.INTER_LINEAR
    return cv2.resize(rgb, fit.hw[::-1], dst=out, interpolation=how)


def letterboxed(
    rgb: np.ndarray, hw: tuple[int, int], pad: int, at: At = "centre"
) -> tuple[np.ndarray, Fit]:
    """Scale (height, width, 3) uint8 into (h, w, 3), on grey `pad`; `rgb` itself if it fits."""
    fit = fit_into(rgb.shape[:2], hw, at)
    image = scaled(rgb, fit)
    if hw != fit.hw:
        bottom, right = hw[0] - fit.hw[0] - fit.top, hw[1] - fit.hw[1] - fit.left
        border = (cv2.BORDER_CONSTANT, None, (pad, pad, pad))
        image = cv2.copyMakeBorder(image, fit.top, bottom, fit.left, right, *border)
    return image, fit
