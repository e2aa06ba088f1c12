from __future__ import annotations

import numpy as np
import painted_scenes
import pytest
from painted_scenes import PAINTS

from edge.geometry import SE2
from edge.tasks.scene.captions import (
    COLOURS,
    colour_names,
    colour_of,
    in_white_light,
    light_gains,
    place_of,
)
from edge.types import MASK_SIDE

COLOURED = {
    "black": (20, 20, 20), "gray": (128, 128, 128), "white": (240, 240, 240), "red": (200, 20, 20),
    "orange": (250, 130, 20), "yellow": (240, 220, 30), "green": (30, 160, 40),
    "blue": (30, 60, 200), "purple": (120, 40, 200), "pink": (250, 90, 180), "brown": (110, 60, 20),
}  # fmt: skip


def painted(colour, h=20, w=30):
    return np.full((h, w, 3), colour, np.uint8)


@pytest.mark.parametrize("name", COLOURS)
def test_colours_have_their_names(name):
    assert {COLOURS[i] for i in colour_names(painted(COLOURED[name])).ravel()} == {name}


WHOLE = np.array([0, 0, 30, 20], np.float32)


def test_a_box_outside_the_picture_has_no_colour():
    assert colour_of(painted((200, 20, 20)), np.array([50, 5, 60, 10], np.float32)) == ""


def test_the_mask_says_which_pixels_count():
    rgb = painted(COLOURED["green"])
    rgb[:, :15] = COLOURED["red"]
    mask = np.zeros((MASK_SIDE, MASK_SIDE), np.bool_)
    mask[:, : MASK_SIDE // 2] = True
    assert colour_of(rgb, WHOLE, mask) == "red"
    assert colour_of(rgb, WHOLE, ~mask) == "green"


@pytest.mark.parametrize(
    ("paint", "name"),
    [((40, 4, 4), "red"), ((45, 8, 6), "red"), ((8, 14, 44), "blue"), ((14, 14, 16), "black"),
     ((30, 34, 44), "black"), ((5, 12, 6), "black")],
)  # fmt: skip
def test_in_the_shade_a_car_keeps_its_colour(paint, name):
    """Among tyres, windows and its own shadow, which are black."""
    rgb = painted((6, 6, 8))
    rgb[6:14] = paint
    assert colour_of(rgb, WHOLE, np.ones((MASK_SIDE, MASK_SIDE), np.bool_)) == name


@pytest.mark.parametrize("light", painted_scenes.LIGHTS)
@pytest.mark.parametrize("place", painted_scenes.PLACES)
def test_colours_keep_their_names_in_other_light(place, light):
    results = painted_scenes.results(place, light)
    wrong = [(true, given) for true, given in results if true != given]
    assert len(wrong) <= 3, wrong


@pytest.mark.parametrize("place", painted_scenes.PLACES)
def test_full_light_is_left_unchanged(place):
    rgb = painted_scenes.picture(place, (190, 40, 36), "full")
    assert in_white_light(rgb) is rgb
    assert painted_scenes.results(place, "full") == [(name, name) for name, _ in PAINTS]


@pytest.mark.parametrize("place", painted_scenes.PLACES)
def test_no_bright_paint_turns_black_in_the_shade(place):
    greys = ("black", "gray", "white")
    results = painted_scenes.results(place, "30 %", shaded=True)
    assert [(a, b) for a, b in results if a not in greys and b in greys] == []
    assert [b for a, b in results if a == "black"] == ["black", "black"]


@pytest.mark.parametrize(
    ("rgb", "gains"),
    [
        (painted((0, 0, 0), 1, 1), (4, 4, 4)),  # as much as there is
        (painted((190, 40, 36)), (1, 1, 1)),  # red, but no lamp is as red
        (painted((96, 132, 74)), (1, 1, 1)),  # no light is green
        (np.vstack((painted((100, 160, 220)), painted((128, 128, 128)))), (1, 1, 1)),  # a blue sky
        (painted((200, 160, 110)), (1, 1.25, 200 / 110)),
    ],
)
def test_light_gains_come_from_neutral_colours(rgb, gains):
    np.testing.assert_allclose(light_gains(rgb), gains, rtol=1e-3)


def test_a_patchwork_has_no_colour():
    rgb = np.array(list(COLOURED.values()), np.uint8)[np.arange(600).reshape(20, 30) % 11]
    assert colour_of(rgb, WHOLE) == ""


@pytest.mark.parametrize(
    ("x_m", "y_m", "yaw", "place"),
    [
        (0.0, 0.0, 0.0, "0 m ahead"),
        (10.0, 0.4, 0.0, "10 m ahead"),
        (-5.0, 0.0, 0.0, "5 m behind"),
        (0.0, 3.0, 0.0, "3 m to the left"),
        (0.0, 3.0, np.pi / 2, "3 m ahead"),
        (4.0, 0.0, np.pi / 2, "4 m to the right"),
        (8.0, -2.0, 0.0, "8 m ahead, 2 m to the right"),
    ],
)
def test_places_are_as_the_robot_sees_them(x_m, y_m, yaw, place):
    assert place_of(np.array([x_m, y_m, 0.0]), SE2(0.0, 0.0, yaw)) == place
