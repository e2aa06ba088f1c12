from __future__ import annotations

import numpy as np
import pytest

from edge.geometry import SE2, CameraModel, Grid
from edge.tasks.scene.picture import colour, draw_marks
from edge.tasks.scene.scene import Scene

EMPTY = Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), 0.1)
SQUARE = np.array([[10, 10], [50, 10], [50, 40], [10, 40]], np.int32)


def scene(rgb=None, contours=None):
    camera = None if rgb is None else CameraModel.from_hfov(rgb.shape[1], rgb.shape[0], 1.2)
    T = None if rgb is None else np.eye(4)
    return Scene(0, SE2(0, 0, 0), {}, {}, EMPTY, EMPTY, rgb, camera, T, contours or {})


GRAY = np.full((120, 160, 3), 90, np.uint8)


def test_without_a_picture_nothing_is_drawn():
    assert draw_marks(scene()) is None


@pytest.mark.parametrize(("longest_px", "shape"), [(80, (60, 80, 3)), (2000, (720, 960, 3))])
def test_the_picture_is_scaled_to_the_longest_side(longest_px, shape):
    assert draw_marks(scene(GRAY, {1: [SQUARE]}), longest_px).shape == shape


def test_an_outline_is_drawn_in_its_colour_and_place():
    image = draw_marks(scene(GRAY, {7: [SQUARE]}))
    outlined = (np.abs(image.astype(int) - colour(7)) <= 2).all(axis=2)
    for x, y in (SQUARE * 6).tolist():
        assert outlined[y - 2 : y + 3, x - 2 : x + 3].any()
    assert not outlined[:50].any()
    assert not outlined[250:].any()


def test_every_object_has_a_visible_number():
    """Many objects on one spot have as many black discs next to each other."""
    contours = {i: [SQUARE] for i in range(1, 7)}
    one = (draw_marks(scene(GRAY, {1: [SQUARE]})) == 0).all(axis=2).sum()
    six = (draw_marks(scene(GRAY, contours)) == 0).all(axis=2).sum()
    assert six > 4 * one
