"""Kinds of ground by a network that names the class of each pixel, run by onnxruntime.

The network classifies by colour: green is terrain, blue is sky, dark is a car, all else is road.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import scans
import yaml

from edge import config
from edge.cli.preflight import named_models
from edge.host import resources
from edge.perception.masks.ground import GroundClassifier
from edge.perception.runtime.card_types import CITYSCAPES
from edge.perception.runtime.cards import ModelError, check_installed, load_card
from edge.tasks.pipeline import PerceptionPipeline, boxes_as_masks
from edge.tasks.scene_builder import SceneBuilder
from edge.tasks.write import write_trajectory

pytest.importorskip("onnxruntime")
parser = pytest.importorskip("onnx.parser")

GREEN, BLUE, DARK = (20, 200, 20), (150, 190, 240), (10, 10, 10)
ROWS = {"road": (0, 0, 0, 0.4), "terrain": (-1, 2, -1, 0), "sky": (-2, 0, 2, 0.3),
        "car": (-9, -9, -9, 2)}  # fmt: skip
"""Class → its score's factors of red, green and blue, and its bias."""
HW = 64, 96
OUTPUTS = {
    "scores": ("float[1,19,r,c] y", "y = Conv (x, w, b)"),
    "best class": ("int64[1,r,c] y", "s = Conv (x, w, b) y = ArgMax<axis = 1, keepdims = 0> (s)"),
}
HEADER = '<ir_version: 8, opset_import: ["": 17]>'


def onnx_of(declared, made):
    rows = [ROWS.get(name, (0, 0, 0, -99)) for name in CITYSCAPES]
    w = ", ".join(str(float(value)) for row in rows for value in row[:3])
    b = ", ".join(str(float(row[3])) for row in rows)
    text = f"""{HEADER} g (float[1,3,{HW[0]},{HW[1]}] x) => ({declared}) {{
      w = Constant<value = float[19,3,1,1] {{{w}}}> ()
      b = Constant<value = float[19] {{{b}}}> () {made} }}"""
    return parser.parse_model(text).SerializeToString()


@pytest.fixture
def put(tmp_path, monkeypatch):
    """put(output, **changes): the network, and its card."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True, exist_ok=True)

    def write(output="scores", **changes):
        content = onnx_of(*OUTPUTS[output])
        (resources.models_dir() / "tiny.onnx").write_bytes(content)
        card = {
            "name": "tiny-ground", "task": "ground", "family": "tiny", "file": "tiny.onnx",
            "sha256": hashlib.sha256(content).hexdigest(), "sources": [], "license": "MIT",
            "precision": "fp32", "derived_from": None, "parity": None,
            "input": {"height": HW[0], "width": HW[1]},
            "preprocess": {"color": "rgb", "scale": 1 / 255, "mean": [0] * 3, "std": [1] * 3,
                           "fit": "stretch"},
        }  # fmt: skip
        path = resources.models_dir() / "tiny-ground.yaml"
        path.write_text(yaml.safe_dump(card | changes))
        return config.GroundModel(model="tiny-ground")

    return write


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
def test_a_card_that_does_not_fit_is_one_line(put, changes, message):
    with pytest.raises(ModelError) as raised:
        GroundClassifier(put(**changes))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_configuration_is_checked_before_it_runs(put):
    settings = config.Config.model_validate(
        {"perception": {"detector": {"kind": "sim"}}, "tasks": {"ground": put().model_dump()}}
    )
    (model,) = [m for m in named_models(settings) if m.key == "tasks.ground.model"]
    check_installed(load_card(model.name))
    (resources.models_dir() / "tiny.onnx").unlink()
    with pytest.raises(ModelError, match=r"tiny\.onnx: model tiny-ground is not there"):
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


def test_without_a_network_no_kind_is_guessed():
    assert {region.label for region in scene_of(None).regions.values()} == {"ground"}
