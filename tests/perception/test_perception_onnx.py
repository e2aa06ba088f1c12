"""The detector with a small ONNX model made here; the real one in test_perception_yolo.py."""

from __future__ import annotations

import hashlib
import logging
import os

import numpy as np
import pytest
import yaml
from onnx_text import tiny_detector
from test_perception_cards import CARD, flip_a_byte

from edge import config
from edge.host import resources
from edge.models.check import check_model
from edge.perception.embedding.text import PromptError, TextEmbeddings
from edge.perception.factory import make_detector
from edge.perception.runtime import model_file
from edge.perception.runtime.cards import ModelError, load_detector_card
from edge.perception.runtime.health import WHY_INVALID
from edge.perception.runtime.model_file import TRUST_CACHE

pytest.importorskip("onnxruntime")

# Two places; the first looks like words 0 and 1 (chair, sofa), the second like word 2.
BOXES = np.array([[[8, 8, 40, 40], [9, 9, 41, 41], [44, 44, 60, 60]]], np.float32)
LOGITS = np.full((3, 512), -9.0, np.float32)
LOGITS[0, 0], LOGITS[1, 0], LOGITS[0, 1], LOGITS[2, 2] = 1.0, 0.5, 0.0, 2.0


@pytest.fixture
def tiny(tmp_path, monkeypatch, vocabulary):
    """make(**kw): a detector on the small model; `boxes`, `dim`, `names` are of the model."""
    folder = tmp_path / "cards"
    folder.mkdir()
    monkeypatch.setattr(resources, "data_dir", lambda kind: folder)
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    resources.models_dir().mkdir(parents=True)
    path = resources.models_dir() / "tiny.onnx"

    def make(
        prompts=("chair", "sofa"),
        boxes=BOXES,
        dim=512,
        names=("images", "txt_feats"),
        card=None,
        **settings,
    ):
        path.write_bytes(tiny_detector(boxes, LOGITS[:, :dim], names=names))
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        data = {**CARD, "sha256": digest, **(card or {})}
        (folder / "tiny.yaml").write_text(yaml.safe_dump(data))
        detector = config.DetectorOnnx(
            model="tiny", vocabulary=str(vocabulary), threads=1, **settings
        )
        return make_detector(config.PerceptionConfig(detector=detector), prompts)

    return make


def test_a_damaged_model_is_noticed_despite_its_timestamp(tiny):
    detector = tiny()
    settings = config.PerceptionConfig(detector=detector.config)
    path = detector.card.path
    flip_a_byte(path, path.read_bytes().index(BOXES.tobytes()) + 1)
    with pytest.raises(ModelError, match=r"tiny\.onnx: damaged or another model"):
        make_detector(settings, ("chair",))


def test_a_trusted_cache_skips_the_hash(tiny, monkeypatch):
    monkeypatch.setenv(TRUST_CACHE, "1")
    detector = tiny()
    path = detector.card.path
    monkeypatch.setattr(model_file, "sha256_of", lambda path: pytest.fail("hashed again"))
    assert (
        make_detector(config.PerceptionConfig(detector=detector.config), ("chair",)).name == "tiny"
    )
    os.utime(path, ns=(1, 1))
    with pytest.raises(BaseException, match="hashed again"):
        make_detector(config.PerceptionConfig(detector=detector.config), ("chair",))


def image(h=64, w=64):
    return np.zeros((h, w, 3), np.uint8)


def test_boxes_scores_and_classes(tiny, make_observation):
    detector = tiny(prompts=("sofa", "chair", "trash can"))
    seen = make_observation(rgb=image())
    found = detector.detect(seen)
    assert found.observation is seen
    assert found.model == detector.name == "tiny"
    assert found.prompts == detector.prompts == ("sofa", "chair", "trash can")
    assert found.latency_ns > 0
    assert [found.prompts[c] for c in found.class_id] == ["trash can", "chair", "sofa"]
    best = [1 / (1 + np.exp(-2)), 1 / (1 + np.exp(-1))]
    np.testing.assert_allclose(found.score[:2], best, rtol=1e-5)
    np.testing.assert_allclose(found.xyxy_px, [[44, 44, 60, 60], [8, 8, 40, 40], [8, 8, 40, 40]])


def test_prompts_change_at_run_time(tiny, make_observation):
    detector = tiny(prompts=("bed",))
    seen = make_observation(rgb=image())
    assert len(detector.detect(seen)) == 0
    detector.set_prompts(["trash bin", "chair"])
    assert len(detector.detect(seen)) == 2
    with pytest.raises(PromptError):
        detector.set_prompts([])
    assert detector.prompts == ("trash bin", "chair")


def test_a_background_that_fits_better_is_a_boxs_competing_class(tiny, make_observation):
    seen = make_observation(rgb=image())
    alone = tiny(prompts=("sofa",)).detect(seen)
    assert alone.not_suppressed().tolist() == [True]
    assert alone.competing_score.tolist() == [0.0]
    found = tiny(prompts=("sofa",), background=("chair",)).detect(seen)
    assert found.prompts == ("sofa",)
    assert list(found.class_id) == [0]
    assert found.competing_score[0] > found.score[0]
    assert found.not_suppressed().tolist() == [False]


def test_each_target_has_its_box_and_competing_scores(tiny, make_observation):
    """A chair that also resembles a sofa is detected as both: the tracker weighs many images."""
    seen = make_observation(rgb=image())
    found = tiny(prompts=("sofa", "chair")).detect(seen)
    assert [found.prompts[k] for k in found.class_id] == ["chair", "sofa"]
    assert found.competing_score.tolist() == pytest.approx(found.score[::-1].tolist())
    assert found.not_suppressed().tolist() == [True, False]
    found = tiny(prompts=("easy chair", "chair")).detect(seen)
    assert found.competing_score.max() == 0.0


@pytest.mark.parametrize(("background", "kept"), [((), [True, True]), (("chair",), [True, False])])
def test_independent_prompts_compete_only_if_they_are_background(
    tiny, make_observation, background, kept
):
    detector = tiny(background=background)
    detector.set_prompts(["sofa", "chair"], independent=True)
    found = detector.detect(make_observation(rgb=image()))
    assert [found.prompts[k] for k in found.class_id] == ["chair", "sofa"]
    assert found.not_suppressed().tolist() == kept


def test_an_unknown_background_word_is_reported_once(tiny, caplog):
    detector = tiny(prompts=("sofa",), background=("zebra", "chair", "heron", "couch"))
    detector.set_prompts(["desk"])
    assert detector._prompt_set.classes.n_classes == 3
    assert [r.message for r in caplog.records] == [
        "model tiny: perception.detector.background: words that the model does not know are "
        "ignored: "
        "'zebra', 'heron'"
    ]
    with pytest.raises(PromptError, match="zebra"):
        detector.set_prompts(["zebra"])
    assert detector.prompts == ("desk",)


@pytest.mark.parametrize(
    "rgb",
    [
        None,
        np.zeros((0, 64, 3), np.uint8),
        np.zeros((64, 64), np.uint8),
        np.zeros((64, 64, 4), np.uint8),
        np.zeros((64, 64, 3), np.float32),
    ],
    ids=["none", "empty", "grey", "rgba", "float"],
)
def test_a_bad_image_is_an_error_of_one_line(tiny, make_observation, rgb):
    detector = tiny()
    with pytest.raises(ValueError, match=r"observation 0: .*image") as error:
        detector.detect(make_observation(rgb=rgb))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30, -1e6])
def test_invalid_boxes_are_dropped_and_counted(tiny, make_observation, caplog, value):
    boxes = BOXES.copy()
    boxes[0, 2] = value
    detector = tiny(prompts=("chair", "trash can"), boxes=boxes)
    with caplog.at_level(logging.ERROR):
        for _ in range(3):
            found = detector.detect(make_observation(rgb=image()))
    assert list(found.class_id) == [0]
    assert detector.invalid_boxes == 3
    assert [r.message for r in caplog.records] == [
        f"model tiny: 1 of 3 boxes are {WHY_INVALID}: dropped (further ones are only counted)"
    ]
    with pytest.raises(ModelError, match=f"model tiny: 1 boxes are {WHY_INVALID}"):
        detector.best_scores(image())
    with pytest.raises(ModelError, match=r"tiny\.onnx: (1 of 3 boxes|returns boxes) .*not finite"):
        check_model(detector.card)


def test_an_unknown_provider_lists_the_available_ones(tiny):
    with pytest.raises(ModelError, match=r"'NoSuchProvider' is not available .*CPUExecution"):
        tiny(providers=("NoSuchProvider",))


@pytest.mark.parametrize(
    "model", [{"dim": 256}, {"names": ("image", "txt_feats")}], ids=["length", "name"]
)
def test_a_model_with_another_interface_is_refused(tiny, model):
    with pytest.raises(ModelError, match=r"tiny\.onnx: inputs .*export the model again"):
        tiny(**model)


def test_boxes_of_another_rank_are_refused(tiny):
    with pytest.raises(
        ModelError, match=r"tiny\.onnx: boxes have the shape \(4,\) .*export the model again"
    ):
        tiny(boxes=np.zeros(4, np.float32))


def test_a_failed_encoding_keeps_the_old_prompts(tiny, monkeypatch, make_observation):
    detector = tiny(prompts=("sofa",))

    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(TextEmbeddings, "embed", fail)
    with pytest.raises(ModelError, match=r"^model tiny: .* the prompts: MemoryError$"):
        detector.set_prompts(["chair"])
    assert detector.detect(make_observation(rgb=image())).prompts == ("sofa",)


def test_an_invalid_model_file_is_refused(tiny, tmp_path):
    path = tmp_path / "cache" / "models" / "tiny.onnx"
    tiny()
    path.write_bytes(b"not onnx")
    digest = hashlib.sha256(b"not onnx").hexdigest()
    (tmp_path / "cards" / "tiny.yaml").write_text(yaml.safe_dump({**CARD, "sha256": digest}))
    with pytest.raises(ModelError, match=r"tiny\.onnx: not an ONNX model"):
        check_model(load_detector_card("tiny"))


def test_contrasts_are_asked_for_next_to_the_prompts(tiny, monkeypatch, make_observation):
    detector = tiny(prompts=("chair",))
    seen = make_observation(rgb=image())
    assert detector.detect(seen).competing_score.tolist() == [0.0]
    monkeypatch.setattr(TextEmbeddings, "contrasts", lambda *_, **__: ["red chair"])
    detector.set_prompts(("chair",))
    found = detector.detect(seen)
    assert found.prompts == ("chair",)
    np.testing.assert_allclose(found.competing_score, found.score)


def test_an_object_has_the_best_score_of_its_names(tiny, monkeypatch, make_observation):
    seen = make_observation(rgb=image())
    alone = tiny(prompts=("bed", "trash can"))
    assert [alone.prompts[k] for k in alone.detect(seen).class_id] == ["trash can"]
    names = {"bed": ["chair"]}
    monkeypatch.setattr(TextEmbeddings, "synonyms", lambda _, prompt: names.get(prompt, []))
    alone.set_prompts(("bed", "trash can"))
    found = alone.detect(seen)
    assert sorted(found.prompts[k] for k in found.class_id) == ["bed", "trash can"]
    chair = tiny(prompts=("chair",)).detect(seen)
    names.clear()
    assert found.score[list(found.class_id).index(0)] == chair.score[0]
    best = alone.best_scores(seen.rgb)
    assert best[0] == chair.score[0]


@pytest.mark.parametrize(
    ("prompts", "background", "words", "found"),
    [
        (("chair",), (), (), []),
        (("bed",), ("chair", "sofa"), ("chair", "sofa"), ["chair"]),  # the better has the place
        (("bed",), ("sofa", "couch"), ("sofa",), ["sofa"]),  # two names of one object
        (("chair",), ("sofa", "chair"), ("sofa",), ["sofa"]),
        (("chair",), ("armchair", "trash can"), ("trash can",), ["trash can"]),
    ],
)
def test_context_words_have_their_own_boxes(
    tiny, make_observation, prompts, background, words, found
):
    seen = make_observation(rgb=image())
    context = tiny(prompts=prompts, background=background).detect(seen).context
    assert context.words == words
    assert [words[k] for k in context.class_id] == found
    assert context.xyxy_px.shape == (len(found), 4)


def test_a_kind_of_one_target_still_competes_with_the_other(tiny, make_observation):
    found = tiny(prompts=("bed", "sofa"), background=("sofa bed", "chair")).detect(
        make_observation(rgb=image())
    )
    assert found.context.words == ("chair",)
    assert found.competing_score[0] > found.score[0]
