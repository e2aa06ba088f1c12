"""Image-text scorers: an encoder pair in miniature, and a detector's class scores."""

from __future__ import annotations

import numpy as np
import pytest
import tiny_clip

from edge.config import PerceptionConfig
from edge.errors import UserError
from edge.host import resources
from edge.perception.embedding.text import PromptError
from edge.perception.runtime.cards import ModelError, load_card
from edge.perception.scoring.similarity import (
    SENTENCE,
    make_similarity,
    max_score_per_prompt,
    similarity_card,
)
from edge.types import Detections


def detections(make_observation, scores, class_ids, prompts=("chair", "sofa", "bed")):
    return Detections(
        make_observation(),
        np.zeros((len(scores), 4), np.float32),
        np.array(scores, np.float32),
        np.array(class_ids, np.int32),
        prompts,
    )


@pytest.mark.parametrize(
    ("scores", "class_ids", "expected"),
    [
        ([], [], [0, 0, 0]),
        ([0.9], [1], [0, 0.9, 0]),
        ([0.9, 0.7, 0.3, 0.1], [2, 0, 2, 0], [0.7, 0, 0.9]),
    ],
)
def test_the_best_score_of_each_prompt(make_observation, scores, class_ids, expected):
    best = max_score_per_prompt(detections(make_observation, scores, class_ids))
    assert best.dtype == np.float32
    np.testing.assert_allclose(best, expected)


def write(cards, *data):
    for card in data:
        tiny_clip.write_card(cards, card)


def perception(similarity, **detector):
    kind = {"kind": "onnx", "threads": 1, **detector} if detector else {"kind": "sim"}
    return PerceptionConfig(similarity=similarity, detector=kind)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("by-nobody", r"'by-nobody': no such card \(choices: tiny-by-detector, tiny-clip-image\)"),
        ("tiny-clip-image", r"'tiny-clip-image': is a model of task 'image', not 'similarity'"),
    ],
)
def test_an_unknown_card_is_an_error_of_one_line(cards, name, expected):
    write(cards, tiny_clip.BY_DETECTOR, {**tiny_clip.IMAGE, "sha256": "0" * 64})
    with pytest.raises(ModelError, match=rf"^perception\.similarity: model {expected}$"):
        similarity_card(perception(name))


def test_a_missing_model_is_an_error_of_one_line(cards, vocabulary):
    write(cards, tiny_clip.BY_DETECTOR, tiny_clip.PAIR)
    for name in ("tiny-by-detector", "tiny-clip-similarity"):
        with pytest.raises(UserError, match="no such card") as raised:
            make_similarity(load_card(name), perception(name), ["chair"])
        assert "\n" not in str(raised.value)


# -- models -----------------------------------------------------------------------------------


@pytest.fixture
def pair(cards):
    """make(**perception): a scorer on the miniature of CLIP; its text file may be taken away."""
    for package in ("onnxruntime", "onnx", "tokenizers"):
        pytest.importorskip(package)
    models = resources.models_dir()
    tiny_clip.write_tokenizer(models / "tiny-tokenizer.json")
    tiny_clip.write_text_model(models / "tiny-text.onnx")
    tiny_clip.write_image_model(models / "tiny-image.onnx")
    tiny_clip.write_card(cards, tiny_clip.TEXT, models / "tiny-text.onnx")
    tiny_clip.write_card(cards, tiny_clip.IMAGE, models / "tiny-image.onnx")
    tiny_clip.write_card(cards, tiny_clip.PAIR)

    def make(prompts=("chair",), **detector):
        card = load_card("tiny-clip-similarity")
        return make_similarity(card, perception(card.name, **detector), prompts)

    return make


def red_image(level=255):
    rgb = np.zeros((40, 60, 3), np.uint8)
    rgb[..., 0] = level
    return rgb


def test_a_pair_gives_the_cosine_with_vlfms_sentence(pair):
    """A red image is "chair" to the tiny model, a black one "is"."""
    scorer = pair()
    assert scorer.name == "tiny-clip-similarity"
    assert SENTENCE == "Seems like there is a {} ahead."
    scores = scorer.score(red_image(), ["chair", "sofa"])
    assert scores.shape == (2,)
    assert scores.dtype == np.float32
    # "like there is a chair ahead" and the end count 1 each; "Seems" is unknown.
    np.testing.assert_allclose(scores, [7**-0.5, 0.0], atol=2e-3)
    np.testing.assert_allclose(scorer.score(red_image(0), ["is"]), [2 / 3], atol=1e-3)
    scorer.close()


def test_without_its_text_file_the_vocabulary_serves_a_pair(pair, tmp_path, monkeypatch):
    path = tmp_path / "words.npz"
    np.savez(path, names=np.array(["chair"]), emb=np.eye(1, tiny_clip.DIM, k=3))
    monkeypatch.setenv("EDGE_VOCABULARY", str(path))
    (resources.models_dir() / "tiny-text.onnx").unlink()
    np.testing.assert_allclose(pair().score(red_image(), ["chair"]), [1.0], atol=1e-3)
    with pytest.raises(PromptError, match="not in the vocabulary"):
        pair(prompts=("heron",))
    np.savez(path, names=np.array(["chair"]), emb=np.eye(1, 512))
    with pytest.raises(ModelError, match=r"embeddings of the image encoder have length 16, .* 512"):
        pair()


@pytest.fixture
def by_detector(cards, vocabulary):
    """make(logits): a scorer on a detector with these logits (2, 512)."""
    for package in ("onnxruntime", "onnx"):
        pytest.importorskip(package)

    def make(logits, prompts):
        path = resources.models_dir() / "tiny-detector.onnx"
        tiny_clip.write_detector(path, logits)
        tiny_clip.write_card(cards, tiny_clip.DETECTOR, path)
        write(cards, tiny_clip.BY_DETECTOR)
        card = load_card("tiny-by-detector")
        running = perception(card.name, model="another", vocabulary=str(vocabulary))
        return make_similarity(card, running, prompts)

    return make


def test_a_detectors_class_scores(by_detector):
    """In the vocabulary, chair is axis 0 and the trash can axis 2."""
    logits = np.full((2, 512), -9.0, np.float32)
    logits[0, 0], logits[1, 0], logits[1, 2] = 1.0, 0.5, 2.0
    scorer = by_detector(logits, ["chair", "trash can"])
    image = np.zeros((64, 64, 3), np.uint8)
    expected = 1 / (1 + np.exp([-1.0, -2.0]))
    np.testing.assert_allclose(scorer.score(image, ["chair", "trash can"]), expected, rtol=1e-5)
    np.testing.assert_allclose(scorer.score(image, ["trash can"]), expected[1:], rtol=1e-5)
    # However low it is: no threshold.
    np.testing.assert_allclose(scorer.score(image, ["bed"]), 1 / (1 + np.exp(9.0)), rtol=1e-3)
    scorer.close()
    with pytest.raises(PromptError, match="heron"):
        by_detector(logits, ["heron"])


def test_scores_that_are_not_finite_are_an_error(by_detector):
    scorer = by_detector(np.full((2, 512), np.nan, np.float32), ["chair"])
    with pytest.raises(
        ModelError, match=r"model tiny-detector: 2 boxes are not finite, .* outside 0 to 1"
    ):
        scorer.score(np.zeros((64, 64, 3), np.uint8), ["chair"])
