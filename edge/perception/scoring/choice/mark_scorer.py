"""Frontier selection by a small network: image, target and marks in, answers in (ViTL eq. 4 and 5).

The network sees no letters in the image. It gets the positions of the marks as numbers, since a
network of this size learns to use numbers sooner than to read letters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge.config import ChoiceOnnx
from edge.perception.embedding.encoders import open_text_encoder
from edge.perception.embedding.text import TextEncoder
from edge.perception.runtime.card_types import MARK_FIELDS, OTHERS_FIELDS, MarksCard, TextCard
from edge.perception.runtime.cards import load_card_of, verify_model
from edge.perception.runtime.deadline import FIRST_RUN_S, InferenceTimeout
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.letterbox import Fit, letterboxed
from edge.perception.runtime.model_file import ModelError
from edge.perception.runtime.sessions import open_onnxruntime_session
from edge.perception.scoring.choice.process import ProcessMarks
from edge.perception.scoring.choice.question import (
    MAX_MARKS,
    FrontierChoice,
    Mark,
    MarkCosts,
    MarkedView,
    choice_of,
)

FAR_M = 20.0
"""Largest path length that the network gets; longer paths and unreachable marks get this value."""


class MarkNetwork:
    """A network that chooses among marks, loaded from its card's file.

    Call `ask` from one thread at a time.

    Raises:
        ModelError: the model is missing or unusable, its first run fails, or the text encoder's
            embeddings have another length.
    """

    def __init__(
        self,
        card: MarksCard,
        text: TextEncoder,
        providers: Sequence[str],
        threads: int,
        device_id: int = 0,
    ) -> None:
        if text.dim != card.text_dim:
            raise ModelError(
                f"model {card.name}: needs text embeddings of length {card.text_dim}, but those of "
                f"{card.text_encoder} have {text.dim}: name another text_encoder in the card"
            )
        self.name, self._text = card.name, text
        self._scale, self._deadline = np.float32(card.preprocess.scale), InferenceTimeout(card.name)
        path = verify_model(card, believe_cache=True)
        engine = EngineOptions(card.name, card.precision, section="perception.choice")
        self._session = open_onnxruntime_session(path, providers, threads, device_id, engine)
        self._embeddings: dict[str, np.ndarray] = {}
        blank = np.zeros((card.input.height, card.input.width, 3), np.uint8)
        no_target = np.zeros((1, card.text_dim), np.float32)
        marks, others = np.ones((1, MARK_FIELDS), np.float32), np.ones(OTHERS_FIELDS, np.float32)
        self._run(blank, marks, others, no_target, FIRST_RUN_S)

    def ask(
        self, image: np.ndarray, marks: np.ndarray, others: np.ndarray, target: str, limit_s: float
    ) -> list[np.ndarray]:
        """Answer both questions about a view.

        Args:
            image: (h, w, 3) uint8 RGB of the card's size.
            marks: (n, MARK_FIELDS) float32, n from 1 to MAX_MARKS; see `MarksCard`.
            others: (OTHERS_FIELDS,) float32; see `MarksCard`.
            target: name of the object that the robot looks for.
            limit_s: longest time for the run.

        Returns:
            Two float32 arrays: (n + 1,), probabilities of the marks and of "elsewhere" (ViTL
            eq. 4), and (2,), probabilities of yes and no (eq. 5).

        Raises:
            PromptError: the text encoder does not know the target.
            ModelError: the network fails, takes too long, or returns values that are not finite.
        """
        return self._run(image, marks, others, self._embedding(target), limit_s)

    def close(self) -> None:
        """Abort the current run; may be called from another thread."""
        self._deadline.end()

    def _run(
        self, image: np.ndarray, marks: np.ndarray, others: np.ndarray, embedding: np.ndarray,
        limit_s: float,
    ) -> list[np.ndarray]:  # fmt: skip
        """Run the network; see `ask`. `embedding` is the target's, (1, dim) float32."""
        n, padded = len(marks), np.zeros((1, MAX_MARKS, MARK_FIELDS), np.float32)
        padded[0, :n] = marks
        planes = image.transpose(2, 0, 1)[None].astype(np.float32, order="C")
        planes *= self._scale
        feed = {"images": planes, "txt_feats": embedding, "marks": padded, "others": others[None]}
        with self._deadline.within(limit_s):
            options = self._deadline.options
            directions, scene = self._session.run(["directions", "scene"], feed, options)
        # Keep the logits of existing marks and of "elsewhere".
        logits = np.append(directions[0, :n], directions[0, MAX_MARKS])
        if not (np.isfinite(logits).all() and np.isfinite(scene).all()):
            raise ModelError(f"model {self.name}: returns logits that are not finite")
        # The scene has one logit: that of "yes" against "no".
        return [_softmax(logits), _softmax(np.array([scene[0, 0], 0.0]))]

    def _embedding(self, target: str) -> np.ndarray:
        """Return the target's embedding, (1, dim); each target is encoded once."""
        if target not in self._embeddings:
            self._embeddings[target] = self._text.embed([target])[0]
        return self._embeddings[target]


def _softmax(logits: np.ndarray) -> np.ndarray:
    """Return the softmax, (n,) float32."""
    p = np.exp(logits.astype(np.float64) - logits.max())
    return (p / p.sum()).astype(np.float32)


class MarkInput(NamedTuple):
    """Input of the network for a view.

    Attributes:
        view: the view that the input is made from.
        image: (h, w, 3) uint8, letterboxed.
        marks: (n, MARK_FIELDS) float32; see `MarksCard`.
        others: (OTHERS_FIELDS,) float32; see `MarksCard`.
    """

    view: MarkedView
    image: np.ndarray
    marks: np.ndarray
    others: np.ndarray


class MarkScorer:
    """A scorer (`edge.perception.worker`) of views, by a mark network.

    Attributes:
        name: name of the network's card.
    """

    def __init__(
        self, card: MarksCard, network: MarkNetwork | ProcessMarks, limit_s: float
    ) -> None:
        self.name, self._card = card.name, card
        self._network, self._limit_s = network, limit_s

    def prepare(self, view: MarkedView) -> MarkInput:
        """Prepare the network's input; the observation is not needed afterwards.

        Raises:
            ModelError: the observation has no image, or there is no map with paths to the marks.
        """
        rgb = view.observation.rgb
        if rgb is None or view.mark_costs is None:
            why = (
                f"observation {view.observation.seq} has no camera image"
                if rgb is None
                else "there is no map yet, so no paths to the directions to choose from"
            )
            raise ModelError(f"model {self.name}: cannot choose a direction: {why}")
        hw = (self._card.input.height, self._card.input.width)
        preprocess = self._card.preprocess
        image, fit = letterboxed(rgb, hw, preprocess.letterbox_pad, preprocess.letterbox_at)
        if image is rgb:  # the observation's array is not kept
            image = rgb.copy()
        rows = as_input(view.marks[:MAX_MARKS], view.mark_costs, fit, hw)
        return MarkInput(view, image, rows, view.mark_costs.others)

    def answer(self, prepared: MarkInput) -> FrontierChoice | None:
        """Get both answers at once; None if there is no mark to choose from.

        Raises:
            PromptError: the text encoder does not know the target.
            ModelError: the network gave no usable answer within the time limit; one line.
        """
        view, image, rows, others = prepared
        if not len(rows):
            return None
        p, scene = self._network.ask(image, rows, others, view.target, self._limit_s)
        return choice_of(view, view.marks[: len(rows)], p, float(scene[0]))

    def close(self) -> None:
        """Abort the current run; may be called from another thread."""
        self._network.close()


def as_input(marks: Sequence[Mark], costs: MarkCosts, fit: Fit, hw: tuple[int, int]) -> np.ndarray:
    """Return the marks as the network takes them, (n, MARK_FIELDS) float32; see `MarksCard`.

    Args:
        marks: n marks.
        costs: paths and gains of at least these marks.
        fit: place of the image in the letterbox.
        hw: height and width of the letterbox in pixels.
    """
    out = np.zeros((len(marks), MARK_FIELDS), np.float32)
    path_m = np.minimum(costs.path_m, FAR_M)
    for row, mark, path, gain in zip(out, marks, path_m, costs.gain_m2, strict=False):
        u = ((mark.u_px + 0.5) * fit.scale + fit.left) / hw[1]
        v = ((mark.v_px + 0.5) * fit.scale + fit.top) / hw[0]
        row[:] = u, v, mark.bearing_rad, mark.distance_m, path, gain, 1.0
    return out


def open_network(card: MarksCard, config: ChoiceOnnx) -> MarkNetwork:
    """Open the network of a card, ready to be asked.

    Raises:
        ModelError: a model is missing or unusable.
        PromptError: there is no text encoder.
    """
    text = open_text_encoder(load_card_of(TextCard, card.text_encoder), None)
    return MarkNetwork(card, text, config.providers, config.threads, config.device_id)


def check_size(card: MarksCard, config: ChoiceOnnx) -> None:
    """Raise ModelError if `max_image_px` is less than the network's image size."""
    longer = max(card.input.height, card.input.width)
    if longer > config.max_image_px:
        raise ModelError(
            f"perception.choice.max_image_px: {config.max_image_px}, but {card.name} needs "
            f"images of {card.input.width}x{card.input.height}: set at least {longer}"
        )
