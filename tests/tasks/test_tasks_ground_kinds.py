"""Kinds of ground by a network that names the class of each pixel, run by onnxruntime."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scans
from tiny_ground import HW, OUTPUTS, put_network

from edge import config
from edge.cli.preflight import named_models
from edge.host import resources
from edge.mapping.grid import RollingMap
from edge.perception.masks.ground import GroundClassifier
from edge.perception.runtime.cards import ModelError, check_installed, load_card
from edge.tasks.scene import ground_votes
from edge.tasks.scene.ground_votes import GroundVotes
from edge.tasks.scene.map_scene import uninflated
from edge.tasks.scene.pipeline import PerceptionPipeline, boxes_as_masks
from edge.tasks.scene.scene_builder import OUTDOORS, SceneBuilder, add_ground
from edge.tasks.write import write_trajectory

pytest.importorskip("onnxruntime")

GREEN, BLUE, DARK = (20, 200, 20), (150, 190, 240), (10, 10, 10)


@pytest.fixture
def put(tmp_path, monkeypatch):
    """put(output, **changes): the network, and its card."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    return put_network


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("hw", [HW, (120, 200)])
def test_each_pixel_has_the_kind_of_its_class(put, output, hw):
    rgb = np.full((*hw, 3), 120, np.uint8)
    rgb[:, : hw[1] // 2], rgb[: hw[0] // 2] = GREEN, BLUE
    ground = GroundClassifier(put(output))
    assert ground.kinds == ("road", "sidewalk", "lawn")
    kind = ground.classify(rgb)
    assert kind.shape == hw
    assert not kind[: hw[0] // 2 - 2].any()
    below = kind[hw[0] // 2 + 2 :]
    assert (below[:, : hw[1] // 2 - 2] == 3).all()
    assert (below[:, hw[1] // 2 + 2 :] == 1).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"classes": ["road", "grass"], "ground": {"grass": "lawn"}}, "scores (1, 2, rows"),
        ({"ground": {"gras": "lawn"}}, "'gras' is not one of `classes`"),
        ({"ground": {}}, "ground: empty"),
        ({"input": {"height": 32, "width": 96}}, "must have one input"),
    ],
)
def test_an_unsuitable_card_is_an_error_of_one_line(put, changes, message):
    with pytest.raises(ModelError) as raised:
        GroundClassifier(put(**changes))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_tensorrt_by_itself_is_refused(put):
    settings = put().model_copy(update={"providers": ("tensorrt",)})
    with pytest.raises(ModelError, match=r"^tasks\.ground\.providers: .tensorrt. runs only"):
        GroundClassifier(settings)


def test_a_configuration_is_checked_before_it_runs(put):
    settings = config.Config.model_validate(
        {"perception": {"detector": {"kind": "sim"}}, "tasks": {"ground": put().model_dump()}}
    )
    (model,) = [m for m in named_models(settings) if m.key == "tasks.ground.model"]
    check_installed(load_card(model.name))
    (resources.models_dir() / "tiny-ground.onnx").unlink()
    with pytest.raises(ModelError, match=r"tiny-ground\.onnx: model tiny-ground is not there"):
        check_installed(load_card(model.name))


def scene_of(ground):
    """Return the scene of a street with grass on the left and a car on the right."""
    boxes = (scans.Box(12.0, -3.0, colour=DARK),)
    seen, _ = scans.street(boxes)
    is_ground = (seen.rgb == scans.GRAY).all(axis=2)
    is_ground[:, scans.MODEL.width_px // 2 :] = False
    seen = replace(seen, rgb=np.where(is_ground[..., None], np.uint8(GREEN), seen.rgb))
    pipeline = PerceptionPipeline(
        lambda observation: ("car",), lambda o, tags: scans.found_in(o, boxes), boxes_as_masks,
        ground=ground,
    )  # fmt: skip
    builder = SceneBuilder(pipeline)
    builder.add(seen)
    return builder.scene()


def test_ground_has_the_kind_that_the_picture_shows(put):
    scene = scene_of(GroundClassifier(put()))

    def kind_at(x_m, y_m):
        region = int(scene.regions_grid.cells[scene.regions_grid.cell_of(x_m, y_m)])
        return scene.regions[region].label if region else None

    assert (kind_at(10.0, 3.0), kind_at(9.0, -5.0)) == ("lawn", "road")
    assert kind_at(-10.0, 3.0) == "ground"  # behind the robot: no picture names its kind
    assert kind_at(10.4, -3.0) is None  # the car
    written = write_trajectory("go onto the grass", scene, config.TasksConfig())
    assert kind_at(*written.coarse.points_m[-1][:2]) == "lawn"


def test_old_votes_for_ground_are_replaced(put, monkeypatch):
    ground = GroundClassifier(put())
    seen, _ = scans.street(())
    green = replace(seen, rgb=np.full_like(seen.rgb, GREEN))
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    behind = replace(green, T_base_camera=turn @ seen.T_base_camera)
    votes, grid = GroundVotes(ground.kinds), RollingMap(OUTDOORS)
    grid.update_cloud(seen.cloud_m, seen.T_map_base, seen.T_base_lidar)

    def kinds_at(*places_m):
        kind = votes.classify(uninflated(grid, seen.pose), seen.pose)
        return [kind[uninflated(grid, seen.pose).cell_of(*xy_m)] for xy_m in places_m]

    add_ground(votes, ground, green, OUTDOORS)
    assert kinds_at((10.0, 0.0), (-10.0, 0.0)) == [3, 0]
    add_ground(votes, ground, behind, OUTDOORS)
    assert kinds_at((10.0, 0.0), (-10.0, 0.0)) == [3, 3]
    monkeypatch.setattr(ground_votes, "MOST_VOTES", 500)
    add_ground(votes, ground, behind, OUTDOORS)
    assert kinds_at((10.0, 0.0))[0] == 0
    assert votes.classify(uninflated(grid, seen.pose), seen.pose).any()


def test_without_a_network_no_kind_is_guessed():
    assert {region.label for region in scene_of(None).regions.values()} == {"ground"}
