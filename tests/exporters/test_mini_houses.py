"""The data of the small detector: houses, phrases for their objects, pictures, batches."""

from __future__ import annotations

import errno
import math
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.lab.sim import assemblies
from edge.lab.sim.generator.contents import SUPPORTS
from exporters.files import ExportError
from exporters.training.mini import houses, looks, views
from exporters.training.mini.houses import random_house


@pytest.fixture(scope="module")
def house_frames():
    rgb = np.zeros((3, views.HEIGHT_PX, views.WIDTH_PX, 3), np.uint8)
    return rgb, views.render_house(0, len(rgb), rgb)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_objects_stay_inside_the_house_and_below_the_ceiling(seed):
    house, appearances = random_house(seed)
    assert len(appearances) == len(house.objects) > 0
    xs = [x for room in house.rooms for x in room.rect[::2]]
    ys = [y for room in house.rooms for y in room.rect[1::2]]
    assert (min(xs), min(ys), max(xs), max(ys)) == (0, 0, *houses.extent_m(house))
    for obj, look in zip(house.objects, appearances, strict=True):
        assert min(xs) - 0.8 < obj.at[0] < max(xs) + 0.8
        assert min(ys) - 0.8 < obj.at[1] < max(ys) + 0.8
        assert obj.z_m + obj.size[2] < house.wall_height_m
        assert list(assemblies.CATEGORIES)[look.category - 1] == obj.category


def test_raised_objects_stand_on_a_support():
    raised = 0
    for seed in range(6):
        objects = random_house(seed)[0].objects
        supports = [t for t in objects if t.category in SUPPORTS]
        for obj in objects:
            if obj.z_m > 0 and obj.category != "picture":
                raised += 1
                assert any(_carries(support, obj) for support in supports)
    assert raised


def _carries(support, obj) -> bool:
    """Return True if it ends at the object's start and has the object's middle above it."""
    dx, dy, yaw = (*np.subtract(obj.at, support.at), math.radians(support.yaw_deg))
    across, along = dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw)
    level = support.size[2] == obj.z_m
    return level and abs(across) < 1e-6 and abs(along) <= 0.5 * support.size[1]


@pytest.mark.parametrize(
    ("rgb", "name"), [(v, k) for k, v in looks.PALETTE.items()] + [((250, 10, 10), "red")]
)
def test_a_plain_colour_has_its_name_and_no_other(rgb, name):
    answers = looks.color_answers(rgb)
    assert answers[0] == looks.YES
    assert answers[1 + looks.COLORS.index(name)] == looks.YES
    assert (answers[1:] == looks.YES).sum() == 1


def test_between_two_colours_both_are_unsure():
    lab_middle = np.mean([looks.PALETTE["white"], looks.PALETTE["gray"]], axis=0)
    answers = looks.color_answers(lab_middle)
    assert looks.YES not in answers[1:]
    assert (answers == looks.UNSURE).sum() >= 2


@given(
    st.lists(st.integers(0, 255), min_size=3, max_size=3),
    st.sampled_from([None, *looks.SIZES]),
    st.sampled_from(list(assemblies.CATEGORIES)),
    st.lists(
        st.tuples(
            st.integers(1, len(looks.CATEGORIES)),
            st.integers(0, len(looks.COLORS)),
            st.integers(0, len(looks.SIZES)),
        ),
        min_size=1,
        max_size=8,
    ),
)
def test_a_longer_phrase_never_turns_a_no_into_yes(rgb, style, category, rows):
    phrases = np.array(rows)
    less = phrases.copy()
    less[:, 1] = 0
    obj = (
        np.array([list(assemblies.CATEGORIES).index(category) + 1]),
        looks.color_answers(rgb)[None],
        looks.size_answers(style, category)[None],
    )
    more, fewer = looks.answers(*obj, phrases)[0], looks.answers(*obj, less)[0]
    assert set(more.tolist()) <= {looks.NO, looks.YES, looks.UNSURE}
    assert not ((fewer == looks.NO) & (more != looks.NO)).any()
    assert not ((more == looks.YES) & (fewer != looks.YES)).any()


def test_boxes_are_tight_and_inside_the_picture(house_frames):
    rgb, found = house_frames
    assert rgb.std() > 5
    objects = np.concatenate(found)
    assert len(objects)
    box = objects["box"]
    assert (box[:, :2] >= 0).all()
    assert (box[:, 2:] <= (views.WIDTH_PX, views.HEIGHT_PX)).all()
    area = (box[:, 2:] - box[:, :2]).prod(axis=1)
    assert (objects["pixels"] >= views.MIN_PIXELS).all()
    assert (objects["pixels"] <= area).all()
    assert (objects["visible"] > 0).all()
    assert (objects["visible"] <= 1.0).all()


def test_pictures_of_a_seed_are_the_same_again(house_frames):
    rgb, found = house_frames
    again = np.zeros_like(rgb)
    for a, b in zip(found, views.render_house(0, len(rgb), again), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(rgb, again)


def test_an_object_with_invisible_colour_has_no_colour_label(monkeypatch):
    rgb = np.zeros((3, views.HEIGHT_PX, views.WIDTH_PX, 3), np.uint8)
    monkeypatch.setattr(views, "COLORED", 1.01)
    objects = np.concatenate(views.render_house(0, len(rgb), rgb))
    assert len(objects)
    assert (objects["color"] == looks.unsure_color()).all()


def test_frames_are_made_once(tmp_path, monkeypatch):
    first = views.make_frames(range(2, 4), 2, tmp_path)
    monkeypatch.setattr(views, "render_house", None)
    second = views.make_frames(range(2, 4), 2, tmp_path)
    assert len(first) == len(second) == 4
    np.testing.assert_array_equal(first.rgb, second.rgb)
    np.testing.assert_array_equal(first.objects, second.objects)
    assert first.start[-1] == len(first.objects)


@pytest.mark.parametrize(
    "change", ["seeds", "code"], ids=["other seeds of the same ends", "other code"]
)
def test_frames_of_other_houses_are_not_reused(tmp_path, monkeypatch, change):
    def paint(seed, count, out_rgb):
        out_rgb[:] = seed
        return [np.zeros(1, views.OBJECT)] * count

    monkeypatch.setattr(views, "render_house", paint)
    views.make_frames([0, 1, 3], 1, tmp_path)
    if change == "seeds":
        assert views.make_frames([0, 2, 3], 1, tmp_path).rgb[1, 0, 0, 0] == 2
    else:
        source = tmp_path / "houses.py"
        source.write_text("")
        monkeypatch.setattr(views, "_SOURCES", (source,))
        views.make_frames([0, 1, 3], 1, tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_unfinished_frames_are_rendered_again(tmp_path, monkeypatch):
    def stop(*args, **named):
        raise KeyboardInterrupt

    with monkeypatch.context() as stopped:
        stopped.setattr(views.np, "savez", stop)
        with pytest.raises(KeyboardInterrupt):
            views.make_frames(range(2, 3), 1, tmp_path)
    frames = views.make_frames(range(2, 3), 1, tmp_path)
    assert frames.rgb.std() > 5
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".npz", ".u8"]


def test_two_commands_make_the_same_frames_at_once(tmp_path, monkeypatch):
    """The second begins and ends while the first is rendering."""
    render, within = views.render_house, []

    def render_amid(seed, count, out_rgb):
        if not within:
            within.append(None)
            within[0] = views.make_frames(range(2, 3), 1, tmp_path)
        return render(seed, count, out_rgb)

    monkeypatch.setattr(views, "render_house", render_amid)
    frames = views.make_frames(range(2, 3), 1, tmp_path)
    np.testing.assert_array_equal(frames.rgb, within[0].rgb)
    np.testing.assert_array_equal(frames.objects, within[0].objects)


def test_a_full_disk_is_reported_with_the_needed_space(tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(ExportError, match=r"no room for 8\.1 GB .*No space left") as caught:
        views.make_frames(range(3000), 11, tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
