"""CLIP's encoders, in miniature: the real ones cannot be had everywhere."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
import tiny_clip
from tiny_clip import CONTEXT, DIM, SIDE, WORDS

from edge.host import resources
from edge.perception.embedding import clip, text
from edge.perception.embedding.clip import ClipTextEncoder, fit
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import PromptError, TextEmbeddings
from edge.perception.runtime.cards import ModelError, load_card

for package in ("onnxruntime", "onnx", "tokenizers"):
    pytest.importorskip(package)


@pytest.fixture
def text_card(cards):
    """make(**kw): the card of the text model, whose file `write_text_model` makes so."""
    models = resources.models_dir()

    def make(**model):
        tiny_clip.write_tokenizer(models / "tiny-tokenizer.json")
        tiny_clip.write_text_model(models / "tiny-text.onnx", **model)
        tiny_clip.write_card(cards, tiny_clip.TEXT, models / "tiny-text.onnx")
        return load_card("tiny-clip-text")

    return make


@pytest.mark.parametrize("prompts", [[], [""], ["chair", "  "]])
def test_an_empty_prompt_is_an_error(text_card, prompts):
    with pytest.raises(PromptError, match="prompt"):
        ClipTextEncoder(text_card()).embed(prompts)


def test_a_phrase_is_its_tokens_between_beginning_and_end(text_card):
    encoder = ClipTextEncoder(text_card())
    rows = encoder.embed(["The red  Chair", "sofa", "unheard"])
    assert rows.shape == (1, 3, encoder.dim)
    assert rows.dtype == np.float32
    ends = 3 + len(WORDS)  # token of the end; 0 pads, 1 begins, and 2 is not known
    wanted = np.zeros((3, DIM))
    wanted[0, [3 + WORDS.index("chair"), 3 + WORDS.index("red"), ends]] = 3**-0.5
    wanted[1, [3 + WORDS.index("sofa"), ends]] = 2**-0.5
    wanted[2, ends] = 1.0
    np.testing.assert_allclose(rows[0], wanted, atol=1e-6)
    assert encoder.resolve(" The red  Chair") == "red chair"
    assert encoder.contrasts("red chair") == []


def test_a_phrase_is_encoded_once(text_card, monkeypatch):
    encoder, encoded = ClipTextEncoder(text_card()), []

    def note(session, file, name, tokens, dim):
        encoded.append(len(tokens))
        return text.run_encoder(session, file, name, tokens, dim)

    monkeypatch.setattr(clip, "run_encoder", note)
    first = encoder.embed(["chair", "sofa", "the chair"])
    again = encoder.embed(["sofa", "red chair", "chair"])
    assert encoded == [2, 1]
    np.testing.assert_array_equal(again[0, [2, 0]], first[0, :2])
    np.testing.assert_array_equal(first[0, 2], first[0, 0])
    again[:] = 0.0  # the caller's own
    np.testing.assert_array_equal(encoder.embed(["chair"])[0, 0], first[0, 0])


def test_too_many_tokens_are_an_error(text_card):
    encoder = ClipTextEncoder(text_card())
    most = "red " * (CONTEXT - 3) + "chair"
    assert encoder.embed([most]).shape == (1, 1, DIM)
    with pytest.raises(PromptError, match="13 tokens, the text model reads at most 12"):
        encoder.embed([f"red {most}"])


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ({"name": "input_ids"}, "must have inputs .tokens int64"),
        ({"table": np.ones((20, DIM + 1), np.float32)}, "must have .* outputs .embeddings"),
        ({"table": np.full((20, DIM), np.nan, np.float32)}, "not finite"),
        ({"table": np.zeros((20, DIM), np.float32)}, "not finite"),
        ({"table": np.ones((3, DIM), np.float32)}, "it fails"),
    ],
)
def test_a_model_of_another_interface_is_refused(text_card, model, expected):
    with pytest.raises(ModelError, match=expected) as raised:
        ClipTextEncoder(text_card(**model)).embed(["chair"])
    assert "tiny-text.onnx: " in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_tokenizer_that_is_missing_or_none_is_an_error(text_card, monkeypatch):
    card = text_card()
    card.tokenizer_path.write_text("{}")
    with pytest.raises(ModelError, match=r"tiny-tokenizer\.json: not a tokenizer"):
        ClipTextEncoder(card)
    monkeypatch.setitem(sys.modules, "tokenizers", None)
    with pytest.raises(ModelError, match=r"pip install 'edge-vln\[clip\]'"):
        ClipTextEncoder(card)
    card.tokenizer_path.unlink()
    with pytest.raises(ModelError, match=r"tiny-tokenizer\.json: no such file; put the token"):
        ClipTextEncoder(card)


@pytest.mark.parametrize("where", ["card", "record"])
def test_another_tokenizer_than_the_cards_is_refused(text_card, cards, where):
    made, other = text_card(), "0" * 64
    tokenizer = {**tiny_clip.TEXT["tokenizer"], "sha256": other if where == "card" else None}
    if where == "record":
        record = made.tokenizer_path.with_name(f"{made.tokenizer_path.name}.json")
        record.write_text(json.dumps({"sha256": other}))
    path = resources.models_dir() / "tiny-text.onnx"
    tiny_clip.write_card(cards, {**tiny_clip.TEXT, "tokenizer": tokenizer}, path)
    with pytest.raises(ModelError, match="another tokenizer"):
        ClipTextEncoder(load_card("tiny-clip-text"))


class _Card:
    """Stand-in for the fields of a detector's card that `make_text_encoder` reads."""

    name, text_encoder, text_dim = "detector", None, DIM


def test_the_text_model_is_used_if_its_file_exists(text_card, tmp_path, caplog):
    np.savez(tmp_path / "words.npz", names=np.array(["chair"]), emb=np.eye(1, DIM))
    card = text_card()
    caplog.set_level("INFO")
    assert isinstance(make_text_encoder(_Card, str(tmp_path / "words.npz")), ClipTextEncoder)
    assert "perception.detector.vocabulary: not read" in caplog.text
    card.path.unlink()
    assert isinstance(make_text_encoder(_Card, str(tmp_path / "words.npz")), TextEmbeddings)
    with pytest.raises(PromptError) as raised:
        make_text_encoder(_Card, None)
    assert str(card.path) in str(raised.value)
    assert "clip_vitb32_vocab.npz" in str(raised.value)


def test_a_text_model_of_another_family_is_not_used(text_card, cards, tmp_path):
    """Its embeddings have the same length, and are elsewhere."""
    words = tmp_path / "words.npz"
    np.savez(words, names=np.array(["chair"]), emb=np.eye(1, DIM))
    path = text_card().path
    tiny_clip.write_card(cards, {**tiny_clip.TEXT, "family": "clip-vit-b-16"}, path)
    assert isinstance(make_text_encoder(_Card, str(words)), TextEmbeddings)

    class Named(_Card):
        text_encoder = "tiny-clip-text"

    assert isinstance(make_text_encoder(Named, str(words)), ClipTextEncoder)
    path.unlink()
    with pytest.raises(ModelError, match=r"tiny-text\.onnx: model tiny-clip-text is not there"):
        make_text_encoder(Named, str(words))


@pytest.mark.parametrize("hw", [(32, 32), (64, 128), (16, 8)])
def test_an_image_is_scaled_and_cropped_to_the_middle(hw):
    rgb = np.zeros((*hw, 3), np.uint8)
    rgb[:, hw[1] // 2 :, 0] = 200
    fitted = fit(rgb, SIDE, SIDE, "crop")
    assert fitted.shape == (SIDE, SIDE, 3)
    assert (fitted[:, : SIDE // 2 - 2] == 0).all()
    np.testing.assert_allclose(fitted[:, SIDE // 2 + 2 :, 0], 200, atol=30)


@pytest.mark.parametrize("hw", [(32, 32), (64, 128), (16, 8), (16, 64)])
def test_the_card_can_stretch_an_image_to_fit(hw):
    """Nothing of it is lost: the right quarter is the right quarter still."""
    rgb = np.zeros((*hw, 3), np.uint8)
    rgb[:, hw[1] * 3 // 4 :, 0] = 200
    fitted = fit(rgb, SIDE, SIDE, "stretch")
    assert fitted.shape == (SIDE, SIDE, 3)
    edge = SIDE * 3 // 4
    assert (fitted[:, : edge - 4, 0] < 30).all()
    np.testing.assert_allclose(fitted[:, edge + 4 :, 0], 200, atol=30)
