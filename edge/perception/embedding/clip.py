"""Text and image encoders of CLIP, SigLIP and similar models as ONNX files.

The package has no such files: `exporters.clip` makes files and cards from a Hugging Face folder.

- A `text` card's file maps `tokens` (n, context) int64 to `embeddings` (n, d) float32. The card's
  `pad` fills the places after a text's tokens. CLIP reads only up to the *first* end-of-text token;
  SigLIP reads the padding, too. A card of the family `clip-vit-b-32` also serves YOLO-World, in
  place of the vocabulary. The tokenizer's file, which does all text processing, is next to it.
- An `image` card's file maps `pixels` (1, 3, h, w) float32 to `embeddings` (1, d).

Rows are normalised to length 1 here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from edge import names
from edge.perception.embedding.text import (
    MAX_SYNONYMS,
    PromptError,
    check_prompts,
    run_encoder,
    tidy,
)
from edge.perception.runtime.card_types import ClipTokenizer, ImageCard, TextCard
from edge.perception.runtime.cards import ModelError, expected_of, verify_model
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.model_file import fresh_sha256
from edge.perception.runtime.sessions import open_session
from edge.perception.runtime.tokenizer import read_tokenizer

CPU = ("CPUExecutionProvider",)


class ClipTextEncoder:
    """A `TextEncoder` that understands entire phrases.

    Embeddings are cached, some 2 KB a text. When a mission arrives while the robot drives, the loop
    waits only for the mission's own words: the background classes are in the cache.

    Raises:
        ModelError: the model, its tokenizer or a package is missing or unusable.
    """

    def __init__(self, card: TextCard) -> None:
        assert isinstance(card.tokenizer, ClipTokenizer)
        self.card = card
        self.dim = card.dim
        self._context, self._pad = card.tokenizer.context, card.tokenizer.pad
        path = verify_model(card, believe_cache=True)
        self._tokenizer = open_tokenizer(card)
        self._session = open_session(path, CPU, threads=1)
        self._rows: dict[str, np.ndarray] = {}  # unit row of each text encoded so far

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        sentence = self.card.tokenizer.sentence
        return self.encode([sentence.format(self.resolve(p)) for p in check_prompts(prompts)])[None]

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        """Return one unit row per text, without resolving it as a prompt, (n, d) float32.

        Raises:
            PromptError: a text is longer than the model's context.
            ModelError: the model fails, or its output is not finite.
        """
        if new := [text for text in dict.fromkeys(texts) if text not in self._rows]:
            self._rows.update(zip(new, self._encode(new), strict=True))
        return np.stack([self._rows[text] for text in texts])

    def _encode(self, texts: Sequence[str]) -> np.ndarray:
        """Run the model on texts; see `encode`."""
        tokens = np.full((len(texts), self._context), self._pad, np.int64)
        for row, text in zip(tokens, texts, strict=True):
            ids = self._tokenizer.encode(text).ids
            if len(ids) > self._context:
                raise PromptError(
                    f"prompt {text[:40]!r}…: {len(ids)} tokens, the text model reads at most "
                    f"{self._context}: shorten the prompt"
                )
            row[: len(ids)] = ids
        return _unit_rows(self._session, self.card, "tokens", tokens)

    def resolve(self, prompt: str) -> str:
        """Return the prompt itself, normalised; see `TextEncoder.resolve`."""
        return tidy(prompt)

    def synonyms(self, prompt: str) -> list[str]:
        """Return common names of the prompt's object, each a phrase; see `TextEncoder.synonyms`."""
        return list(names.names_of(prompt)[1 : 1 + MAX_SYNONYMS])

    def contrasts(self, prompt: str, in_full: bool = True) -> list[str]:
        """Return none: the model does not separate attributes; see `TextEncoder.contrasts`."""
        return []

    def __repr__(self) -> str:
        return str(self.card.path)


class ClipImageEncoder:
    """An image encoder: one image → one unit row.

    Raises:
        ModelError: the model is missing or unusable.
    """

    def __init__(
        self,
        card: ImageCard,
        providers: Sequence[str],
        threads: int,
        device_id: int = 0,
        engine: EngineOptions | None = None,
    ) -> None:
        self.card = card
        self.dim = card.dim
        if card.server is not None:
            from edge.perception.runtime.kserve import KServeSession  # loads httpx: rarely needed

            self._session = KServeSession(card)
        else:
            path = verify_model(card, believe_cache=True)
            self._session = open_session(path, providers, threads, device_id, engine)

    def embed(self, rgb: np.ndarray) -> np.ndarray:
        """Encode an image; return (d,) float32.

        Args:
            rgb: (h, w, 3) uint8.

        Raises:
            ModelError: the model fails, or its output is not finite.
        """
        return _unit_rows(self._session, self.card, "pixels", pixels_of(rgb, self.card))[0]

    def close(self) -> None:
        """Abort a request to a server."""
        if self.card.server is not None:
            self._session.close()


def pixels_of(rgb: np.ndarray, card: ImageCard) -> np.ndarray:
    """Convert (h, w, 3) uint8 to (1, 3, height, width) float32, as the card's model needs."""
    p = card.preprocess
    planes = fit(rgb, card.input.height, card.input.width, p.fit).astype(np.float32)
    pixels = (planes * np.float32(p.scale) - np.float32(p.mean)) / np.float32(p.std)
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))[None]


def fit(rgb: np.ndarray, height: int, width: int, how: str) -> np.ndarray:
    """Scale an image to (height, width).

    Args:
        rgb: (h, w, 3) uint8.
        height: height of the result in pixels.
        width: width of the result in pixels.
        how: `crop`: scale until the image fills the size, then take its middle; `stretch`: scale
            both sides, without regard to the aspect ratio.
    """
    h, w = rgb.shape[:2]
    scale = max(height / h, width / w)
    size = max(width, round(w * scale)), max(height, round(h * scale))
    if how == "stretch":
        size = width, height
    shrunk = size[0] < w or size[1] < h
    large = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if shrunk else cv2.INTER_CUBIC)
    top, left = (size[1] - height) // 2, (size[0] - width) // 2
    return large[top : top + height, left : left + width]


def open_tokenizer(card: TextCard) -> Any:
    """Open the tokenizer of a `text` card, without padding or truncation.

    Raises:
        ModelError: the file or the package is missing, or the file is not this card's tokenizer.
    """
    path = card.tokenizer_path
    if path is None or not path.is_file():
        raise ModelError(f"{path}: no such file; put the tokenizer of {card.name} there")
    wanted, _ = expected_of(card.tokenizer, path)
    if wanted is not None and fresh_sha256(path) != wanted:
        raise ModelError(
            f"{path}: damaged, or another tokenizer than that of {card.name}: its sha256 is not "
            f"{wanted[:12]}…"
        )
    return read_tokenizer(path, card.name, "pip install 'edge-vln[clip]'")


def _unit_rows(
    session: Any, card: TextCard | ImageCard, name: str, batch: np.ndarray
) -> np.ndarray:
    """Run an encoder, and scale each row to length 1; see `run_encoder`."""
    rows = run_encoder(session, card.file or f"model {card.name}", name, batch, card.dim)
    norms = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.ascontiguousarray(rows / norms, dtype=np.float32)
