"""The map picture: cropping, thinning, colours, and drawings of odd runs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from edge.geometry import Grid, thin
from edge.lab.report import palette, picture, raster


def pixels(png: bytes) -> np.ndarray:
    """(h, w, 3) uint8 RGB of a PNG file."""
    bgr = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def count(image: np.ndarray, hex_colour: str) -> int:
    rgb = np.frombuffer(bytes.fromhex(hex_colour[1:]), np.uint8)
    return int((np.abs(image.astype(int) - rgb).max(axis=2) <= 2).sum())


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (5, 4)])
def test_crop_of_nothing_known(shape):
    assert raster.crop(Grid(np.full(shape, -1, np.int8), (0.0, 0.0), 0.1)) is None


def test_crop_keeps_every_known_cell_where_it_was():
    cells = np.full((40, 50), -1, np.int8)
    cells[10, 7], cells[22, 31] = 0, 100
    known = raster.crop(Grid(cells, (-2.0, 1.0), 0.1))
    np.testing.assert_array_equal(known.cells, cells[10:23, 7:32])
    assert known.extent_m == pytest.approx((-1.3, 1.2, 2.0, 3.3))


@pytest.mark.parametrize(
    ("shape", "max_side", "k"), [((3, 4), 4, 1), ((8, 8), 4, 2), ((9, 5), 4, 3), ((1, 10), 4, 3)]
)
def test_thin_keeps_obstacles_and_then_free_space(shape, max_side, k):
    rng = np.random.default_rng(1)
    cells = rng.choice(np.array([-1, 0, 100], np.int8), shape, p=[0.6, 0.3, 0.1])
    small = thin(Grid(cells, (-1.0, 2.0), 0.5), max_side)
    assert (small.origin_xy_m, small.resolution_m) == ((-1.0, 2.0), 0.5 * k)
    assert max(small.cells.shape) <= max_side
    for y, x in np.ndindex(small.cells.shape):
        assert small.cells[y, x] == cells[y * k : (y + 1) * k, x * k : (x + 1) * k].max()


def test_an_empty_run_is_drawn(empty_run):
    image = pixels(picture.png(empty_run))
    assert count(image, palette.UNKNOWN) > 0.3 * image.shape[0] * image.shape[1]


def test_everything_of_a_run_is_drawn(run):
    image = pixels(picture.png(run))
    bare = pixels(picture.png(replace(run, goals=(), instances=(), frontiers_m=np.zeros((0, 2)))))
    for colour, least in ((palette.FRONTIER, 300), (palette.TARGET, 1000)):
        assert count(image, colour) > count(bare, colour) + least
    assert count(image, palette.OCCUPIED) > 5000
    assert count(image, palette.outcome_colour("reached")) > 1000


def test_a_huge_map_is_thinned_and_its_walls_stay(run):
    cells = np.zeros((4000, 4000), np.int8)
    cells[2000, :] = 100  # one cell wide: every third row would miss it
    huge = replace(run, map=Grid(cells, (-100.0, -100.0), 0.05), instances=())
    image = pixels(picture.png(huge))
    assert max(image.shape) < 2500
    assert thin(huge.map, raster.MAX_SIDE_PX).cells.max(axis=0).min() == 100


@pytest.mark.parametrize("size_m", [(40.0, 4.0), (3.0, 40.0)])
def test_long_maps_keep_the_picture_readable(run, size_m):
    cells = np.zeros((round(size_m[1] / 0.1), round(size_m[0] / 0.1)), np.int8)
    image = pixels(picture.png(replace(run, map=Grid(cells, (-1.0, -1.0), 0.1))))
    assert 600 < image.shape[0] < 1200
    assert 800 < image.shape[1] < 1500


@pytest.mark.parametrize("first", [0, 1, 2])
def test_any_text_can_be_a_title_or_a_label(run, first):
    texts = ("$x^", "a $b$ c", "x" * 200, "\\frac", "a_{b", "Stühle für 2")
    title, reason, label = (texts[(first + 2 * k) % 6] for k in range(3))
    named = replace(run.instances[0], label=label)
    mission = replace(run.mission, phase="failed", reason=reason)
    changed = replace(run, title=title, instances=(named,), mission=mission)
    assert picture.png(changed).startswith(b"\x89PNG")
