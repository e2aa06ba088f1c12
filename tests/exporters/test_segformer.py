"""SegFormer from a Hugging Face folder: the service names the ground that `transformers` finds."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed (extra `transformers`)")
pytest.importorskip("transformers", reason="transformers is not installed (extra `transformers`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")
pytest.importorskip("onnxscript", reason="onnxscript is not installed (extra `transformers`)")

import cv2
import onnx
import tiny_folders
import torch
from transformers import SegformerConfig, SegformerForSemanticSegmentation

from edge.config import OnnxModel
from edge.host import resources
from edge.models.check import check_model
from edge.perception.masks.ground import GroundClassifier
from edge.perception.runtime.card_types import CITYSCAPES
from edge.perception.runtime.cards import load_card
from exporters.__main__ import main
from exporters.images import read_rgb
from exporters.onnx_format import cpu_session, export_module
from exporters.segformer import Scores

pytestmark = [pytest.mark.export, pytest.mark.timeout(600)]

PRECISIONS = ("fp32", "fp16", "int8-cpu")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    torch.set_num_threads(1)  # more would only wait for each other
    return tiny_folders.write_segformer(tmp_path_factory.mktemp("published") / "b0", CITYSCAPES)


@pytest.fixture(scope="module")
def exported(folder, photos, tmp_path_factory):
    """Return the `$EDGE_CACHE_DIR` after an export in all precisions, each within its limits."""
    root = tmp_path_factory.mktemp("cache")
    words = ["my-ground", "--weights", folder, "--cache", root / "models"]
    words += ["--precision", *PRECISIONS, "--calibration", photos, "--validation", photos]
    assert main([*map(str, words)]) == 0
    return root


@pytest.fixture
def models(exported, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(exported))
    return resources.models_dir()


def original(folder, rgb):
    """Return the class of each pixel of the scores (16, 16), by `transformers`."""
    model = SegformerForSemanticSegmentation.from_pretrained(folder).eval()
    pixels = cv2.resize(rgb, (64, 64)) / 255.0
    pixels = (pixels - [0.5, 0.4, 0.3]) / [0.3, 0.4, 0.5]
    with torch.inference_mode():
        image = torch.from_numpy(pixels.transpose(2, 0, 1)[None]).float()
        return model(pixel_values=image).logits[0].numpy().argmax(axis=0)


def test_the_service_names_the_ground_that_transformers_finds(models, folder, photos):
    classifier = GroundClassifier(OnnxModel(model="my-ground-fp32"))
    assert classifier.kinds == ("road", "sidewalk", "lawn")
    kind_of = np.zeros(len(CITYSCAPES), np.uint8)
    kind_of[[CITYSCAPES.index(name) for name in ("road", "sidewalk", "terrain")]] = 1, 2, 3
    n_ground = 0
    for path in sorted(photos.iterdir()):
        rgb = read_rgb(path)
        wanted = kind_of[original(folder, rgb)]
        wanted = cv2.resize(wanted, rgb.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        np.testing.assert_array_equal(classifier.classify(rgb), wanted)
        n_ground += np.count_nonzero(wanted)
    assert n_ground


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_precision_is_a_sound_model(models, precision):
    card = load_card(f"my-ground-{precision}")
    assert (card.license, card.input.width, card.classes) == ("mit", 64, CITYSCAPES)
    assert card.derived_from == (None if precision == "fp32" else "my-ground-fp32")
    check_model(card)
    model = onnx.load(models / card.file)
    assert model.ir_version <= 10
    assert max(one.version for one in model.opset_import) <= 20
    types = {one.data_type for one in model.graph.initializer}
    expected = {"fp16": onnx.TensorProto.FLOAT16, "int8-cpu": onnx.TensorProto.INT8}
    assert expected.get(precision, onnx.TensorProto.FLOAT) in types


def test_other_classes_are_kinds_of_ground_by_their_names(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    labels = ("wall", "grass", "path", "Road")
    other = tiny_folders.write_segformer(tmp_path / "other", labels)
    words = ["other", "--weights", other, "--cache", tmp_path / "models", "--license", "MIT"]
    assert main([*map(str, words)]) == 0
    card = load_card("other-fp32")
    assert (card.classes, card.license) == (labels, "MIT")
    assert card.ground == {"grass": "lawn", "path": "path", "Road": "road"}


def test_an_impossible_export_is_refused_in_one_line(folder, tmp_path, capsys):
    nothing = shutil.copytree(folder, tmp_path / "nothing")
    settings = json.loads((nothing / "config.json").read_text())
    settings["id2label"] = dict.fromkeys(settings["id2label"], "cat")
    (nothing / "config.json").write_text(json.dumps(settings))
    for weights, precision, says in (
        (folder, "q4", "no precision 'q4' for SegFormer (choices: fp32"),
        (folder, "fp16", "--calibration"),
        (nothing, "fp32", "config.json: id2label: no class is a kind of ground (choices: road"),
    ):
        words = ["x", "--weights", weights, "--precision", precision, "--cache", tmp_path / "cache"]
        assert main([*map(str, words)]) == 1
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert says in line


@pytest.mark.slow
def test_the_published_architecture(tmp_path):
    """SegFormer-B0 in its real width and depth, on a smaller image."""
    torch.manual_seed(0)
    config = SegformerConfig(num_labels=len(CITYSCAPES))  # the defaults are those of B0
    network = Scores(SegformerForSemanticSegmentation(config)).eval().requires_grad_(False)
    pixels = torch.randn(1, 3, 128, 256)
    export_module(network, tmp_path / "b0.onnx", {"pixels": pixels}, ("scores",), {})
    (found,) = cpu_session(tmp_path / "b0.onnx").run(None, {"pixels": pixels.numpy()})
    assert found.shape == (1, 19, 32, 64)
    np.testing.assert_allclose(found, network(pixels).numpy(), atol=1e-4)
