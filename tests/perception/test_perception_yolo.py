"""The real YOLO-World on real pictures; skips where the model was not exported."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from edge import config
from edge.perception.embedding.text import PromptError, find_vocabulary
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import ModelError, load_card, verify_model

pytestmark = pytest.mark.weights

MODELS = ("yolo-world-s-256x320-fp32", "yolo-world-s-256x320-int8-cpu")
PROMPTS = ("chair", "bed", "refrigerator", "toilet", "trash can")
CHAIR = np.array([335, 107, 612, 384])  # in the first picture, by eye


@pytest.fixture(params=MODELS)
def detector(request, shared_dir):
    pytest.importorskip("onnxruntime")
    try:
        verify_model(load_card(request.param))
    except ModelError as error:
        pytest.skip(str(error))
    try:
        vocabulary = find_vocabulary(None)
    except PromptError:
        vocabulary = shared_dir / "models" / "clip_vitb32_vocab.npz"
    if not vocabulary.exists():
        pytest.skip(f"not there: {vocabulary.name}")
    made = config.DetectorOnnx(model=request.param, vocabulary=str(vocabulary))
    detector = make_detector(config.PerceptionConfig(detector=made), PROMPTS)
    yield detector
    detector.close()


def picture(shared_dir, i):
    path = shared_dir / "logs" / "redwood_rgbd" / "color" / f"{i:05d}.jpg"
    if not path.exists():
        pytest.skip(f"not there: {path.name}")
    return np.ascontiguousarray(cv2.imread(str(path))[:, :, ::-1])


def test_the_chair_is_the_only_strong_detection(detector, shared_dir, make_observation):
    for i in range(5):
        found = detector.detect(make_observation(seq=i, rgb=picture(shared_dir, i)))
        assert found.prompts[found.class_id[0]] == "chair"
        assert found.score[0] > 0.5
        others = found.score[found.class_id != 0]
        assert len(others) == 0 or others.max() < 0.3
        if i == 0:
            np.testing.assert_allclose(found.xyxy_px[0], CHAIR, atol=15)


def test_large_and_small_images_give_the_same_box(detector, shared_dir, make_observation):
    large = picture(shared_dir, 0)
    small = cv2.resize(large, (320, 240), interpolation=cv2.INTER_AREA)
    a = detector.detect(make_observation(rgb=large))
    b = detector.detect(make_observation(rgb=small))
    np.testing.assert_allclose(a.xyxy_px[0], 2 * b.xyxy_px[0], atol=3)
    assert a.score[0] == pytest.approx(b.score[0], abs=0.05)
