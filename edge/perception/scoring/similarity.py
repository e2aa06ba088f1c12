"""Similarity of an entire image and a text: the score of VLFM.

VLFM is a policy that drives to frontiers whose view fits the target best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from edge.config import DetectorOnnx, PerceptionConfig
from edge.perception.detection.onnx import OnnxDetector, engine_options
from edge.perception.detection.remote import RemoteDetector
from edge.perception.embedding.clip import CPU, ClipImageEncoder, ClipTextEncoder
from edge.perception.embedding.encoders import open_text_encoder
from edge.perception.embedding.text import TextEncoder
from edge.perception.factory import open_detector
from edge.perception.runtime.card_types import RUNNING, ImageCard, SimilarityCard, TextCard
from edge.perception.runtime.cards import ModelError, load_card_of
from edge.types import Detections

THREADS = 2  # CPU threads of the image encoder, if the configuration has no detector of its own
SENTENCE = "Seems like there is a {} ahead."  # VLFM's, word for word


class SimilarityScorer(Protocol):
    """Scores texts against one image.

    Attributes:
        name: name of the scorer's card, or of the model whose scores it uses.
    """

    name: str

    def score(self, rgb: np.ndarray, prompts: Sequence[str]) -> np.ndarray:
        """Score each prompt; a higher score means that the image more likely leads to the object.

        The scale depends on the backend. A pair of encoders gives cosines in [-1, 1] (those of CLIP
        ViT-B/32 are between 0.15 and 0.35); a detector gives its best class score in [0, 1]. Only
        scores of one scorer and one prompt can be compared.

        Args:
            rgb: (h, w, 3) uint8.
            prompts: names of objects, at least one.

        Returns:
            (n,) float32, finite.

        Raises:
            PromptError: a prompt cannot be encoded.
            ModelError: the model fails, or its output is not finite.
        """
        ...

    def close(self) -> None: ...


class PairSimilarity:
    """The cosine between the embeddings of an image and a text, as VLFM uses BLIP-2.

    Raises:
        ModelError: the embeddings of the two encoders have different lengths.
    """

    def __init__(self, name: str, image: ClipImageEncoder, text: TextEncoder) -> None:
        if image.dim != text.dim:
            raise ModelError(
                f"model {name}: embeddings of the image encoder have length {image.dim}, those of "
                f"the text encoder {text.dim}: name two encoders of one family in the card"
            )
        self.name = name
        self._image, self._text = image, text
        self._prompts: tuple[str, ...] = ()
        self._rows = np.empty((0, text.dim), np.float32)

    def score(self, rgb: np.ndarray, prompts: Sequence[str]) -> np.ndarray:
        self.prepare(prompts)
        return self._rows @ self._image.embed(rgb)

    def prepare(self, prompts: Sequence[str]) -> None:
        """Encode the prompts, unless they are those of the last call."""
        if tuple(prompts) != self._prompts:
            self._rows = _embed_prompts(self._text, prompts)
            self._prompts = tuple(prompts)

    def close(self) -> None:
        """Abort a request to a server."""
        self._image.close()


def _embed_prompts(text: TextEncoder, prompts: Sequence[str]) -> np.ndarray:
    """Return the prompts' embeddings, (n, d).

    An encoder that reads sentences gets VLFM's sentence about each prompt, another gets the prompt.
    """
    if isinstance(text, ClipTextEncoder):
        return text.encode([SENTENCE.format(text.resolve(prompt)) for prompt in prompts])
    return text.embed(prompts)[0]


class DetectorSimilarity:
    """The best class score of a detector anywhere in the image.

    In the comparison of VL-Nav, VLFM used such scores of YOLO-World, since BLIP-2 is too slow for a
    robot.
    """

    def __init__(self, name: str, detector: OnnxDetector | RemoteDetector) -> None:
        self.name = name
        self._detector = detector

    def score(self, rgb: np.ndarray, prompts: Sequence[str]) -> np.ndarray:
        if tuple(prompts) != self._detector.prompts:
            self._detector.set_prompts(prompts)
        return self._detector.best_scores(rgb)

    def close(self) -> None:
        self._detector.close()


def max_score_per_prompt(detections: Detections) -> np.ndarray:
    """Return the best score of each prompt in existing detections; 0 if it is below `tau_vl`.

    Returns:
        (n,) float32 in [0, 1], one for each prompt.
    """
    best = np.zeros(len(detections.prompts), np.float32)
    np.maximum.at(best, detections.class_id, detections.score)
    return best


def is_running_detector(card: SimilarityCard, perception: PerceptionConfig) -> bool:
    """Return True if the scorer's detector is the running one, which then need not run twice."""
    running = perception.detector
    same = isinstance(running, DetectorOnnx) and running.model == card.detector
    return same or card.detector == RUNNING


def make_similarity(
    card: SimilarityCard, perception: PerceptionConfig, prompts: Sequence[str]
) -> SimilarityScorer:
    """Make the scorer of a card, with its own model sessions.

    Raises:
        ModelError: a model is missing or unusable.
        PromptError: there is no text encoder, or it does not know a prompt.
    """
    running = perception.detector if isinstance(perception.detector, DetectorOnnx) else None
    if card.detector is not None:
        assert card.detector != RUNNING, "the running detector needs no scorer"
        settings = running or DetectorOnnx()
        own = settings.model_copy(update={"model": card.detector, "background": ()})
        return DetectorSimilarity(card.name, open_detector(own, prompts))
    assert card.image_encoder is not None
    assert card.text_encoder is not None
    text = load_card_of(TextCard, card.text_encoder)
    vocabulary = running.vocabulary if running is not None else None
    settings = running or DetectorOnnx(providers=CPU, threads=THREADS)
    image_card = load_card_of(ImageCard, card.image_encoder)
    image = ClipImageEncoder(
        image_card,
        settings.providers,
        settings.threads,
        settings.device_id,
        engine_options(image_card, settings),
    )
    pair = PairSimilarity(card.name, image, open_text_encoder(text, vocabulary))
    pair.prepare(prompts)
    return pair


def similarity_card(perception: PerceptionConfig) -> SimilarityCard | None:
    """Return the card of the configured scorer, None if there is none.

    Raises:
        ModelError: there is no such card, or it is of another task.
    """
    if perception.similarity is None:
        return None
    try:
        return load_card_of(SimilarityCard, perception.similarity)
    except ModelError as error:
        raise ModelError(f"perception.similarity: {error}") from None
