from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import GROUND, Box, found_in, street

from edge import config
from edge.geometry import SE2, CameraModel, se3, wrap_angle
from edge.mapping import layers as ly
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.mission.language.words.tokens import TranslationError
from edge.tasks.rules import parse_steps
from edge.tasks.scene.frames import cloud_of, contours_of
from edge.tasks.scene.ground import ground_of
from edge.tasks.scene.map_scene import scene_of_map
from edge.tasks.scene.objects import ObjectMap
from edge.tasks.scene.pipeline import PerceptionPipeline, boxes_as_masks
from edge.tasks.scene.scene_builder import SceneBuilder, add_detections
from edge.types import MASK_SIDE, Instance, Observation

MAP = config.MappingConfig(
    input="cloud", resolution_m=0.2, extent_m=64.0, range_m=30.0, min_range_m=1.0,
    inflation_m=0.1, obstacle_min_m=0.25, obstacle_max_m=2.0,
)  # fmt: skip
STREET = (
    Box(12.0, 4.0, (4.2, 1.8, 1.5), 1.2, "car", (210, 20, 20)),
    Box(9.0, -3.5, (1.0, 1.0, 1.2), 0.0, "trash can", (20, 40, 190)),
    Box(24.0, 0.0, (1.0, 30.0, 6.0), 0.0, "building", (235, 235, 235)),
)


def perfect(boxes):
    """Return a pipeline whose detector sees all boxes exactly."""
    return PerceptionPipeline(
        lambda observation: tuple(box.label for box in boxes),
        lambda observation, tags: found_in(observation, boxes),
        boxes_as_masks,
    )


def survey_of(boxes, *poses, kinds=None, labels=(), **more):
    survey = SceneBuilder(perfect(boxes), MAP, ground_labels=labels, **more)
    for i, T_map_base in enumerate(poses, start=1):
        observation, hit = street(boxes, T_map_base, seq=i)
        survey.add(observation, None if kinds is None else kinds(observation, hit))
    return survey


def test_no_frame_no_scene():
    with pytest.raises(ValueError, match="no frame was added"):
        SceneBuilder(perfect(()), MAP).scene()


@pytest.mark.parametrize("rubbish", [np.nan, np.inf, 3e38, 1e9])
def test_invalid_points_of_a_scan_change_nothing(rubbish):
    """A third of the returns, with their kinds of ground; the rest is seen as if they were not."""
    seen, hit = street(STREET, np.eye(4), seq=1)
    kind, cloud_m = (hit == GROUND).astype(np.uint8), seen.cloud_m.copy()
    cloud_m[::3] = rubbish
    left = np.arange(len(cloud_m)) % 3 > 0
    scenes = []
    for points_m, of in ((cloud_m, kind), (seen.cloud_m[left], kind[left])):
        survey = SceneBuilder(perfect(STREET), MAP, ground_labels=("road",))
        survey.add(replace(seen, cloud_m=points_m), of)
        scenes.append(survey.scene())
    told, clean = scenes
    assert {k: v.caption for k, v in told.objects.items()} == {
        k: v.caption for k, v in clean.objects.items()
    }
    np.testing.assert_array_equal(told.regions_grid.cells, clean.regions_grid.cells)


def test_returns_from_the_robot_itself_are_no_ground():
    """Returns nearer than `min_range_m`, 1 m, in the middle of a road."""
    seen, hit = street((), np.eye(4), seq=1)
    own_m = np.random.default_rng(0).uniform((-0.6, -0.6, -0.6), (0.6, 0.6, -0.3), (400, 3))
    own_m = own_m[np.linalg.norm(own_m, axis=1) < 1.0].astype(np.float32)
    survey = SceneBuilder(perfect(()), MAP, ground_labels=("road",))
    cloud_m = np.concatenate((seen.cloud_m, own_m))
    kind = np.concatenate((hit == GROUND, np.zeros(len(own_m), np.bool_))).astype(np.uint8)
    survey.add(replace(seen, cloud_m=cloud_m), kind)
    grid = survey.scene().regions_grid
    centres_m = grid.centres_m(*np.indices(grid.cells.shape))
    near = np.hypot(*np.moveaxis(centres_m, -1, 0)) < 1.0
    assert (grid.cells[near] > 0).all()


def test_an_empty_plane_is_one_region():
    scene = survey_of((), np.eye(4)).scene()
    assert scene.objects == scene.contours == {}
    (region,) = scene.regions.values()
    assert region.label == "ground"
    assert region.area_m2 > 1000.0
    assert scene.regions_grid.cells.shape == scene.occupancy.cells.shape
    assert scene.stamp_ns == 100_000_000


def test_objects_have_the_place_and_size_of_their_points():
    scene = at_the_origin()
    assert [o.label for o in scene.objects.values()] == ["car", "trash can", "building"]
    car, can, building = scene.objects.values()
    # The side that faces the robot is seen alone.
    assert np.hypot(*(car.position_m[:2] - (12.0, 4.0))) < 1.0
    np.testing.assert_allclose(car.size_m[[0, 2]], [4.2, 1.4], atol=0.4)
    assert car.size_m[1] <= 1.9
    assert abs(wrap_angle(2 * (car.heading_rad - 1.2))) < 0.2
    assert np.hypot(*(can.position_m[:2] - (9.0, -3.5))) < 0.6
    assert abs(building.position_m[0] - 23.5) < 0.5  # its front is seen alone
    assert car.caption.startswith("red car, ")
    assert can.caption.startswith("blue trash can, ")
    assert (
        "9 m ahead, 3 m to the right" in can.caption or "9 m ahead, 4 m to the right" in can.caption
    )


@cache
def at_the_origin():
    return survey_of(STREET, np.eye(4)).scene()


@given(x_m=st.floats(-20, 20), y_m=st.floats(-20, 20), yaw=st.floats(-3.1, 3.1))
@settings(max_examples=6)
def test_a_scene_moves_with_the_robot(x_m, y_m, yaw):
    """The same street around a robot elsewhere: places move, captions stay."""
    T = se3(x_m, y_m, 0.0, yaw_rad=yaw)
    here = at_the_origin()
    c, s = np.cos(yaw), np.sin(yaw)
    moved = tuple(
        replace(box, x_m=x_m + c * box.x_m - s * box.y_m, y_m=y_m + s * box.x_m + c * box.y_m,
                heading_rad=box.heading_rad + yaw)
        for box in STREET
    )  # fmt: skip
    there = survey_of(moved, T).scene()
    assert list(there.objects) == list(here.objects)
    for i, obj in there.objects.items():
        place = T[:3, :3] @ here.objects[i].position_m + T[:3, 3]
        np.testing.assert_allclose(obj.position_m, place, atol=0.6)
    assert there.contours.keys() == here.contours.keys()


def test_behind_a_wall_nothing_is_known():
    """This holds even for cells that inflation closes."""
    scene = at_the_origin()
    assert scene.occupancy.cells[scene.occupancy.cell_of(15.0, -1.0)] == 0
    behind = scene.occupancy.cell_of(23.95, -2.0)
    assert behind is None or scene.occupancy.cells[behind] == -1


def test_several_frames_give_the_same_objects():
    """Driven past, a car is seen from both ends: still one, and better known."""
    poses = [np.eye(4), se3(2.0, 0.0), se3(4.0, 0.2, 0.0, yaw_rad=0.05)]
    survey = survey_of(STREET, *poses)
    scene = survey.scene()
    assert [o.label for o in scene.objects.values()] == ["car", "trash can", "building"]
    assert [obj.hits for obj in survey.objects.objects.values()] == [3, 3, 3]
    assert scene.pose == SE2(4.0, 0.2, pytest.approx(0.05))
    assert set(scene.contours) == {1, 2, 3}
    assert scene.rgb is not None


def half_and_half(observation, hit):
    """Label the right half of the ground as sidewalk."""
    y_m = observation.cloud_m[:, 1]  # of the robot at the origin
    return np.where(hit != GROUND, 0, np.where(y_m < -2.0, 2, 1)).astype(np.uint8)


def test_regions_by_their_kind():
    scene = survey_of(STREET, np.eye(4), kinds=half_and_half, labels=("road", "sidewalk")).scene()
    at = {
        scene.regions[scene.regions_grid.cells[scene.regions_grid.cell_of(x_m, y_m)]].label
        for x_m, y_m in ((5.0, 3.0), (-6.0, 5.0), (0.0, 0.0))
    }
    assert at == {"road"}
    right = scene.regions_grid.cells[scene.regions_grid.cell_of(5.0, -6.0)]
    assert scene.regions[right].label == "sidewalk"
    labels = {scene.regions[i].label for i in scene.objects[2].nearest_m}
    assert labels == {"road", "sidewalk"}


def test_returns_above_the_robot_hide_no_ground():
    """A crown of leaves 4 m above the road; its returns are of no kind of ground."""
    seen, hit = street((), np.eye(4), seq=1)
    crown_m = np.random.default_rng(0).uniform((5, -2, 2), (9, 2, 3), (20_000, 3))
    cloud_m = np.concatenate((seen.cloud_m, crown_m)).astype(np.float32)
    kind = np.concatenate((hit == GROUND, np.zeros(len(crown_m), np.bool_))).astype(np.uint8)
    survey = SceneBuilder(perfect(()), MAP, ground_labels=("road",))
    survey.add(replace(seen, cloud_m=cloud_m), kind)
    grid = survey.scene().regions_grid
    centres_m = grid.centres_m(*np.indices(grid.cells.shape))
    below = (np.abs(centres_m - (7.0, 0.0)) < 1.5).all(axis=-1)
    assert (grid.cells[below] > 0).all()


def test_kinds_are_for_all_points():
    observation, _ = street(())
    with pytest.raises(ValueError, match="one a point, got 3"):
        SceneBuilder(perfect(()), MAP, ground_labels=("road",)).add(
            observation, np.zeros(3, np.uint8)
        )


def test_depth_is_a_cloud_too():
    depth = np.full((60, 80), np.nan, np.float32)
    depth[20:40, 30:50] = 2.0
    observation = Observation(
        1, 0, np.eye(4), depth_m=depth, camera=CameraModel.from_hfov(80, 60, 1.2)
    )
    cloud, T = cloud_of(observation)
    assert len(cloud) == 400
    assert (cloud[:, 2] == 2.0).all()
    np.testing.assert_array_equal(T, observation.T_base_camera)


@pytest.mark.parametrize("depth", [None, np.zeros((3, 4), np.float32)])
def test_an_observation_without_cloud_or_depth_is_refused(depth):
    with pytest.raises(ValueError, match="it has neither a cloud nor a depth image"):
        cloud_of(Observation(1, 0, np.eye(4), depth_m=depth))


def test_contours_are_the_masks_or_the_boxes():
    observation, _ = street(STREET)
    found = found_in(observation, STREET)
    (square,) = contours_of(found, 0)
    x0, y0, x1, y1 = found.xyxy_px[0]
    assert square.tolist() == [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    mask = np.zeros((len(found), MASK_SIDE, MASK_SIDE), np.bool_)
    mask[0, :, : MASK_SIDE // 2] = True
    (outline,) = contours_of(replace(found, mask=mask), 0)
    assert outline[:, 0].max() <= 0.5 * (x0 + x1) + 1
    assert outline[:, 0].min() == x0
    assert len(contours_of(replace(found, mask=mask), 1)) == 1


def forget(grid, inner_m, outer_m):
    """Set the cells between two distances from the origin to unknown."""
    n, res = round(outer_m / grid.resolution_m), grid.resolution_m
    for x, y in np.ndindex(2 * n, 2 * n):
        if inner_m < np.hypot(x - n + 0.5, y - n + 0.5) * res < outer_m:
            grid._cells.write(x - n, y - n, ly.UNSEEN)


def of_service(instances, boxes=STREET, found=False, blind_m=0.0):
    observation, _ = street(boxes)
    grid = RollingMap(MAP)
    grid.update_cloud(observation.cloud_m, observation.T_map_base, observation.T_base_lidar)
    forget(grid, 0.5, blind_m)
    seen = found_in(observation, boxes) if found else None
    return scene_of_map(MapView(grid), observation, instances, 0.3, seen)


def test_points_outside_later_boxes_are_dropped():
    """The first box is too wide, and shows the post too; the others fit."""
    can, post = STREET[1], Box(9.0, -2.2, (1.0, 1.0, 1.2), 0.0, "post", (90, 90, 90))
    objects = ObjectMap()
    for k in range(3):
        observation, _ = street((can, post), seq=k + 1)
        found = found_in(observation, (can, post))
        boxes = found.xyxy_px[:1].copy()
        if k == 0:
            boxes = np.concatenate((np.minimum(*found.xyxy_px[:, :2])[None],
                                    np.maximum(*found.xyxy_px[:, 2:])[None]), axis=1)  # fmt: skip
        found = replace(
            found, xyxy_px=boxes, score=found.score[:1], class_id=found.class_id[:1],
            prompts=("trash can",),
        )  # fmt: skip
        add_detections(objects, found, 20.0)
        (obj,) = objects.objects.values()
        reach_m = objects.confirmed_points_m(obj)[:, 1].max()
        assert (reach_m > -2.2) == (k == 0)
    assert obj.points_m[:, 1].max() > -2.2


def test_the_rules_know_the_colours_that_the_service_saw():
    car, seen = STREET[0], ObjectMap()
    observation, _ = street(STREET)
    add_detections(seen, found_in(observation, STREET), 20.0)
    points = next(obj.points_m for obj in seen.objects.values() if obj.label == "car")
    instance = Instance(7, "car", np.median(points, 0), points[::9], 0.8, 4, 0, 1)
    grid = RollingMap(MAP)
    grid.update_cloud(observation.cloud_m, observation.T_map_base, observation.T_base_lidar)
    scene = scene_of_map(MapView(grid), observation, [instance], 0.3, object_map=seen)
    assert scene.objects[7].caption.startswith("red car, ")
    assert [obj.id for obj in parse_steps("go to the red car", scene)[0].objects] == [7]
    assert car.label == scene.objects[7].label
    with pytest.raises(TranslationError, match="describes none of them: car 7"):
        parse_steps("go to the blue car", scene)


def test_the_service_has_seen_nothing():
    scene = of_service([], ())
    assert scene.objects == scene.contours == {}
    assert [r.label for r in scene.regions.values()] == ["floor"]


@pytest.mark.parametrize("by", ["survey", "service"])
def test_a_robot_can_leave_its_blind_spot(by):
    """Cells that no sensor sees are all around it: the ground beyond is reached nevertheless."""
    if by == "service":
        scene = of_service([], blind_m=3.5)
    else:
        survey = survey_of(STREET, np.eye(4))
        forget(survey.map, 0.5, 3.5)
        scene = survey.scene()
        assert all(obj.nearest_m for obj in scene.objects.values())
    ground = ground_of(scene, 0.3)
    assert ground.is_free(0.0, 0.0)
    assert ground.is_free(6.0, 0.0)


def test_instances_of_the_service_are_objects():
    points = np.array([[8.6, -3.5 + 0.02 * i, 0.1 * (i % 10)] for i in range(30)], np.float32)
    instance = Instance(5, "trash can", np.median(points, 0), points, 0.8, 4, 0, 1)
    scene = of_service([instance], found=True)
    (obj,) = scene.objects.values()
    assert (obj.id, obj.label) == (5, "trash can")
    assert obj.caption.startswith("trash can, ")
    assert set(scene.contours) == {5}
    assert scene.contours[5][0].shape == (4, 2)
    x_m, y_m = obj.nearest_m[1]
    assert np.hypot(x_m - 8.6, y_m + 3.3) < 1.2
