"""OWLv2 from a Hugging Face folder: the service finds what `transformers` finds."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed (extra `transformers`)")
pytest.importorskip("transformers", reason="transformers is not installed (extra `transformers`)")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")
pytest.importorskip("onnxscript", reason="onnxscript is not installed (extra `transformers`)")

import onnx
import tiny_folders
import torch
from transformers import Owlv2ForObjectDetection, PreTrainedTokenizerFast

from edge.config import DetectorOnnx
from edge.models.check import check_model
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.runtime.cards import load_card, made_parity
from edge.types import Observation
from exporters.__main__ import main
from exporters.images import read_rgb
from exporters.onnx_format import cpu_session
from exporters.owlv2 import Owlv2Detector, export_onnx

pytestmark = [pytest.mark.export, pytest.mark.timeout(600)]

WORDS = ("zebra", "flute", "igloo")  # without other names, so that each is one text
PRECISIONS = ("fp32", "fp16", "int8-cpu")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    torch.set_num_threads(1)  # more would only wait for each other
    return tiny_folders.write_owlv2(tmp_path_factory.mktemp("published") / "owlv2")


@pytest.fixture(scope="module")
def cache(folder, photos, tmp_path_factory):
    """Return the `$EDGE_CACHE_DIR` after an export in all precisions, each within its limits."""
    root = tmp_path_factory.mktemp("cache")
    words = ["my-owl", "--weights", folder, "--cache", root / "models", "--precision", *PRECISIONS]
    words += ["--calibration", photos, "--validation", photos]
    assert main([*map(str, words)]) == 0
    return root


@pytest.fixture(scope="module")
def rgb(photos):
    return read_rgb(sorted(photos.iterdir())[0])


def pixels_of(rgb, side):
    """Return an image as the model takes it: grey on the right and below, (1, 3, side, side)."""
    height, width = rgb.shape[:2]
    scale = side / max(height, width)
    size = round(width * scale), round(height * scale)
    square = np.full((side, side, 3), 128, np.uint8)
    square[: size[1], : size[0]] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    pixels = (square / 255.0 - [0.5, 0.4, 0.3]) / [0.3, 0.4, 0.5]
    return torch.from_numpy(pixels.transpose(2, 0, 1)[None]).float()


def original(folder, rgb, words):
    """Return boxes (a, 4) as shares of the square's side, and scores (a, n), of `transformers`."""
    model = Owlv2ForObjectDetection.from_pretrained(folder).eval()
    tokenizer = PreTrainedTokenizerFast(
        tokenizer_file=str(folder / "tokenizer.json"), pad_token=tiny_folders.PAD
    )
    texts = [f"a photo of a {word}" for word in words]
    tokens = tokenizer(texts, padding="max_length", max_length=32, return_tensors="pt")
    with torch.inference_mode():
        found = model(
            input_ids=tokens["input_ids"], attention_mask=tokens["attention_mask"],
            pixel_values=pixels_of(rgb, model.config.vision_config.image_size),
        )  # fmt: skip
    x, y, w, h = found.pred_boxes[0].numpy().T
    boxes = np.stack((x - w / 2, y - h / 2, x + w / 2, y + h / 2), axis=1)
    return boxes, found.logits[0].sigmoid().numpy()


def test_the_service_scores_and_places_boxes_as_transformers(models, folder, rgb):
    detector = OnnxDetector(DetectorOnnx(model="my-owl-fp32", tau_vl=0.05), WORDS)
    boxes, scores = original(folder, rgb, WORDS)
    np.testing.assert_allclose(detector.best_scores(rgb), scores.max(axis=0), atol=1e-5)
    found = detector.detect(Observation(1, 7, np.eye(4), rgb=rgb))
    for label in range(len(WORDS)):
        best = np.flatnonzero(found.class_id == label)[0]
        anchor = scores[:, label].argmax()
        assert found.score[best] == pytest.approx(scores[anchor, label], abs=1e-5)
        corners = boxes[anchor] * max(rgb.shape[:2])
        limits = (rgb.shape[1], rgb.shape[0]) * 2
        np.testing.assert_allclose(found.xyxy_px[best], np.clip(corners, 0, limits), atol=0.05)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_precision_is_sound_with_its_own_text_encoder(models, precision):
    card = load_card(f"my-owl-{precision}")
    assert (card.license, card.preprocess.letterbox_at, card.input.width) == ("mit", "corner", 48)
    parity = made_parity(card)
    assert parity.reference == "torch"
    assert parity.recall >= 0.95
    text = load_card(card.text_encoder)
    assert text.tokenizer.sentence == "a photo of a {}"
    assert made_parity(text).cosine > 0.99
    for one in (card, text):
        check_model(one)


def test_only_the_backbone_is_quantized(models):
    half = onnx.load(models / "my-owl-fp16.onnx")
    types = {i.name: i.data_type for i in half.graph.initializer}
    products = {n.name: n.input[1] for n in half.graph.node if n.op_type == "MatMul"}
    weights = {name: types[value] for name, value in products.items() if value in types}
    float16, float32 = onnx.TensorProto.FLOAT16, onnx.TensorProto.FLOAT
    assert weights["/box_head/dense0/MatMul"] == float16
    assert weights["/class_head/logit_shift/MatMul"] == float32
    small = onnx.load(models / "my-owl-int8-cpu.onnx")
    quantized = {n.name for n in small.graph.node if n.op_type == "QuantizeLinear"}
    assert quantized
    assert not any("head" in name for name in quantized)


def test_a_folder_that_needs_other_images_is_refused(folder, tmp_path, capsys):
    changed = shutil.copytree(folder, tmp_path / "changed")
    settings = json.loads((changed / "preprocessor_config.json").read_text())
    for change in ({"size": {"height": 64, "width": 64}}, {"rescale_factor": 1.0}):
        (changed / "preprocessor_config.json").write_text(json.dumps(settings | change))
        assert main(["x", "--weights", str(changed), "--cache", str(tmp_path / "cache")]) == 1
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "size and rescale_factor must be 48 px and 1/255" in line
    assert main(["x", "--weights", str(folder), "--precision", "q4"]) == 1
    assert "no precision 'q4' for OWLv2 (choices: fp32" in capsys.readouterr().err


@pytest.mark.slow
def test_the_published_architecture(tmp_path):
    """OWLv2 base with patches of 16 px in its real width and depth, on a smaller image."""
    from transformers import Owlv2Config

    torch.manual_seed(0)
    config = Owlv2Config(vision_config={"image_size": 192, "patch_size": 16})
    model = Owlv2ForObjectDetection._from_config(config, attn_implementation="eager")
    for head in (model.box_head, model.class_head):  # else all boxes and scores are saturated
        for parameter in head.parameters():
            torch.nn.init.normal_(parameter, std=0.02)
    detector = Owlv2Detector(model, [0.5] * 3, [0.25] * 3).eval().requires_grad_(False)
    export_onnx(detector, 512, tmp_path / "owl.onnx")
    rng = np.random.default_rng(0)
    images, text = rng.random((1, 3, 192, 192), np.float32), rng.random((1, 5, 512), np.float32)
    found = cpu_session(tmp_path / "owl.onnx").run(None, {"images": images, "txt_feats": text})
    with torch.inference_mode():
        wanted = detector(torch.from_numpy(images), torch.from_numpy(text))
    assert found[0].shape == (1, 144, 4)
    np.testing.assert_allclose(found[0], wanted[0].numpy(), atol=0.01)
    np.testing.assert_allclose(found[1], wanted[1].numpy(), atol=1e-4)
    assert np.ptp(found[1]) > 0.01
