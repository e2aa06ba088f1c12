"""Directions by a small network: its inputs from a view, and the choice from its logits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from live_patience import PATIENCE_S, eventually
from simulated import simulated

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from edge.config import ChoiceOnnx, PerceptionConfig
from edge.perception.embedding.text import PromptError
from edge.perception.runtime.card_types import MARK_FIELDS
from edge.perception.runtime.letterbox import letterboxed
from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.choice import mark_scorer
from edge.perception.scoring.choice.factory import make_view_scorer, open_view_scorer
from edge.perception.scoring.choice.mark_scorer import MarkNetwork, MarkScorer
from edge.perception.scoring.choice.process import ProcessMarks
from edge.perception.scoring.choice.question import MAX_MARKS, Mark, MarkCosts, MarkedView
from edge.types import Observation

NAME = "mini-house-choice"
HW = (256, 320)


def mark(id_: int, u_px: float, v_px: float = 128.0, bearing_rad: float = 0.0, away_m: float = 2.0):
    return Mark(id_, u_px, v_px, bearing_rad, away_m)


def ways(*marks: Mark) -> MarkCosts:
    """Twice as far as straight on, a square metre at the end of each, and two others."""
    path_m = np.array([2.0 * mark.distance_m for mark in marks], np.float32)
    return MarkCosts(path_m, np.ones_like(path_m), np.array([2.0, 5.0, 9.0], np.float32))


def view(*marks: Mark, rgb: np.ndarray | None = None, target: str = "bed") -> MarkedView:
    image = np.full((*HW, 3), 90, np.uint8) if rgb is None else rgb
    seen = Observation(1, 7, np.eye(4), rgb=image)
    return MarkedView(seen, target, tuple(marks), mark_costs=ways(*marks))


# -- inputs of the network ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((512, 640), (0.5, 0, 0)),
        ((480, 640), (0.5, 8, 0)),
        ((128, 80), (2.0, 0, 80)),
        ((1, 1000), (0.32, 127, 0)),
    ],
)
def test_others_are_scaled_to_fit_on_grey(shape, expected):
    image, fit = letterboxed(np.zeros((*shape, 3), np.uint8), HW, 114)
    _, scale, hw, top, left = fit
    assert image.shape == (*HW, 3)
    assert (scale, top, left) == pytest.approx(expected)
    inner = image[top : top + hw[0], left:]
    assert (image[:top] == 114).all()
    assert (image[:, :left] == 114).all()
    assert (inner[0, 0] == 0).all()


# -- choices from its logits ----------------------------------------------------------------------


class FakeSession:
    """Answers with given probabilities."""

    def __init__(self, directions, scene=0.0) -> None:
        self.directions, self.scene, self.feeds = directions, scene, []

    def run(self, names, feed, options):
        self.feeds.append(feed)
        if len(self.feeds) == 1:  # at the start it is asked once
            return [np.zeros((1, MAX_MARKS + 1), np.float32), np.zeros((1, 1), np.float32)]
        if isinstance(self.directions, Exception):
            raise self.directions
        return [np.array([self.directions], np.float32), np.array([[self.scene]], np.float32)]


class FakeText:
    """One row for each target; does not know unicorns."""

    dim = 64

    def embed(self, prompts):
        if "unicorn" in prompts:
            raise PromptError("prompt: no unicorns")
        return np.ones((1, len(prompts), self.dim), np.float32)


def scorer_of(monkeypatch, session, dim: int = 64) -> MarkScorer:
    how = SimpleNamespace(scale=1 / 255, letterbox_pad=114, letterbox_at="centre")
    card = SimpleNamespace(
        name="fake", text_dim=dim, text_encoder="text", preprocess=how, precision="fp32",
        input=SimpleNamespace(height=HW[0], width=HW[1]),
    )  # fmt: skip
    monkeypatch.setattr(mark_scorer, "verify_model", lambda card, believe_cache: None)
    monkeypatch.setattr(mark_scorer, "open_onnxruntime_session", lambda *_: session)
    network = MarkNetwork(card, FakeText(), ("CPUExecutionProvider",), 1)
    return MarkScorer(card, network, PATIENCE_S)


def test_without_marks_there_is_nothing_to_choose(monkeypatch):
    session = FakeSession([0.0] * (MAX_MARKS + 1))
    scorer = scorer_of(monkeypatch, session)
    assert scorer.answer(scorer.prepare(view())) is None
    assert len(session.feeds) == 1


def test_softmax_covers_present_marks_and_elsewhere(monkeypatch):
    logits = [np.log(2.0), 0.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, np.log(5.0)]
    session = FakeSession(logits, np.log(3.0))
    scorer = scorer_of(monkeypatch, session)
    choice = scorer.answer(scorer.prepare(view(mark(4, 10.0), mark(9, 200.0))))
    assert (choice.ids, choice.target, choice.stamp_ns) == ((4, 9), "bed", 7)
    np.testing.assert_allclose(choice.p, [0.25, 0.125], rtol=1e-6)
    assert choice.elsewhere == pytest.approx(0.625)
    assert choice.scene == pytest.approx(0.75)
    np.testing.assert_allclose(choice.value, 0.75 * choice.p)
    marks = session.feeds[-1]["marks"]
    assert marks.shape == (1, MAX_MARKS, MARK_FIELDS)
    assert marks[0, :2, -1].all()
    assert not marks[0, 2:].any()
    np.testing.assert_array_equal(session.feeds[-1]["others"], [[2.0, 5.0, 9.0]])


@pytest.mark.parametrize(
    ("session", "says"),
    [
        (FakeSession([np.nan] * 9), "not finite"),
        (FakeSession([0.0] * 9, np.inf), "not finite"),
        (FakeSession(RuntimeError("out of memory")), "out of memory"),
    ],
)
def test_unusable_outputs_are_an_error_of_one_line(monkeypatch, session, says):
    scorer = scorer_of(monkeypatch, session)
    with pytest.raises(ModelError, match=says) as error:
        scorer.answer(scorer.prepare(view(mark(1, 1.0))))
    assert "fake" in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_inputs_and_unknown_targets_are_errors(monkeypatch):
    scorer = scorer_of(monkeypatch, FakeSession([0.0] * 9))
    image = np.zeros((*HW, 3), np.uint8)
    for rgb, says in ((None, "observation 3 has no camera image"), (image, "there is no map yet")):
        blind = MarkedView(Observation(3, 7, np.eye(4), rgb=rgb), "bed", (mark(1, 1.0),))
        with pytest.raises(ModelError, match=says):
            scorer.prepare(blind)
    with pytest.raises(PromptError, match="unicorn"):
        scorer.answer(scorer.prepare(view(mark(1, 1.0), target="unicorn")))


def test_a_text_encoder_of_another_length_is_refused(monkeypatch):
    with pytest.raises(ModelError, match="length 512, but those of text have 64"):
        scorer_of(monkeypatch, FakeSession([0.0] * 9), dim=512)


@pytest.mark.parametrize(
    ("card", "says"),
    [
        ("no-such", r"perception\.choice\.card: model 'no-such': no such card"),
        ("mini-house-text", r"perception\.choice\.card: .*task 'text', not 'choice'"),
    ],
)
def test_an_unusable_card_is_named_with_its_key(card, says):
    with pytest.raises(ModelError, match=says):
        make_view_scorer(ChoiceOnnx(card=card), simulated().perception)


class Slow(FakeSession):
    """Runs until a command to end."""

    def run(self, names, feed, options):
        if self.feeds:
            eventually(lambda: options.terminate)
            raise RuntimeError("terminated")
        return super().run(names, feed, options)


def test_a_closed_scorer_aborts_its_answers(monkeypatch):
    scorer = scorer_of(monkeypatch, Slow([0.0] * 9))
    scorer.close()
    with pytest.raises(ModelError, match="fake: aborted"):
        scorer.answer(scorer.prepare(view(mark(1, 1.0))))


# -- the one that is shipped ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def shipped() -> MarkScorer:
    return open_view_scorer(ChoiceOnnx(card=NAME, threads=1))


def test_an_image_smaller_than_the_networks_cannot_be_demanded():
    with pytest.raises(ModelError, match=r"max_image_px: 319, but mini-house-choice .* least 320"):
        open_view_scorer(ChoiceOnnx(card=NAME, max_image_px=319))
    open_view_scorer(ChoiceOnnx(card=NAME, max_image_px=320)).close()


def test_tensorrt_by_itself_is_refused():
    with pytest.raises(ModelError, match="'tensorrt' runs only detectors"):
        open_view_scorer(ChoiceOnnx(card=NAME, providers=("tensorrt",)))


def test_an_isolated_scorer_gives_the_same_answers(shipped):
    perception = PerceptionConfig.model_validate(
        {
            "isolation": "process",
            "process": {"timeout_s": PATIENCE_S, "start_timeout_s": PATIENCE_S},
            "detector": {"kind": "onnx"},
            "choice": {"kind": "onnx", "card": NAME, "threads": 1, "time_limit_s": PATIENCE_S},
        }
    )
    there = make_view_scorer(perception.choice, perception)
    assert isinstance(there._network, ProcessMarks)
    rgb = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)
    asked = view(mark(4, 10.0, bearing_rad=0.4), mark(9, 120.0, away_m=5.0), rgb=rgb)
    theirs, ours = (one.answer(one.prepare(asked)) for one in (there, shipped))
    np.testing.assert_array_equal(theirs.p, ours.p)
    assert (theirs.ids, theirs.scene) == (ours.ids, ours.scene)
    with pytest.raises(PromptError, match="unicorn"):
        there.answer(there.prepare(view(mark(1, 1.0), target="unicorn")))
    there.close()
    with pytest.raises(ModelError, match="its process"):
        there.answer(there.prepare(asked))


def test_mark_order_and_image_size_change_little(shipped):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (*HW, 3), np.uint8)
    marks = [
        mark(1, 20.0, 150.0, 0.6, 2.0), mark(2, 160.0, 140.0, 0.0, 5.0),
        mark(3, 300.0, 200.0, -0.6, 1.2),
    ]  # fmt: skip
    one = shipped.answer(shipped.prepare(view(*marks, rgb=rgb)))
    other = shipped.answer(shipped.prepare(view(*marks[::-1], rgb=rgb)))
    assert one.p.sum() + one.elsewhere == pytest.approx(1.0)
    np.testing.assert_allclose(one.p, other.p[::-1], atol=1e-5)
    doubled = [m._replace(u_px=2 * m.u_px + 0.5, v_px=2 * m.v_px + 0.5) for m in marks]
    large = rgb.repeat(2, axis=0).repeat(2, axis=1)
    scaled = shipped.answer(shipped.prepare(view(*doubled, rgb=large)))
    np.testing.assert_allclose(one.p, scaled.p, atol=1e-4)
    assert scaled.scene == pytest.approx(one.scene, abs=1e-4)


# -- TensorRT -------------------------------------------------------------------------------------


def test_int8_for_a_cpu_is_refused_for_tensorrt():
    config = ChoiceOnnx(card=NAME, providers=("TensorrtExecutionProvider",))
    with pytest.raises(ModelError, match="mini-house-choice: quantized for CPUs"):
        open_view_scorer(config)
