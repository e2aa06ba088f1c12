"""Images of a lens with distortion, rectified to those of a pinhole camera."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

import cv2
import numpy as np

from edge.geometry import CameraModel, Lens
from edge.sources.messages import DepthImage, Frame, Image

FISHEYE = "equidistant"
MODELS = ("plumb_bob", "rational_polynomial", FISHEYE)
_COEFFICIENTS = (4, 5, 8, 12, 14)  # as many as OpenCV takes; those that lack are zero
_NAMES = {"rect", "rectified"}
_SAMPLES = 1000
_OUTSIDE_PX = -10.0
_MOST_PX = 32_766  # OpenCV's maps are of 16 bits
_OTHERWISE = "if they are already, set source.distortion: ignore"
_HOW = {Image.field: cv2.INTER_LINEAR, DepthImage.field: cv2.INTER_NEAREST}


def is_rectified(topic: str) -> bool:
    """Return whether a topic's name has the word `rect` or `rectified`, as image_proc's do.

    >>> is_rectified("/camera/image_rect_color"), is_rectified("/director/image_raw")
    (True, False)
    """
    return not _NAMES.isdisjoint(re.split("[^a-z0-9]+", topic.lower()))


class Rectifier:
    """Rectifies the images of one camera, by a map that its first image makes; for one thread.

    Depth is rectified by the nearest pixel: between a near and a far one there is nothing. What the
    raw image does not show is 0.

    Args:
        lens: of the raw images.
        camera: of the rectified ones; of the same size.

    Raises:
        ValueError: the model is not known, has other coefficients, or the image is too large.
    """

    def __init__(self, lens: Lens, camera: CameraModel) -> None:
        self._lens, self._d, self._camera = lens, _coefficients(lens), camera
        shape = camera.height_px, camera.width_px
        if max(shape) > _MOST_PX:
            raise ValueError(
                f"{lens}: an image of {shape[1]}x{shape[0]}, at most {_MOST_PX} a side"
            )
        self._maps: dict[str, tuple[np.ndarray, np.ndarray]] | None = None
        self._raw = {
            Image.field: np.zeros((*shape, 3), np.uint8),
            DepthImage.field: np.zeros(shape, np.float32),
        }

    def into(self, frame: Frame, out: np.ndarray) -> int:
        """Write a frame into `out`, rectified; see `Frame.into`."""
        raw = self._raw[frame.field]
        rows = frame.into(raw)
        if rows:
            if self._maps is None:  # not before: a description alone must cost no memory
                self._maps = self._make_maps()
            maps, how = self._maps[frame.field], _HOW[frame.field]
            cv2.remap(raw, *maps, how, dst=out, borderMode=cv2.BORDER_CONSTANT)
        return rows

    def _make_maps(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the raw pixel of each rectified one, as OpenCV takes it fastest, by field."""
        lens, camera = self._lens, self._camera
        fisheye = lens.model == FISHEYE
        make = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
        size = camera.width_px, camera.height_px
        maps = make(_matrix(lens.camera), self._d, np.eye(3), _matrix(camera), size, cv2.CV_32F)
        with np.errstate(over="ignore", invalid="ignore"):  # coefficients may be absurd
            outside = ~np.isfinite(maps[0] + maps[1]) | self._folded(camera)
        for axis in maps:
            axis[outside] = _OUTSIDE_PX
        # For depth a map of its own: one for colours would be rounded down.
        return {
            Image.field: cv2.convertMaps(*maps, cv2.CV_16SC2),
            DepthImage.field: cv2.convertMaps(*maps, cv2.CV_16SC2, nninterpolation=True),
        }

    def _folded(self, camera: CameraModel) -> np.ndarray:
        """Return (h, w) bool: pixels so far out that the model folds their rays back.

        Polynomials are fitted inside the image. Farther out they turn, and the image would appear
        there a second time.
        """
        u, v = np.arange(camera.width_px), np.arange(camera.height_px)
        x = ((u - camera.cx_px) / camera.fx_px)[None, :]
        y = ((v - camera.cy_px) / camera.fy_px)[:, None]
        radius = np.hypot(x, y)
        r = np.linspace(0.0, radius.max(), _SAMPLES)
        rays = np.stack([r, np.zeros_like(r), np.ones_like(r)], axis=1)[:, None]
        project = cv2.fisheye.projectPoints if self._lens.model == FISHEYE else cv2.projectPoints
        seen_at = project(rays, np.zeros(3), np.zeros(3), np.eye(3), self._d)[0][:, 0, 0]
        turns = np.flatnonzero(~(np.diff(seen_at) > 0.0))
        return radius > (r[turns[0]] if len(turns) else np.inf)


def _coefficients(lens: Lens) -> np.ndarray:
    """The coefficients as OpenCV takes them; raises ValueError for those that it does not."""
    if lens.model not in MODELS:
        raise ValueError(f"{lens}: the model is not known (known: {', '.join(MODELS)})")
    most = 4 if lens.model == FISHEYE else _COEFFICIENTS[-1]
    d = np.trim_zeros(np.array(lens.coefficients), "b")
    if len(d) > most:
        raise ValueError(f"{lens}: {len(d)} coefficients, at most {most} are taken")
    n = next(n for n in _COEFFICIENTS if n >= len(d))
    return np.pad(d, (0, n - len(d)))


def _matrix(camera: CameraModel) -> np.ndarray:
    return np.array(
        [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
    )


class LensPlan(NamedTuple):
    """How the images of a camera are taken.

    Attributes:
        distortion: see `edge.types.Observation`.
        rectifier: None: no field is rectified.
        fields: those that are.
        text: a line for the log; empty without distortion.
    """

    distortion: Literal["none", "rectified", "ignored"] = "none"
    rectifier: Rectifier | None = None
    fields: tuple[str, ...] = ()
    text: str = ""

    def decode(self, frame: Frame, out: np.ndarray) -> int:
        """Write a frame into `out` as it is to be seen; see `Frame.into`."""
        if self.rectifier is None or frame.field not in self.fields:
            return frame.into(out)
        return self.rectifier.into(frame, out)


def plan_for(
    lens: Lens | None,
    camera: CameraModel,
    setting: Literal["rectify", "ignore", "refuse"],
    rgb_topic: str,
    depth_topic: str | None,
) -> LensPlan:
    """Choose how the images of a camera are taken.

    Depth is registered to the colours, so it is distorted as they are, unless its own name says
    that it is registered to rectified ones.

    Args:
        setting: `source.distortion`.
        depth_topic: None: no depth is listened to.

    Raises:
        ValueError: its images are refused; one line.
    """
    if lens is None:
        return LensPlan()
    if setting == "ignore" or is_rectified(rgb_topic):
        why = "source.distortion is ignore" if setting == "ignore" else f"{rgb_topic} says so"
        return LensPlan("ignored", text=f"{lens}: images are taken for rectified: {why}")
    if setting == "refuse":
        raise ValueError(f"{lens}: source.distortion is refuse: send rectified images")
    try:
        rectifier = Rectifier(lens, camera)
    except ValueError as error:
        raise ValueError(f"{error}; {_OTHERWISE}") from None
    kinds, fields = "images are", (Image.field,)
    if depth_topic is not None and not is_rectified(depth_topic):
        kinds, fields = "images and depth are", (Image.field, DepthImage.field)
    return LensPlan("rectified", rectifier, fields, f"{lens}: {kinds} rectified; {_OTHERWISE}")
