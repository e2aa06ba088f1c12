"""A small network that answers ViTL eq. 4 and 5 by itself: image, target and marks in, logits out.

It is shown no letters: where the marks are it gets as numbers, since a network of this size learns
to go by numbers sooner than to read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from edge.config import ChoiceOnnx
from edge.perception.backends.engines import EngineOptions
from edge.perception.backends.runtime import failing_as, open_session
from edge.perception.card_types import MARK_FIELDS, MarksCard, TextCard
from edge.perception.cards import load_card_of, verify_model
from edge.perception.choice.question import MAX_MARKS, Choice, Mark, View, choice_of
from edge.perception.encoders import open_text_encoder
from edge.perception.model_file import ModelError
from edge.perception.text import TextEncoder

PROVIDERS_KEY = "perception.choice.providers"


class Looked(NamedTuple):
    """What of a view the network gets.

    Attributes:
        images: (1, 3, h, w) float32.
        marks: (1, MAX_MARKS, MARK_FIELDS) float32; see `MarksCard`.
    """

    view: View
    images: np.ndarray
    marks: np.ndarray


class MarkScorer:
    """A scorer (`edge.perception.worker`) of views.

    Attributes:
        name: the model's card.
    """

    def __init__(
        self,
        card: MarksCard,
        text: TextEncoder,
        providers: Sequence[str],
        threads: int,
        device_id: int = 0,
    ) -> None:
        """
        Raises:
            ModelError: the model is not there, is unusable, or its text encoder's embeddings have
                another length.
        """
        if text.dim != card.text_dim:
            raise ModelError(
                f"model {card.name}: takes text embeddings of length {card.text_dim}, those of "
                f"{card.text_encoder} have {text.dim}: name another text_encoder"
            )
        self.name, self._card, self._text = card.name, card, text
        path = verify_model(card, believe_cache=True)
        engine = EngineOptions(card.name, card.precision)
        self._session = open_session(path, providers, threads, device_id, engine, PROVIDERS_KEY)
        self._rows: dict[str, np.ndarray] = {}

    def look(self, view: View) -> Looked:
        """Prepare what the network gets; the observation is not needed afterwards.

        Raises:
            ModelError: the observation has no image.
        """
        rgb = view.observation.rgb
        if rgb is None:
            raise ModelError(f"observation {view.observation.seq}: no image to show {self.name}")
        how, hw = self._card.preprocess, (self._card.input.height, self._card.input.width)
        image, scale, top, left = letterboxed(rgb, hw, how.letterbox_pad)
        planes = image.transpose(2, 0, 1)[None].astype(np.float32, order="C")
        planes *= np.float32(how.scale)
        return Looked(view, planes, as_input(view.marks[:MAX_MARKS], scale, top, left, hw))

    def answer(self, looked: Looked) -> Choice | None:
        """Both answers at once.

        Returns:
            None where there is no mark: there is nothing to choose from.

        Raises:
            PromptError: the text encoder does not know the target.
            ModelError: the network fails, or what it says is not finite.
        """
        view, marks = looked.view, looked.view.marks[:MAX_MARKS]
        if not marks:
            return None
        feed = {
            "images": looked.images, "txt_feats": self._row(view.target), "marks": looked.marks,
        }  # fmt: skip
        with failing_as(f"model {self.name}: it fails"):
            directions, scene = self._session.run(["directions", "scene"], feed)
        # Of the marks that are there, and of "elsewhere".
        logits = np.append(directions[0, : len(marks)], directions[0, MAX_MARKS]).astype(np.float64)
        if not (np.isfinite(logits).all() and np.isfinite(scene).all()):
            raise ModelError(f"model {self.name}: returns logits that are not finite")
        p = np.exp(logits - logits.max())
        p /= p.sum()
        promising = float(1.0 / (1.0 + np.exp(-np.float64(scene[0, 0]))))
        return choice_of(view, marks, p, promising)

    def _row(self, target: str) -> np.ndarray:
        """(1, dim), encoded once a target."""
        if target not in self._rows:
            self._rows[target] = self._text.embed([target])[0]
        return self._rows[target]

    def close(self) -> None:
        """Nothing to give up: an answer takes milliseconds."""


def letterboxed(
    rgb: np.ndarray, hw: tuple[int, int], pad: int
) -> tuple[np.ndarray, float, int, int]:
    """(h, w, 3) uint8 scaled to fit and centred on grey, the factor, and the upper left corner."""
    (height, width), (h, w) = rgb.shape[:2], hw
    scale = min(w / width, h / height)
    inner = max(1, round(width * scale)), max(1, round(height * scale))
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    image = rgb if scale == 1.0 else cv2.resize(rgb, inner, interpolation=how)
    top, left = (h - inner[1]) // 2, (w - inner[0]) // 2
    if (h, w) != image.shape[:2]:
        bottom, right = h - inner[1] - top, w - inner[0] - left
        frame = (cv2.BORDER_CONSTANT, None, (pad, pad, pad))
        image = cv2.copyMakeBorder(image, top, bottom, left, right, *frame)
    return image, scale, top, left


def as_input(
    marks: Sequence[Mark], scale: float, top: int, left: int, hw: tuple[int, int]
) -> np.ndarray:
    """Marks as the network takes them, (1, MAX_MARKS, MARK_FIELDS) float32; see `MarksCard`."""
    out = np.zeros((1, MAX_MARKS, MARK_FIELDS), np.float32)
    for row, mark in zip(out[0], marks, strict=False):
        u = ((mark.u_px + 0.5) * scale + left) / hw[1]
        v = ((mark.v_px + 0.5) * scale + top) / hw[0]
        row[:] = u, v, mark.bearing_rad, mark.distance_m, 1.0
    return out


def open_mark_scorer(card: MarksCard, config: ChoiceOnnx) -> MarkScorer:
    """The scorer of a card.

    Raises:
        ModelError: a model is missing or unusable.
        PromptError: there is no text encoder.
    """
    text = open_text_encoder(load_card_of(TextCard, card.text_encoder), None)
    return MarkScorer(card, text, config.providers, config.threads, config.device_id)
