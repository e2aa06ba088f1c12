"""The map picture: cropping, thinning, colours, and drawings of odd runs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from rooms import KITCHEN

from edge.geometry import SE2, Grid, downsample
from edge.lab.report import palette, picture, raster
from edge.memory import KnownObject, Place, Site, Zone


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


@pytest.mark.parametrize(
    ("shape", "max_side", "k"), [((3, 4), 4, 1), ((8, 8), 4, 2), ((9, 5), 4, 3), ((1, 10), 4, 3)]
)
def test_thin_keeps_obstacles_and_then_free_space(shape, max_side, k):
    rng = np.random.default_rng(1)
    cells = rng.choice(np.array([-1, 0, 100], np.int8), shape, p=[0.6, 0.3, 0.1])
    small = downsample(Grid(cells, (-1.0, 2.0), 0.5), max_side)
    assert (small.origin_xy_m, small.resolution_m) == ((-1.0, 2.0), 0.5 * k)
    assert max(small.cells.shape) <= max_side
    for y, x in np.ndindex(small.cells.shape):
        assert small.cells[y, x] == cells[y * k : (y + 1) * k, x * k : (x + 1) * k].max()


def test_an_empty_run_is_drawn(empty_run):
    image = pixels(picture.png(empty_run))
    assert count(image, palette.UNKNOWN) > 0.3 * image.shape[0] * image.shape[1]


@pytest.mark.parametrize("size_m", [(40.0, 4.0), (3.0, 40.0)])
def test_long_maps_keep_the_picture_readable(run, size_m):
    cells = np.zeros((round(size_m[1] / 0.1), round(size_m[0] / 0.1)), np.int8)
    image = pixels(picture.png(replace(run, map=Grid(cells, (-1.0, -1.0), 0.1))))
    assert 600 < image.shape[0] < 1200
    assert 800 < image.shape[1] < 1500


def test_the_path_is_coloured_and_reached_targets_are_numbered(long_run):
    drawn, green = picture.png(long_run), palette.OUTCOME["reached"]
    by_time = replace(long_run, mission_facts=replace(long_run.mission_facts, log=()))
    simple = replace(long_run, mission_facts=None)
    assert drawn != picture.png(by_time)
    assert count(pixels(drawn), green) > count(pixels(picture.png(simple)), green)


@pytest.mark.parametrize("label", ["chair", "stool"])
def test_the_objects_that_a_target_means_have_its_colour(run, label):
    shown = replace(run, targets={"every chair": label}, goals=(), instances=run.instances)
    colours = {one.label: palette.target_colour(one.label, shown.targets) for one in run.instances}
    assert colours["chair"] == (palette.TARGETS[0] if label == "chair" else palette.OBJECT)
    assert palette.target_colour("every chair", shown.targets) == palette.TARGETS[0]


def test_places_zones_and_remembered_objects_are_drawn(run):
    corners = ((3.0, 5.8), (3.8, 5.8), (3.8, 6.7), (3.0, 6.7))
    items = (Place("$dock", SE2(0.6, 3.4, 1.57)), Zone("stairs", "keep_out", corners))
    mug = KnownObject(1, "mug", (2.0, 3.9, 0.5), 0.6, 4, 3.0)
    before = pixels(picture.png(run))
    image = pixels(picture.png(replace(run, site=Site(items), objects=(mug,))))
    for colour in (palette.PLACE, palette.ZONES["keep_out"], palette.MUTED):
        assert count(image, colour) > count(before, colour) + 50


def test_rooms_are_drawn_with_their_titles(run):
    before = pixels(picture.png(run))
    nameless = replace(KITCHEN, kinds=())
    images = [pixels(picture.png(replace(run, rooms=(one,)))) for one in (KITCHEN, nameless)]
    assert images[0].shape[1] == before.shape[1]
    assert (images[0] != images[1]).any()  # "kitchen" and "room 3"
    for image in images:
        h = min(len(image), len(before))
        assert (image[:h] != before[:h]).any(axis=2).sum() > 300
