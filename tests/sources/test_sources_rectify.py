"""Images of lenses with distortion become those of a pinhole camera."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge import config
from edge.geometry import SE2, CameraModel, Lens, se3, to_optical
from edge.mapping.grid import RollingMap
from edge.sources.messages import DepthImage, Image
from edge.sources.rectify import MODELS, Rectifier, is_rectified

RAW = CameraModel(320, 240, 250.0, 255.0, 158.0, 121.0)
WIDE = CameraModel(320, 240, 150.0, 152.0, 161.0, 118.0)
SMALLER = CameraModel(320, 240, 190.0, 190.0, 159.5, 119.5)
LENSES = {
    "plumb_bob": (Lens("plumb_bob", (-0.35, 0.14, 0.0007, -0.0003, 0.0), RAW), SMALLER),
    "plumb_bob, K": (Lens("plumb_bob", (-0.2, 0.03, 0.0, 0.001), RAW), RAW),
    "rational": (
        Lens("rational_polynomial", (0.46, -2.65, 7e-4, -3e-4, 1.54, 0.34, -2.47, 1.47), RAW),
        RAW,
    ),
    "equidistant": (Lens("equidistant", (-0.01, 0.02, -0.01, 0.002), WIDE), SMALLER),
    "padded": (Lens("equidistant", (-0.05, 0.0, 0.0, 0.0, 0.0), WIDE), WIDE),
}


def frame(kind, pixels: np.ndarray):
    def into(out: np.ndarray) -> int:
        out[...] = pixels
        return len(out)

    return kind(0, 0, into)


def bent(lens: Lens, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the image point of the ray (x, y, 1), as the lens models define it."""
    r2 = x * x + y * y
    if lens.model == "equidistant":
        r = np.sqrt(np.maximum(r2, 1e-18))
        angle = np.arctan(r)
        k1, k2, k3, k4 = lens.coefficients[:4]
        a2 = angle * angle
        scale = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))) / r
        return x * scale, y * scale
    k1, k2, p1, p2, k3, k4, k5, k6 = (*lens.coefficients, *[0.0] * 8)[:8]
    scale = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def rays(camera: CameraModel, lens: Lens | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) at z = 1 that each pixel sees: of a pinhole camera, or through a lens."""
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(np.float64)
    x, y = at = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    if lens is None:
        return x, y
    e = 1e-6
    for _ in range(50):  # Newton's method
        shown = bent(lens, x, y)
        by_x, by_y = bent(lens, x + e, y), bent(lens, x, y + e)
        xx, yx, xy, yy = (
            (b - a) / e for by in (by_x, by_y) for b, a in zip(by, shown, strict=True)
        )
        off_x, off_y = at[0] - shown[0], at[1] - shown[1]
        det = xx * yy - xy * yx
        x, y = x + (yy * off_x - xy * off_y) / det, y + (xx * off_y - yx * off_x) / det
    assert np.abs(np.subtract(bent(lens, x, y), at)).max() < 1e-9
    return x, y


def colours(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    waves = [127 + 100 * np.sin(7 * a + b) for a, b in ((x, 0), (y, 1), (x + y, 2))]
    return np.stack(waves, axis=-1).astype(np.uint8)


CAMERA_Z_M = 0.4


def depth_m(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a board 0.5 m wide and 0.3 m high, 2 m away, before a wall 4 m away, on a floor."""
    with np.errstate(divide="ignore"):
        z = np.minimum(4.0, np.where(y > 0.0, CAMERA_Z_M / y, np.inf))
    board = (np.abs(2.0 * x - 0.2) < 0.25) & (2.0 * y < CAMERA_Z_M) & (2.0 * y > CAMERA_Z_M - 0.3)
    return np.where(board, 2.0, z).astype(np.float32)


def rectified(lens: Lens, camera: CameraModel) -> tuple[np.ndarray, np.ndarray]:
    """Colours and depth of the scene through a lens, rectified."""
    rectifier, seen = Rectifier(lens, camera), rays(lens.camera, lens)
    rgb, depth = np.full((240, 320, 3), 9, np.uint8), np.full((240, 320), 9.0, np.float32)
    assert rectifier.into(frame(Image, colours(*seen)), rgb) == 240
    assert rectifier.into(frame(DepthImage, depth_m(*seen)), depth) == 240
    return rgb, depth


def test_an_empty_picture_stays_empty():
    lens, camera = LENSES["plumb_bob"]
    nothing = Image(0, 0, lambda out: 0)
    assert Rectifier(lens, camera).into(nothing, np.zeros((240, 320, 3), np.uint8)) == 0


@pytest.mark.parametrize("name", LENSES)
def test_a_rectified_image_is_the_pinhole_cameras_within_a_pixel(name):
    lens, camera = LENSES[name]
    rgb, depth = rectified(lens, camera)
    shown = cv2.erode(rgb.any(axis=-1).astype(np.uint8), np.ones((5, 5))) > 0
    assert shown[60:180, 80:240].all()
    assert shown.mean() > 0.6
    x, y = rays(camera)
    # A pixel off would be 3 to 5 grey levels: 7 * 100 / fx.
    assert np.abs(rgb.astype(int) - colours(x, y))[shown].max() <= 2
    px_x, px_y = 1.4 / camera.fx_px, 1.4 / camera.fy_px  # half a raw one of the fisheye
    around = [depth_m(x + i * px_x, y + j * px_y) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    near, far = np.min(around, axis=0), np.max(around, axis=0)
    assert ((depth >= near) & (depth <= far))[shown].all()
    assert not depth[~rgb.any(axis=-1)].any()


def test_pixels_beyond_the_lens_model_stay_black():
    """Polynomials turn back outside the image that they were fitted to."""
    lens = Lens("plumb_bob", (-0.4, 0.0, 0.0, 0.0, 0.0), RAW)
    far_out = CameraModel(320, 240, 60.0, 60.0, 159.5, 119.5)
    white, out = np.full((240, 320, 3), 255, np.uint8), np.zeros((240, 320, 3), np.uint8)
    Rectifier(lens, far_out).into(frame(Image, white), out)
    x, y = rays(far_out)
    turns = (3 * 0.4) ** -0.5  # of r - 0.4 r^3
    assert not out[np.hypot(x, y) > 1.01 * turns].any()
    assert out[np.hypot(x, y) < 0.5].all()


@pytest.mark.parametrize("name", ["plumb_bob", "equidistant"])
def test_rectified_depth_maps_to_the_same_cells(name):
    lens, camera = LENSES[name]
    T = SE2(0.0, 0.0, 0.0).matrix() @ to_optical(se3(0.0, 0.0, CAMERA_Z_M))

    def mapped(depth: np.ndarray) -> set[tuple[int, int]]:
        grid = RollingMap(config.MappingConfig(range_m=3.0, extent_m=9.0, inflation_m=0.0))
        grid.update_depth(depth, camera, np.eye(4), T)
        found = grid.snapshot(inflated=0)
        rows, columns = np.nonzero(found.cells == 100)
        return {tuple(np.floor(p / 0.05 + 0.5)) for p in found.centres_m(rows, columns) - 0.025}

    expected = mapped(depth_m(*rays(camera)))
    assert len(expected) >= 10
    assert mapped(rectified(lens, camera)[1]) == expected
    assert mapped(depth_m(*rays(lens.camera, lens))) != expected


@pytest.mark.parametrize(
    ("model", "coefficients", "says"),
    [
        ("kannala", (0.1,), "kannala distortion, k1 = 0.1: unknown distortion model"),
        ("", (0.1,), "known: plumb_bob, rational_polynomial, equidistant"),
        ("equidistant", (0.1, 0, 0, 0, 0.2), "5 coefficients, at most 4"),
        ("rational_polynomial", (0.1, *[0.0] * 13, 0.2), "15 coefficients, at most 14"),
    ],
)
def test_an_unknown_lens_is_refused_in_one_line(model, coefficients, says):
    with pytest.raises(ValueError, match=says) as caught:
        Rectifier(Lens(model, coefficients, RAW), RAW)
    assert "\n" not in str(caught.value)


def test_an_image_too_large_for_a_map_is_refused():
    wide = CameraModel(40_000, 20, 30_000.0, 30_000.0, 20_000.0, 10.0)
    with pytest.raises(ValueError, match="40000x20, at most 32766"):
        Rectifier(Lens("plumb_bob", (0.1,), wide), wide)


@pytest.mark.filterwarnings("error")
@given(
    model=st.sampled_from(MODELS),
    coefficients=st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=4),
    focal=st.sampled_from([0.4, 30.0, 4000.0]),
)
def test_no_lens_reaches_outside_its_image(model, coefficients, focal):
    camera, raw = (
        CameraModel(40, 30, 30.0, 30.0, 20.0, 15.0),
        CameraModel(40, 30, focal, focal, 9, 9),
    )
    out = np.zeros((30, 40), np.float32)
    try:
        rectifier = Rectifier(Lens(model, tuple(coefficients), raw), camera)
    except ValueError:
        return
    rectifier.into(frame(DepthImage, np.full((30, 40), 2.0, np.float32)), out)
    assert set(np.unique(out)) <= {0.0, 2.0}


@pytest.mark.parametrize(
    ("topic", "is_so"),
    [
        ("", False),
        ("/camera/color/image_raw", False),
        ("/director/image_raw", False),
        ("edge/camera/rgb", False),
        ("/camera/rgb/image_rect_color", True),
        ("/left/image_rect/compressed", True),
        ("edge/front/rectified", True),
    ],
)
def test_a_topics_name_says_whether_its_images_are_rectified(topic, is_so):
    assert is_rectified(topic) == is_so
