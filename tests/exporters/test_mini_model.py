"""The small detector as it is shipped: its cards, and its detections in a new house."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from edge import config
from edge.lab.bench.boxes import overlaps
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.embedding.attributes import AttributeEncoder
from edge.perception.runtime.cards import load_card, load_detector_card, verify_model
from edge.types import Observation
from exporters.training.mini import looks, views
from exporters.training.mini.evaluate import FLOORS, MAX_BYTES, _does_count
from exporters.training.mini.houses import HELD_OUT

NAME = "mini-house-256x320-int8-cpu"


@pytest.fixture(scope="module")
def held_out():
    rgb = np.zeros((4, views.HEIGHT_PX, views.WIDTH_PX, 3), np.uint8)
    return rgb, views.render_house(HELD_OUT + 1, len(rgb), rgb)


def test_the_files_are_those_of_the_cards_and_small():
    assert verify_model(load_detector_card(NAME)).stat().st_size <= MAX_BYTES
    assert verify_model(load_card("mini-house-text")).stat().st_size < 200_000
    assert load_card("mini-house-similarity").detector == NAME


def test_the_card_holds_the_measured_figures():
    measured = load_detector_card(NAME).measured
    assert set(measured) >= {"training", "held-out houses"}
    assert measured["held-out houses"]["first_seed"] >= HELD_OUT
    assert measured["held-out houses"]["bytes"] == load_detector_card(NAME).path.stat().st_size


def test_the_shipped_model_passes_its_own_gate():
    figures = load_detector_card(NAME).measured["held-out houses"]
    assert {key: figures[key] >= floor for key, floor in FLOORS.items()} == dict.fromkeys(
        FLOORS, True
    )
    assert figures["bytes"] <= MAX_BYTES


def test_the_encoder_knows_the_worlds_categories_by_unit_rows():
    encoder = AttributeEncoder(load_card("mini-house-text"))
    assert encoder.vocabulary == looks.VOCABULARY
    rows = encoder.embed(["trash bin", "tall white trash can", "trash can"])
    assert rows.shape == (1, 3, encoder.dim)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=2), 1.0, rtol=1e-5)
    np.testing.assert_array_equal(rows[0, 0], rows[0, 2])
    assert rows[0, 0] @ rows[0, 1] < 0.999


def test_an_unknown_adjective_warns_once(caplog):
    encoder = AttributeEncoder(load_card("mini-house-text"))
    for _ in range(3):
        assert encoder.resolve("shiny red chair") == "red chair"
    assert [r.levelname for r in caplog.records] == ["WARNING"]
    assert "shiny" in caplog.text


def test_the_model_finds_most_clearly_visible_objects(held_out):
    rgb, found = held_out
    detector = OnnxDetector(config.DetectorOnnx(model=NAME, tau_vl=0.1), looks.CATEGORIES)
    seen = total = 0
    for picture, objects in zip(rgb, found, strict=True):
        detections = detector.detect(Observation(0, 0, np.eye(4), rgb=picture))
        plain = objects[_does_count(objects) & (objects["pixels"] > 400)]
        for obj in plain:
            mine = detections.xyxy_px[detections.class_id == obj["category"] - 1]
            seen += bool(len(mine) and overlaps(mine, obj["box"][None])[0].max() > 0.5)
            total += 1
    detector.close()
    assert total >= 8
    assert seen >= 0.7 * total
