"""Directions by a small network: what it gets of a view, and what is made of its logits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from edge.config import ChoiceOnnx
from edge.perception.card_types import MARK_FIELDS, MarksCard
from edge.perception.cards import load_card_of, verify_model
from edge.perception.choice import mark_scorer
from edge.perception.choice.factory import make_choice
from edge.perception.choice.mark_scorer import MarkScorer, as_input, letterboxed, open_mark_scorer
from edge.perception.choice.question import MAX_MARKS, Mark, View
from edge.perception.model_file import ModelError
from edge.perception.onnx_file import check_fixed
from edge.perception.text import PromptError
from edge.types import Observation

NAME = "mini-house-choice"
MAX_BYTES = 8_000_000
HW = (256, 320)


def mark(id_: int, u_px: float, v_px: float = 128.0, bearing_rad: float = 0.0, away_m: float = 2.0):
    return Mark(id_, u_px, v_px, bearing_rad, away_m)


def view(*marks: Mark, rgb: np.ndarray | None = None, target: str = "bed") -> View:
    image = np.full((*HW, 3), 90, np.uint8) if rgb is None else rgb
    return View(Observation(1, 7, np.eye(4), rgb=image), target, tuple(marks))


# -- what the network gets ------------------------------------------------------------------------


def test_an_image_of_the_networks_size_stays_as_it_is():
    rgb = np.arange(256 * 320 * 3, dtype=np.uint8).reshape(256, 320, 3)
    image, scale, top, left = letterboxed(rgb, HW, 114)
    np.testing.assert_array_equal(image, rgb)
    assert (scale, top, left) == (1.0, 0, 0)


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
    image, *placed = letterboxed(np.zeros((*shape, 3), np.uint8), HW, 114)
    assert image.shape == (*HW, 3)
    assert tuple(placed) == pytest.approx(expected)
    _, scale, top, left = image, *placed
    inner = image[top : top + max(1, round(shape[0] * scale)), left:]
    assert (image[:top] == 114).all()
    assert (image[:, :left] == 114).all()
    assert (inner[0, 0] == 0).all()


def test_without_marks_the_network_gets_zeros():
    assert not as_input((), 1.0, 0, 0, HW).any()


def test_marks_are_shares_of_the_letterboxed_image():
    found = as_input((mark(1, -0.5, 239.5, 0.3, 4.0), mark(2, 319.5, 0.0)), 0.5, 8, 0, HW)
    assert found.shape == (1, MAX_MARKS, MARK_FIELDS)
    np.testing.assert_allclose(found[0, 0], [0.0, 0.5, 0.3, 4.0, 1.0])
    np.testing.assert_allclose(found[0, 1, :2], [0.5, 8.25 / 256])
    assert not found[0, 2:].any()


# -- what is made of its logits -------------------------------------------------------------------


class FakeSession:
    """Says what it is told to say."""

    def __init__(self, directions, scene=0.0) -> None:
        self.directions, self.scene, self.feeds = directions, scene, []

    def run(self, names, feed):
        self.feeds.append(feed)
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
    how = SimpleNamespace(scale=1 / 255, letterbox_pad=114)
    card = SimpleNamespace(
        name="fake", precision="fp32", text_dim=dim, text_encoder="text", preprocess=how,
        input=SimpleNamespace(height=HW[0], width=HW[1]),
    )  # fmt: skip
    monkeypatch.setattr(mark_scorer, "verify_model", lambda card, believe_cache: None)
    monkeypatch.setattr(mark_scorer, "open_session", lambda *_: session)
    return MarkScorer(card, FakeText(), ("CPUExecutionProvider",), 1)


def test_without_marks_there_is_nothing_to_choose(monkeypatch):
    session = FakeSession([0.0] * (MAX_MARKS + 1))
    scorer = scorer_of(monkeypatch, session)
    assert scorer.answer(scorer.look(view())) is None
    assert not session.feeds


def test_softmax_is_over_the_marks_that_are_there_and_elsewhere(monkeypatch):
    logits = [np.log(2.0), 0.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, np.log(5.0)]
    session = FakeSession(logits, np.log(3.0))
    scorer = scorer_of(monkeypatch, session)
    choice = scorer.answer(scorer.look(view(mark(4, 10.0), mark(9, 200.0))))
    assert (choice.ids, choice.target, choice.stamp_ns) == ((4, 9), "bed", 7)
    np.testing.assert_allclose(choice.p, [0.25, 0.125], rtol=1e-6)
    assert choice.elsewhere == pytest.approx(0.625)
    assert choice.scene == pytest.approx(0.75)
    np.testing.assert_allclose(choice.value, 0.75 * choice.p)


def test_the_image_is_copied_when_it_is_looked_at(monkeypatch):
    scorer, rgb = scorer_of(monkeypatch, FakeSession([0.0] * 9)), np.zeros((*HW, 3), np.uint8)
    looked = scorer.look(view(mark(1, 1.0), rgb=rgb))
    rgb[:] = 255
    assert not looked.images.any()


@pytest.mark.parametrize(
    ("session", "says"),
    [
        (FakeSession([np.nan] * 9), "not finite"),
        (FakeSession([0.0] * 9, np.inf), "not finite"),
        (FakeSession(RuntimeError("out of memory")), "out of memory"),
    ],
)
def test_what_cannot_be_used_is_an_error_of_one_line(monkeypatch, session, says):
    scorer = scorer_of(monkeypatch, session)
    with pytest.raises(ModelError, match=says) as error:
        scorer.answer(scorer.look(view(mark(1, 1.0))))
    assert "fake" in str(error.value)
    assert "\n" not in str(error.value)


def test_without_an_image_and_for_an_unknown_target_it_says_so(monkeypatch):
    scorer = scorer_of(monkeypatch, FakeSession([0.0] * 9))
    blind = View(Observation(3, 7, np.eye(4)), "bed", (mark(1, 1.0),))
    with pytest.raises(ModelError, match="observation 3: no image"):
        scorer.look(blind)
    with pytest.raises(PromptError, match="unicorn"):
        scorer.answer(scorer.look(view(mark(1, 1.0), target="unicorn")))


def test_a_text_encoder_of_another_length_is_refused(monkeypatch):
    with pytest.raises(ModelError, match="length 512, those of text have 64"):
        scorer_of(monkeypatch, FakeSession([0.0] * 9), dim=512)


@pytest.mark.parametrize(
    ("card", "says"),
    [
        ("no-such", r"perception\.choice\.card: model 'no-such': no such card"),
        ("mini-house-text", r"perception\.choice\.card: .*task 'text', not 'choice'"),
    ],
)
def test_a_card_that_is_none_is_named_with_its_key(card, says):
    with pytest.raises(ModelError, match=says):
        make_choice(ChoiceOnnx(card=card), simulated().perception)


# -- the one that is shipped ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def shipped() -> MarkScorer:
    return open_mark_scorer(load_card_of(MarksCard, NAME), ChoiceOnnx(card=NAME, threads=1))


def test_the_file_is_that_of_the_card_and_small():
    card = load_card_of(MarksCard, NAME)
    assert verify_model(card).stat().st_size <= MAX_BYTES
    figures = card.measured["held-out houses"]
    assert figures["first_seed"] >= 1000
    assert figures["bytes"] == card.path.stat().st_size


def test_the_order_of_the_marks_and_the_size_of_the_image_change_little(shipped):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 255, (*HW, 3), np.uint8)
    marks = [
        mark(1, 20.0, 150.0, 0.6, 2.0), mark(2, 160.0, 140.0, 0.0, 5.0),
        mark(3, 300.0, 200.0, -0.6, 1.2),
    ]  # fmt: skip
    one = shipped.answer(shipped.look(view(*marks, rgb=rgb)))
    other = shipped.answer(shipped.look(view(*marks[::-1], rgb=rgb)))
    assert one.p.sum() + one.elsewhere == pytest.approx(1.0)
    np.testing.assert_allclose(one.p, other.p[::-1], atol=1e-5)
    doubled = [m._replace(u_px=2 * m.u_px + 0.5, v_px=2 * m.v_px + 0.5) for m in marks]
    large = rgb.repeat(2, axis=0).repeat(2, axis=1)
    scaled = shipped.answer(shipped.look(view(*doubled, rgb=large)))
    np.testing.assert_allclose(one.p, scaled.p, atol=1e-4)
    assert scaled.scene == pytest.approx(one.scene, abs=1e-4)


# -- TensorRT -------------------------------------------------------------------------------------


def test_every_input_has_one_shape_as_tensorrt_wants_it():
    check_fixed(verify_model(load_card_of(MarksCard, NAME)), "providers")


@pytest.mark.parametrize("provider", ["tensorrt", "TensorrtExecutionProvider"])
def test_int8_for_a_cpu_is_none_for_tensorrt(provider):
    config = ChoiceOnnx(card=NAME, providers=(provider,))
    with pytest.raises(ModelError, match="mini-house-choice: its INT8 is not symmetric"):
        open_mark_scorer(load_card_of(MarksCard, NAME), config)
