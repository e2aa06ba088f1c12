"""The two encoders of CLIP, SigLIP and their like as ONNX files; none comes with the package.

`exporters.clip` makes the files and their cards from a folder of Hugging Face. A `text` card's file
maps `tokens` (n, context) int64 to `embeddings` (n, d) float32. What follows a text's own tokens is
the card's `pad`: CLIP takes the place of the *first* end-of-text token and never sees it, SigLIP
reads to the last place. With the family `clip-vit-b-32` it serves YOLO-World too, in the place of
the vocabulary. The tokenizer's file, which does all that is done to a text, lies beside it. An
`image` card's file maps `pixels` (1, 3, h, w) float32 to `embeddings` (1, d). Rows are made unit
rows here.
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
from edge.perception.runtime.cards import ModelError, verify_model
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.model_file import fresh_sha256
from edge.perception.runtime.sessions import open_session
from edge.perception.runtime.tokenizer import read_tokenizer

CPU = ("CPUExecutionProvider",)


class ClipTextEncoder:
    """A `TextEncoder` that understands whole phrases.

    What was encoded once is kept, 2 KB a text or so: a mission that comes while the robot drives
    costs the loop its own words only, and not the background's each time.
    """

    def __init__(self, card: TextCard) -> None:
        """
        Raises:
            ModelError: the model, its tokenizer or a package is not there, or is unusable.
        """
        assert isinstance(card.tokenizer, ClipTokenizer)
        self.card = card
        self.dim = card.dim
        self._context, self._pad = card.tokenizer.context, card.tokenizer.pad
        path = verify_model(card, believe_cache=True)
        self._tokenizer = open_tokenizer(card)
        self._session = open_session(path, CPU, threads=1)
        self._rows: dict[str, np.ndarray] = {}

    def embed(self, prompts: Sequence[str]) -> np.ndarray:
        """See `TextEncoder.embed`."""
        return self.encode([self.resolve(prompt) for prompt in check_prompts(prompts)])[None]

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        """One unit row per text, whatever it says.

        Returns:
            (n, d) float32.

        Raises:
            PromptError: a text is longer than the model reads.
            ModelError: the model fails, or its output is not finite.
        """
        if new := [text for text in dict.fromkeys(texts) if text not in self._rows]:
            self._rows.update(zip(new, self._encode(new), strict=True))
        return np.stack([self._rows[text] for text in texts])

    def _encode(self, texts: Sequence[str]) -> np.ndarray:
        tokens = np.full((len(texts), self._context), self._pad, np.int64)
        for row, text in zip(tokens, texts, strict=True):
            ids = self._tokenizer.encode(text).ids
            if len(ids) > self._context:
                raise PromptError(
                    f"prompt {text[:40]!r}…: {len(ids)} tokens, the text model reads "
                    f"{self._context}: say it shorter"
                )
            row[: len(ids)] = ids
        return _unit_rows(self._session, self.card, "tokens", tokens)

    def resolve(self, prompt: str) -> str:
        """The prompt itself, tidied; see `TextEncoder.resolve`."""
        return tidy(prompt)

    def synonyms(self, prompt: str) -> list[str]:
        """See `TextEncoder.synonyms`: people's names for it, as phrases of their own."""
        return list(names.names_of(prompt)[1 : 1 + MAX_SYNONYMS])

    def contrasts(self, prompt: str, whole: bool = True) -> list[str]:
        """See `TextEncoder.contrasts`: what a phrase says of its thing is not told apart here."""
        return []

    def __repr__(self) -> str:
        return str(self.card.path)


class ClipImageEncoder:
    """One image → one unit row."""

    def __init__(
        self,
        card: ImageCard,
        providers: Sequence[str],
        threads: int,
        device_id: int = 0,
        engine: EngineOptions | None = None,
    ) -> None:
        """
        Args:
            providers, threads, device_id, engine: see `open_session`.

        Raises:
            ModelError: the model is not there, or is unusable.
        """
        self.card = card
        self.dim = card.dim
        if card.server is not None:
            from edge.perception.runtime.kserve import RemoteSession  # few need what that loads

            self._session = RemoteSession(card)
        else:
            path = verify_model(card, believe_cache=True)
            self._session = open_session(path, providers, threads, device_id, engine)

    def embed(self, rgb: np.ndarray) -> np.ndarray:
        """
        Args:
            rgb: (h, w, 3) uint8.

        Returns:
            (d,) float32.

        Raises:
            ModelError: the model fails, or its output is not finite.
        """
        return _unit_rows(self._session, self.card, "pixels", pixels_of(rgb, self.card))[0]

    def close(self) -> None:
        """Give up what a server is asked."""
        if self.card.server is not None:
            self._session.close()


def pixels_of(rgb: np.ndarray, card: ImageCard) -> np.ndarray:
    """(h, w, 3) uint8 → (1, 3, height, width) float32, as the card's model wants it."""
    how = card.preprocess
    planes = fit(rgb, card.input.height, card.input.width, how.fit).astype(np.float32)
    pixels = (planes * np.float32(how.scale) - np.float32(how.mean)) / np.float32(how.std)
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))[None]


def fit(rgb: np.ndarray, height: int, width: int, how: str) -> np.ndarray:
    """The image as (height, width).

    Args:
        how: `crop`: scaled until it just fills the size, and its middle; `stretch`: squeezed.
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
    """The tokenizer of a `text` card, which neither pads nor cuts off.

    Raises:
        ModelError: its file or the package is missing, or the file is another or no tokenizer.
    """
    path = card.tokenizer_path
    if path is None or not path.is_file():
        raise ModelError(f"{path}: the tokenizer of {card.name} is not there; put it there")
    wanted = card.tokenizer.sha256
    if wanted is not None and fresh_sha256(path) != wanted:
        raise ModelError(f"{path}: another tokenizer: its sha256 is not {wanted[:12]}…")
    return read_tokenizer(path, card.name, "pip install 'edge-vln[clip]'")


def _unit_rows(
    session: Any, card: TextCard | ImageCard, name: str, batch: np.ndarray
) -> np.ndarray:
    rows = run_encoder(session, card.file or f"model {card.name}", name, batch, card.dim)
    norms = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.ascontiguousarray(rows / norms, dtype=np.float32)
