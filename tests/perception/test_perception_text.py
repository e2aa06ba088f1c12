from __future__ import annotations

import logging

import numpy as np
import pytest

from edge.models.make import store_vocabulary
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import PromptError, TextEmbeddings, find_vocabulary, words_for


def test_an_exported_vocabulary_is_stored_for_the_service(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("EDGE_VOCABULARY", raising=False)
    source = tmp_path / "words.npz"
    source.write_bytes(b"vocabulary")
    kept = store_vocabulary(source)
    assert find_vocabulary(None) == kept == store_vocabulary(kept)
    assert kept.read_bytes() == b"vocabulary"
    assert [p.name for p in kept.parent.iterdir()] == [kept.name]


@pytest.mark.parametrize("prompts", [[], [""], ["  "], ["chair", "  "]])
def test_an_empty_prompt_is_an_error(vocabulary, prompts):
    with pytest.raises(PromptError, match="prompt"):
        TextEmbeddings(str(vocabulary)).embed(prompts)


def test_rows_are_unit_and_in_order(vocabulary):
    rows = TextEmbeddings(str(vocabulary)).embed(["bed", "chair"])
    assert rows.shape == (1, 2, 512)
    assert rows.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(rows, axis=2), 1.0, rtol=1e-6)
    assert rows[0, 0, 4] == rows[0, 1, 0] == 1.0


@pytest.mark.parametrize(
    ("prompt", "word"),
    [
        ("chair", "chair"),
        ("Chairs", "chair"),
        ("couch", "sofa"),
        ("trash bin", "trash can"),
        ("the garbage can", "trash can"),
        ("ReadingDesk", "desk"),
    ],
)
def test_aliases_resolve_without_a_warning(vocabulary, caplog, prompt, word):
    assert TextEmbeddings(str(vocabulary)).resolve(prompt) == word
    assert not caplog.records


@pytest.mark.parametrize(
    ("phrase", "word"),
    [
        ("tall white trash bin", "trash can"),
        ("red chair next to the window", "chair"),
        ("old leather couch", "sofa"),
    ],
)
def test_a_phrase_falls_back_to_its_noun_with_a_warning(vocabulary, caplog, phrase, word):
    with caplog.at_level(logging.WARNING):
        assert TextEmbeddings(str(vocabulary)).resolve(phrase) == word
    assert phrase in caplog.text
    assert word in caplog.text


def test_an_unknown_kind_is_searched_as_the_broader_word(tmp_path, caplog):
    words = ["potted plant", "mailbox (at home)", "bow (weapon)", "bow (decorative ribbons)"]
    np.savez(tmp_path / "words.npz", names=words, emb=np.eye(4, 512))
    encoder = TextEmbeddings(str(tmp_path / "words.npz"))
    assert encoder.resolve("tall bushes") == "potted plant"
    assert encoder.resolve("tall bushes") == "potted plant"
    assert caplog.text.count("'tall bushes': no embedding; searched as 'plant'") == 1
    assert encoder.resolve("letter box") == "mailbox (at home)"
    assert encoder.resolve("bow (weapon)") == "bow (weapon)"
    for unknown in ("bow", "fence", "trunk", "shed"):
        with pytest.raises(PromptError, match="not in the vocabulary"):
            encoder.resolve(unknown)


def test_a_missing_vocabulary_is_reported_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("EDGE_VOCABULARY", raising=False)
    with pytest.raises(
        PromptError, match=r"clip_vitb32_vocab.npz: no vocabulary .*EDGE_VOCABULARY"
    ):
        TextEmbeddings()


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04broken"])
def test_a_damaged_vocabulary_is_named(tmp_path, content):
    path = tmp_path / "v.npz"
    path.write_bytes(content)
    with pytest.raises(PromptError, match=r"v\.npz: not a vocabulary"):
        TextEmbeddings(str(path))


def torn_zip(path):
    """Corrupt the first array's compressed bytes, not their offsets."""
    np.savez_compressed(path, names=np.array(["a", "b"]), emb=np.eye(2))
    content = bytearray(path.read_bytes())
    content[60:70] = b"\xff" * 10
    path.write_bytes(content)


@pytest.mark.parametrize(
    "write",
    [
        lambda path: np.save(path.open("wb"), np.eye(2)),
        lambda path: np.savez(path, names=np.array("a"), emb=np.eye(1)),
        lambda path: np.savez(path, names=np.array(["a"]), emb=np.array([["b"]])),
        torn_zip,
    ],
)
def test_an_unsuitable_file_is_not_a_vocabulary(tmp_path, write):
    write(tmp_path / "v.npz")
    with pytest.raises(PromptError, match=r"v\.npz: not a vocabulary"):
        TextEmbeddings(str(tmp_path / "v.npz"))


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        (np.ones((3, 4), np.float16), "2 names, but embeddings"),
        (np.array([[1, 0], [0, 0]]), "the embedding of 'b' is zero or not finite"),
        (np.array([[np.nan, 1], [1, 0]]), "the embedding of 'a' is zero or not finite"),
        (np.array([[1, 0], [1, np.inf]]), "the embedding of 'b' is zero or not finite"),
        (np.ones((2, 0)), "the embedding of 'a' is zero or not finite"),
    ],
)
def test_every_word_must_have_an_embedding(tmp_path, rows, says):
    path = tmp_path / "v.npz"
    np.savez(path, names=np.array(["a", "b"]), emb=rows)
    with pytest.raises(PromptError, match=rf"v\.npz: {says}"):
        TextEmbeddings(str(path))


def test_words_for_omits_unknown_words(vocabulary):
    resolve = TextEmbeddings(str(vocabulary)).resolve
    assert words_for((), resolve) == {}
    assert words_for(("couch", "zebra", "", "bed"), resolve) == {"couch": "sofa", "bed": "bed"}


class _Card:
    """Stand-in for the fields of a detector's card that `make_text_encoder` reads."""

    name, text_encoder, text_dim = "detector", None, 512


def test_without_a_text_model_the_vocabulary_is_taken(cards, vocabulary):
    encoder = make_text_encoder(_Card, str(vocabulary))
    assert encoder.embed(["bed"]).shape == (1, 1, encoder.dim) == (1, 1, 512)
    assert encoder.contrasts("red chair") == []


def test_an_invalid_card_of_another_model_is_skipped(cards, vocabulary, caplog):
    (cards / "broken.yaml").write_text("name: [")
    assert make_text_encoder(_Card, str(vocabulary)).dim == 512
    (record,) = caplog.records
    assert "broken.yaml: cannot be read" in record.message


def test_with_neither_both_are_named(cards):
    with pytest.raises(PromptError) as raised:
        make_text_encoder(_Card, None)
    says = "no text embeddings: found neither a CLIP text model (no text card of family clip"
    assert str(raised.value).startswith(says)
    assert "clip_vitb32_vocab.npz: no vocabulary" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_embeddings_of_another_length_are_refused(cards, vocabulary, monkeypatch):
    monkeypatch.setattr(_Card, "text_dim", 64)
    with pytest.raises(PromptError, match=r"words\.npz: embeddings have length 512, .* needs 64"):
        make_text_encoder(_Card, str(vocabulary))


def test_synonyms_cover_aliases_and_near_words(tmp_path):
    """Prompts include aliases and near words of the embedding, never broader ones.

    A near word must be a kind of the class, or no class of its own.
    """
    words = {
        "sofa": (1.0, 0.0), "couch": (0.6, 0.8), "futon": (0.97, 0.243), "bed": (0.98, 0.2),
        "armchair": (0.0, 1.0), "chair": (0.01, 1.0), "lamp": (-1.0, 0.0), "#": (1.0, 0.01),
    }  # fmt: skip
    np.savez(tmp_path / "v.npz", names=list(words), emb=np.array(list(words.values())))
    text = TextEmbeddings(str(tmp_path / "v.npz"))
    assert text.synonyms("settee") == ["couch", "futon"]
    assert text.synonyms("chair") == ["armchair"]
    assert text.synonyms("armchair") == []
    assert text.synonyms("desk lamp") == []
    with pytest.raises(PromptError):
        text.synonyms("zebra")


def test_synonyms_cover_narrower_words_without_their_own_class(tmp_path):
    angles = {"table": 0.0, "kids table": 0.30, "pool table": 0.40, "dining table": 0.40}
    angles |= {"board": 0.40, "far table": 0.50}  # cosine 0.92 at 0.40 rad, 0.88 at 0.50 rad
    rows = [(np.cos(angle), np.sin(angle)) for angle in angles.values()]
    np.savez(tmp_path / "v.npz", names=list(angles), emb=np.array(rows))
    text = TextEmbeddings(str(tmp_path / "v.npz"))
    assert text.synonyms("table") == ["kids table", "pool table"]
