"""Rectification of distorted images to those of a pinhole camera."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

import cv2
import numpy as np

from edge.geometry import CameraModel, Lens
from edge.sources.messages import DepthImage, Image, SensorFrame

FISHEYE = "equidistant"
# Distortion models that can be rectified, as ROS 2 names them.
MODELS = ("plumb_bob", "rational_polynomial", FISHEYE)
_COEFFICIENTS = (4, 5, 8, 12, 14)  # numbers that OpenCV accepts; missing ones are zero
_RECTIFIED_WORDS = {"rect", "rectified"}
_SAMPLES = 1000  # distances from the optical axis at which the distortion model is tested
_OUTSIDE_PX = -10.0  # coordinate of pixels without a raw pixel
_MAX_SIDE_PX = 32_766  # OpenCV's maps have 16 bits
_ADVICE = "if they are rectified already, set source.distortion: ignore"
_INTERPOLATIONS = {Image.field: cv2.INTER_LINEAR, DepthImage.field: cv2.INTER_NEAREST}


def is_rectified(topic: str) -> bool:
    """Return True if a topic's name has the word `rect` or `rectified`, as image_proc's do.

    >>> is_rectified("/camera/image_rect_color"), is_rectified("/director/image_raw")
    (True, False)
    """
    return not _RECTIFIED_WORDS.isdisjoint(re.split("[^a-z0-9]+", topic.lower()))


class Rectifier:
    """Rectifies the images of one camera; for one thread. The maps are made at the first image.

    Depth uses the nearest pixel, since a mean of near and far is wrong. Pixels outside the raw
    image are 0.

    Raises:
        ValueError: unknown model, wrong number of coefficients, or too large an image.
    """

    def __init__(self, lens: Lens, camera: CameraModel) -> None:
        # `_d`: distortion coefficients as OpenCV takes them.
        self._lens, self._d, self._camera = lens, _coefficients(lens), camera
        shape = camera.height_px, camera.width_px
        if max(shape) > _MAX_SIDE_PX:
            raise ValueError(
                f"{lens}: an image of {shape[1]}x{shape[0]}, at most {_MAX_SIDE_PX} px a side "
                "can be rectified"
            )
        self._maps: dict[str, tuple[np.ndarray, np.ndarray]] | None = None
        self._raw = {
            Image.field: np.zeros((*shape, 3), np.uint8),
            DepthImage.field: np.zeros(shape, np.float32),
        }

    def into(self, frame: SensorFrame, out: np.ndarray) -> int:
        """Write a rectified frame into `out`; see `SensorFrame.into`."""
        raw = self._raw[frame.field]
        rows = frame.into(raw)
        if rows:
            if self._maps is None:  # only now: camera info alone must cost no memory
                self._maps = self._make_maps()
            maps, interpolation = self._maps[frame.field], _INTERPOLATIONS[frame.field]
            cv2.remap(raw, *maps, interpolation, dst=out, borderMode=cv2.BORDER_CONSTANT)
        return rows

    def _make_maps(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the raw pixel of each rectified pixel, in OpenCV's fastest format, by field."""
        lens, camera = self._lens, self._camera
        make_maps = cv2.initUndistortRectifyMap
        if lens.model == FISHEYE:
            make_maps = cv2.fisheye.initUndistortRectifyMap
        size, no_turn = (camera.width_px, camera.height_px), np.eye(3)
        maps = make_maps(_matrix(lens.camera), self._d, no_turn, _matrix(camera), size, cv2.CV_32F)
        with np.errstate(over="ignore", invalid="ignore"):  # coefficients may be nonsense
            outside = ~np.isfinite(maps[0] + maps[1]) | self._find_folded_pixels(camera)
        for axis in maps:
            axis[outside] = _OUTSIDE_PX
        # Depth needs a separate map: the one for colour would be rounded down.
        return {
            Image.field: cv2.convertMaps(*maps, cv2.CV_16SC2),
            DepthImage.field: cv2.convertMaps(*maps, cv2.CV_16SC2, nninterpolation=True),
        }

    def _find_folded_pixels(self, camera: CameraModel) -> np.ndarray:
        """Return (h, w) bool: pixels far outside, where the distortion model folds back.

        The polynomials are fitted inside the image. Farther out they turn, and the image would
        appear a second time.
        """
        u, v = np.arange(camera.width_px), np.arange(camera.height_px)
        x = ((u - camera.cx_px) / camera.fx_px)[None, :]
        y = ((v - camera.cy_px) / camera.fy_px)[:, None]
        radius = np.hypot(x, y)
        # Rays at distance r from the optical axis (at depth 1), and the distance at which the lens
        # shows each. Up to the first r at which that distance does not grow, the model is valid.
        r = np.linspace(0.0, radius.max(), _SAMPLES)
        rays = np.stack([r, np.zeros_like(r), np.ones_like(r)], axis=1)[:, None]
        project = cv2.fisheye.projectPoints if self._lens.model == FISHEYE else cv2.projectPoints
        seen_at = project(rays, np.zeros(3), np.zeros(3), np.eye(3), self._d)[0][:, 0, 0]
        turning_points = np.flatnonzero(~(np.diff(seen_at) > 0.0))
        return radius > (r[turning_points[0]] if len(turning_points) else np.inf)


def _coefficients(lens: Lens) -> np.ndarray:
    """Return the coefficients padded for OpenCV; raise ValueError if OpenCV cannot use them."""
    if lens.model not in MODELS:
        raise ValueError(f"{lens}: unknown distortion model (known: {', '.join(MODELS)})")
    most = 4 if lens.model == FISHEYE else _COEFFICIENTS[-1]
    d = np.trim_zeros(np.array(lens.coefficients), "b")
    if len(d) > most:
        raise ValueError(f"{lens}: {len(d)} coefficients, at most {most} are allowed")
    n = next(n for n in _COEFFICIENTS if n >= len(d))
    return np.pad(d, (0, n - len(d)))


def _matrix(camera: CameraModel) -> np.ndarray:
    return np.array(
        [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
    )


class LensPlan(NamedTuple):
    """Decision about the images of a camera: rectified or not.

    Attributes:
        distortion: see `edge.types.Observation`.
        rectifier: None: no field is rectified.
        fields: fields of `Observation` that are rectified.
        log_line: a line for the log; empty without distortion.
    """

    distortion: Literal["none", "rectified", "ignored"] = "none"
    rectifier: Rectifier | None = None
    fields: tuple[str, ...] = ()
    log_line: str = ""

    def decode(self, frame: SensorFrame, out: np.ndarray) -> int:
        """Write a frame into `out`, rectified if planned; see `SensorFrame.into`."""
        if self.rectifier is None or frame.field not in self.fields:
            return frame.into(out)
        return self.rectifier.into(frame, out)


def make_lens_plan(
    lens: Lens | None,
    camera: CameraModel,
    setting: Literal["rectify", "ignore", "refuse"],
    rgb_topic: str,
    depth_topic: str | None,
) -> LensPlan:
    """Decide how the images of a camera are used.

    Depth is registered to the colour image and has the same distortion, unless its topic name says
    that it is rectified.

    Args:
        lens: distortion; None: none.
        camera: intrinsics of the rectified images.
        setting: `source.distortion`.
        rgb_topic: name of the colour topic.
        depth_topic: name of the depth topic; None: no depth is used.

    Raises:
        ValueError: the images cannot be used; one line.
    """
    if lens is None:
        return LensPlan()
    if setting == "ignore" or is_rectified(rgb_topic):
        why = (
            "source.distortion is ignore"
            if setting == "ignore"
            else f"{rgb_topic} has rect in its name"
        )
        return LensPlan("ignored", log_line=f"{lens}: images are used as rectified: {why}")
    if setting == "refuse":
        raise ValueError(
            f"{lens}: source.distortion is refuse: send rectified images, or set "
            "source.distortion to rectify"
        )
    try:
        rectifier = Rectifier(lens, camera)
    except ValueError as error:
        raise ValueError(f"{error}; {_ADVICE}") from None
    kinds, fields = "images are", (Image.field,)
    if depth_topic is not None and not is_rectified(depth_topic):
        kinds, fields = "images and depth are", (Image.field, DepthImage.field)
    return LensPlan("rectified", rectifier, fields, f"{lens}: {kinds} rectified; {_ADVICE}")
