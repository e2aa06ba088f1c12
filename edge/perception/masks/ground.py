"""Kinds of ground in a picture, by a model that names the class of each pixel.

Networks for the classes of Cityscapes (SegFormer, PP-LiteSeg, DDRNet, …) give scores of each class,
or the number of the best class.
"""

from __future__ import annotations

import cv2
import numpy as np

from edge import config
from edge.perception.runtime.card_types import GroundCard
from edge.perception.runtime.cards import ModelError, load_card_of, verify_model
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.sessions import open_onnxruntime_session, raise_as_model_error
from edge.text import one_line

_LONGEST_ERROR = 300  # characters


class GroundClassifier:
    """Names the kind of ground in each pixel of a picture.

    Attributes:
        name: the model's card.
        settings: the settings that it was made from.
        n_done: number of pictures that were classified.
        failed: number of pictures for which the network failed.
        last_error: the newest error, one line; empty if there was none.

    Raises:
        ModelError: card, file or providers are unusable.
    """

    def __init__(self, settings: config.OnnxModel) -> None:
        self.settings, self.last_error = settings, ""
        self._card = card = load_card_of(GroundCard, settings.model)
        self.name, self.kinds = card.name, tuple(dict.fromkeys(card.ground.values()))
        self._session = open_onnxruntime_session(
            verify_model(card, believe_cache=True), settings.providers, settings.threads,
            settings.device_id, EngineOptions(card.name, card.precision, section="tasks.ground"),
        )  # fmt: skip
        self._input = self._session.get_inputs()[0].name
        # By class: index into `kinds` plus 1; 0: no ground.
        self._kind_of = np.array(
            [self.kinds.index(card.ground[c]) + 1 if c in card.ground else 0 for c in card.classes],
            np.uint8,
        )
        with raise_as_model_error(f"model {self.name}: it fails at its first image"):
            self._run(np.zeros((32, 32, 3), np.uint8))
        self.n_done = self.failed = 0

    def classify(self, rgb: np.ndarray) -> np.ndarray:
        """Return (h, w) uint8 for a picture (h, w, 3) uint8: index into `kinds` plus 1; 0: none.

        Raises:
            ModelError: the output does not fit the card.
        """
        try:
            kind = self._run(rgb)
        except Exception as error:
            self.failed, self.last_error = self.failed + 1, one_line(error, _LONGEST_ERROR)
            raise
        self.n_done += 1
        return kind

    def status(self) -> dict[str, object]:
        """Return counts for the status message, JSON-ready."""
        return {
            "model": self.name, "made": self.n_done, "failed": self.failed,
            "last_error": self.last_error,
        }  # fmt: skip

    def _run(self, rgb: np.ndarray) -> np.ndarray:
        (out, *_) = self._session.run(None, {self._input: pixels_of(rgb, self._card)})
        kind = self._kind_of[class_map(out, self._card)]
        return cv2.resize(kind, rgb.shape[1::-1], interpolation=cv2.INTER_NEAREST)


def make_ground_classifier(tasks: config.TasksConfig) -> GroundClassifier | None:
    """Make the classifier that the configuration asks for; None: it asks for none.

    Raises:
        ModelError: see `GroundClassifier`.
    """
    return None if tasks.ground is None else GroundClassifier(tasks.ground)


def pixels_of(rgb: np.ndarray, card: GroundCard) -> np.ndarray:
    """Return the network's input for a picture, stretched to its size: (1, 3, h, w) float32."""
    size, how = (card.input.width, card.input.height), card.preprocess
    scaled = cv2.resize(rgb, size, interpolation=cv2.INTER_LINEAR).astype(np.float32)
    normalised = (scaled * how.scale - np.float32(how.mean)) / np.float32(how.std)
    return np.ascontiguousarray(normalised.transpose(2, 0, 1)[None], np.float32)


def class_map(out: np.ndarray, card: GroundCard) -> np.ndarray:
    """Return the class of each pixel, (rows, columns) integers, from a network's output.

    Raises:
        ModelError: the output does not fit the card.
    """
    n = len(card.classes)
    if out.ndim == 4 and out.shape[:2] == (1, n) and np.isfinite(out).all():
        return np.argmax(out[0], axis=0)
    if out.ndim in (3, 4) and out.shape[0] == 1 and np.issubdtype(out.dtype, np.integer):
        found = out.reshape(-1, *out.shape[-2:])
        if len(found) == 1 and found.min() >= 0 and found.max() < n:
            return found[0]
    raise ModelError(
        f"{card.path}: output {out.shape} of {out.dtype}; must be finite scores (1, {n}, "
        f"rows, columns) or classes (1, rows, columns) from 0 to {n - 1}: correct `classes` in the "
        "card, or export the model again"
    )
