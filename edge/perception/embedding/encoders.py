"""Opens the text encoder for prompts: that of the card, CLIP's, or the vocabulary."""

from __future__ import annotations

import logging

from edge.perception.embedding.attributes import AttributeEncoder
from edge.perception.embedding.clip import ClipTextEncoder, open_tokenizer
from edge.perception.embedding.text import PromptError, TextEmbeddings, TextEncoder
from edge.perception.runtime.card_types import ClipTokenizer, DetectCard, TextCard
from edge.perception.runtime.cards import ModelError, card_names, load_card, load_card_of

log = logging.getLogger(__name__)

VOCABULARY_FAMILY = "clip-vit-b-32"
"""Family of the text cards whose embeddings the vocabulary holds.

Other CLIP models have other embeddings, often of the same length: they are not interchangeable."""


def make_text_encoder(card: DetectCard, vocabulary: str | None) -> TextEncoder:
    """Make the encoder for a detector's prompts.

    The card may name the encoder. If it names none, the encoder is that of CLIP ViT-B/32: the text
    model if its file is there, else the vocabulary.

    Raises:
        ModelError: the model's file exists, but cannot be used.
        PromptError: there is neither a model nor a vocabulary, or the embeddings have another
            length than the detector needs.
    """
    named = None if card.text_encoder is None else load_card_of(TextCard, card.text_encoder)
    encoder = open_text_encoder(named, vocabulary)
    if encoder.dim != card.text_dim:
        raise PromptError(
            f"{encoder!r}: embeddings have length {encoder.dim}, "
            f"model {card.name} needs {card.text_dim}"
        )
    return encoder


def check_text_encoder(card_name: str | None, vocabulary: str | None) -> None:
    """Check that `open_text_encoder` would find an encoder, without loading a network.

    Args:
        card_name: name of the text card; None for CLIP ViT-B/32's.
        vocabulary: configured path; see `find_vocabulary`.

    Raises:
        ModelError, PromptError: see `make_text_encoder`.
    """
    card = None if card_name is None else load_card_of(TextCard, card_name)
    models = [card] if card is not None else _vocabulary_models()
    here = [model for model in models if model.path.is_file()]
    if not here:  # opens the vocabulary, which has no network, or raises
        open_text_encoder(card, vocabulary)
    elif isinstance(here[0].tokenizer, ClipTokenizer):
        open_tokenizer(here[0])


def open_text_encoder(named: TextCard | None, vocabulary: str | None) -> TextEncoder:
    """Open a text encoder; see `make_text_encoder`."""
    if named is not None and named.tokenizer.kind == "attributes":
        _note_unused(vocabulary, named)
        return AttributeEncoder(named)
    models = [named] if named is not None else _vocabulary_models()
    for model in models:
        # No vocabulary replaces a model of another family: if missing, ClipTextEncoder raises.
        if model.path.is_file() or model.family != VOCABULARY_FAMILY:
            _note_unused(vocabulary, model)
            return ClipTextEncoder(model)
    try:
        return TextEmbeddings(vocabulary)
    except PromptError as error:
        wanted = " or ".join(str(model.path) for model in models)
        wanted = wanted or f"no text card of family {VOCABULARY_FAMILY}"
        raise PromptError(
            f"no text embeddings: found neither a CLIP text model ({wanted}), nor a vocabulary: "
            f"{error}"
        ) from None


def _note_unused(vocabulary: str | None, model: TextCard) -> None:
    """Log that a configured vocabulary is not read."""
    if vocabulary is not None:
        log.info("perception.detector.vocabulary: not read: %s encodes the prompts", model.name)


def _vocabulary_models() -> list[TextCard]:
    """Return cards of text models with the vocabulary's embeddings."""
    found = []
    for name in card_names():
        try:
            card = load_card(name)
        except ModelError as error:  # an invalid card must not stop the detector
            log.warning("%s; this model card is ignored", error)
            continue
        if isinstance(card, TextCard) and card.family == VOCABULARY_FAMILY:
            found.append(card)
    return found
