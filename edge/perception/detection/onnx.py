"""Open-vocabulary detection with an ONNX model (YOLO-World) in onnxruntime.

The network returns one box for each anchor, which is a place and size in its input.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from edge import config
from edge.host import resources
from edge.perception.detection import kernels
from edge.perception.detection.detector import check_rgb
from edge.perception.detection.text_classes import TextClasses, text_classes_for
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import PromptError, TextEncoder, check_prompts, words_for
from edge.perception.runtime.binding import BoundSession, bind
from edge.perception.runtime.card_types import ImageCard
from edge.perception.runtime.cards import (
    DetectCard,
    ModelError,
    load_detector_card,
    verify_model,
)
from edge.perception.runtime.engines import EngineOptions
from edge.perception.runtime.health import WHY_INVALID, ModelHealth, ProgressCallback, log_progress
from edge.perception.runtime.letterbox import Fit, fit_into, scaled
from edge.perception.runtime.sessions import TENSORRT_PROVIDERS, open_session, raise_as_model_error
from edge.types import ContextBoxes, Detections, Observation

log = logging.getLogger(__name__)

INPUTS = ("images", "txt_feats")
OUTPUTS = ("boxes", "scores")
NMS_IOU = 0.5  # overlap above which the box with the lower score is suppressed
MAX_DETECTIONS = 64  # boxes of targets, and boxes of the context
# Numbers of texts (`TextClasses`): prompts, synonyms, background words and contrasts (such as the
# prompt with another colour) all count.
USUAL_TEXTS = 16  # a TensorRT engine is tuned for this number
MAX_TEXTS = 256  # a TensorRT engine takes at most this number


def engine_options(
    card: DetectCard | ImageCard,
    detector: config.DetectorOnnx,
    progress: ProgressCallback = log_progress,
) -> EngineOptions:
    """Return the TensorRT options of a model.

    All shapes are fixed, except that a detector's number of texts may change.
    """
    shapes = {}
    if isinstance(card, DetectCard):
        few, usual, many = ((1, n, card.text_dim) for n in (1, USUAL_TEXTS, MAX_TEXTS))
        shapes["txt_feats"] = (few, usual, many)
    cache = None if detector.engine_cache is None else resources.expand(detector.engine_cache)
    return EngineOptions(card.name, card.precision, shapes, cache, progress)


def far_px(card: DetectCard) -> float:
    """Return the largest valid distance of a box corner from the origin, in pixels of the input.

    YOLO's boxes reach past a small input: at most 15 cells of 32 pixels from their anchor.
    """
    return 16.0 * max(card.input.height, card.input.width)


@dataclass(frozen=True, slots=True)
class _PromptSet:
    """The current prompts and all buffers that are bound for them; replaced at once.

    Attributes:
        prompts: names of the objects to look for.
        class_scores: (anchors, classes) float32, buffer for the score of each class.
        anchor, label, score: (anchors * (prompts + context),), see `kernels.candidates`.
        bound: the session with its inputs and outputs; None after `close`.
    """

    prompts: tuple[str, ...]
    classes: TextClasses
    class_scores: np.ndarray
    anchor: np.ndarray
    label: np.ndarray
    score: np.ndarray
    bound: BoundSession | None


class _BoxBuffer(NamedTuple):
    """Candidates after suppression.

    Attributes:
        selected: (n,) int32, index of the candidate.
        xyxy_px: (n, 4) float32, box in the image.
        cut: (n,) bool, True if the image border cuts the object off.
    """

    selected: np.ndarray
    xyxy_px: np.ndarray
    cut: np.ndarray

    @classmethod
    def empty(cls, n: int) -> _BoxBuffer:
        """Allocate a buffer for `n` boxes."""
        return cls(np.empty(n, np.int32), np.empty((n, 4), np.float32), np.empty(n, np.bool_))


class OnnxDetector:
    """An open-vocabulary detector that runs an ONNX model.

    All buffers are allocated once. An image costs one resize, one run and a few kernels.

    Each prompt keeps its own boxes, even if another prompt scores higher at the same place, because
    the trackers need the weaker scores, too. Background words (`config.background`) are the
    context. Of context boxes that overlap, only the one with the best score is kept. The
    `Detections.competing_score` of a box is the best score of a competing class at its place. Words
    for the same object (chair, armchair) do not compete. An object is looked for under all names
    that the text encoder has for it; see `TextClasses`.

    Args:
        detector: configuration: card, providers, background words and more.
        prompts: names of the objects to look for.
        progress: called while a TensorRT engine is built, which takes minutes.
        session: session of the network; None: open the card's model.
        text: encoder of prompts; None: open the card's encoder.

    Attributes:
        invalid_boxes: number of boxes dropped as invalid (`WHY_INVALID`).
        stages_ns: time of the last image for filling the input, for the session, and for selecting
            boxes.

    Raises:
        ModelError: card, file or providers are unusable.
        PromptError: see `make_text_encoder` and `TextEncoder.embed`.

    Example:
        >>> from edge.config import DetectorOnnx
        >>> detector = OnnxDetector(DetectorOnnx(model="mini-house-256x320-int8-cpu"), ["chair"])
        >>> detector.best_scores(np.zeros((480, 640, 3), np.uint8)).shape
        (1,)
    """

    def __init__(
        self,
        detector: config.DetectorOnnx,
        prompts: Sequence[str],
        progress: ProgressCallback = log_progress,
        session: Any = None,
        text: TextEncoder | None = None,
    ) -> None:
        self.config = detector
        self.card = load_detector_card(detector.model)
        self.name = self.card.name
        self.invalid_boxes = 0
        self.stages_ns = (0, 0, 0)
        self._text = text or make_text_encoder(self.card, detector.vocabulary)
        self._background = self._known_background()
        height, width = self.card.input.height, self.card.input.width
        self._images = np.empty((1, 3, height, width), np.float32)
        self._fit = Fit((0, 0), 1.0, (0, 0), 0, 0)  # of no image yet
        self._scaled = np.empty((0, 0, 3), np.uint8)  # buffer for the scaled image
        self._scale = np.float32(self.card.preprocess.scale)
        self._session = session or open_session(
            verify_model(self.card, believe_cache=True),
            detector.providers,
            detector.threads,
            detector.device_id,
            engine_options(self.card, detector, progress),
        )
        self._anchor_best = np.empty(self._count_anchors(), np.float32)  # see `kernels.candidates`
        self._competing_score = np.empty(MAX_DETECTIONS, np.float32)
        self._target_boxes, self._context_boxes = (
            _BoxBuffer.empty(MAX_DETECTIONS) for _ in range(2)
        )
        self.set_prompts(prompts)

    @property
    def prompts(self) -> tuple[str, ...]:
        return self._prompt_set.prompts

    def set_prompts(self, prompts: Sequence[str], independent: bool = False) -> None:
        """See `Detector.set_prompts`; `independent`: see `text_classes_for`."""
        with raise_as_model_error(f"model {self.name}: it cannot be given the prompts"):
            self._prompt_set = self._encode_prompts(check_prompts(prompts), independent)

    def _encode_prompts(self, prompts: tuple[str, ...], independent: bool) -> _PromptSet:
        """Encode prompts and bind buffers for them, which may take GPU memory."""
        classes = text_classes_for(prompts, self._background, self._text, independent)
        embeddings = self._text.embed(classes.words)
        anchors, texts = len(self._anchor_best), embeddings.shape[1]
        if texts > MAX_TEXTS and self._session.get_providers()[0] in TENSORRT_PROVIDERS:
            raise PromptError(
                f"{texts} text classes (prompts, synonyms, background and contrast words), "
                f"but TensorRT engines are built for at most {MAX_TEXTS}: search for fewer "
                "objects, or name fewer background words"
            )
        bound = bind(
            self._session,
            dict(zip(INPUTS, (self._images, embeddings), strict=True)),
            {"boxes": (1, anchors, 4), "scores": (1, anchors, texts)},
            live=("images",),
        )
        n = anchors * (len(prompts) + len(classes.context))
        return _PromptSet(
            prompts, classes, np.empty((anchors, classes.n_classes), np.float32),
            np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.float32), bound,
        )  # fmt: skip

    def _known_background(self) -> tuple[str, ...]:
        """Return the configured background words that this model's text encoder knows."""
        known = tuple(words_for(self.config.background, self._text.resolve))
        unknown = [repr(word) for word in self.config.background if word not in known]
        if unknown:
            log.warning(
                "model %s: perception.detector.background: words that the model does not know are "
                "ignored: %s",
                self.name, ", ".join(unknown),
            )  # fmt: skip
        return known

    def detect(self, observation: Observation) -> Detections:
        start_ns = time.perf_counter_ns()
        rgb, prompt_set = check_rgb(observation), self._prompt_set
        self._fill_input(rgb)
        filled_ns = time.perf_counter_ns()
        boxes, scores = prompt_set.bound.run()
        ran_ns = time.perf_counter_ns()
        targets, context = self._select_boxes(prompt_set, boxes[0], scores[0])
        end_ns = time.perf_counter_ns()
        self.stages_ns = (filled_ns - start_ns, ran_ns - filled_ns, end_ns - ran_ns)
        target_rows, context_rows = targets.selected, context.selected
        return Detections(
            observation=observation,
            xyxy_px=targets.xyxy_px.copy(),
            score=prompt_set.score[target_rows],
            class_id=prompt_set.label[target_rows],
            prompts=prompt_set.prompts,
            competing_score=self._competing_score[: len(target_rows)].copy(),
            context=ContextBoxes(
                context.xyxy_px.copy(),
                prompt_set.score[context_rows],
                prompt_set.label[context_rows] - np.int32(len(prompt_set.prompts)),
                prompt_set.classes.context,
            ),
            model=self.name,
            latency_ns=end_ns - start_ns,
        )

    def best_scores(self, rgb: np.ndarray) -> np.ndarray:
        """Return the highest score of each prompt anywhere in an image, however low.

        Args:
            rgb: (h, w, 3) uint8.

        Returns:
            (n,) float32 in 0 to 1.

        Raises:
            ModelError: the model returns invalid boxes or scores.
        """
        prompt_set = self._prompt_set
        self._fill_input(np.ascontiguousarray(rgb))
        boxes, scores = prompt_set.bound.run()
        kernels.best_per_class(scores[0], prompt_set.classes.class_of_text, prompt_set.class_scores)
        if invalid := kernels.count_invalid(boxes[0], prompt_set.class_scores, far_px(self.card)):
            raise ModelError(f"model {self.name}: {invalid} boxes are {WHY_INVALID}")
        return prompt_set.class_scores[:, : len(prompt_set.prompts)].max(axis=0)

    def health(self) -> ModelHealth:
        return ModelHealth()

    def close(self) -> None:
        """Release the session and its buffers; do not call `detect` afterwards."""
        self._session = None
        self._prompt_set = replace(self._prompt_set, bound=None)

    def _count_anchors(self) -> int:
        """Return the number of boxes that the network returns, from a run on an empty image.

        The run also warms up the session.
        """
        self._images.fill(self.card.preprocess.letterbox_pad * self._scale)
        embedding = np.zeros((1, 1, self.card.text_dim), np.float32)
        embedding[..., 0] = 1.0
        with raise_as_model_error(f"model {self.name}: it fails at its first image"):
            boxes, scores = self._session.run(
                list(OUTPUTS), {"images": self._images, "txt_feats": embedding}
            )
        anchors = boxes.shape[1] if boxes.ndim == 3 else 0
        most = self.card.input.height * self.card.input.width  # all get buffers
        if boxes.shape != (1, anchors, 4) or scores.shape != (1, anchors, 1) or anchors > most:
            raise ModelError(
                f"{self.card.file or self.name}: boxes have the shape {boxes.shape} and scores "
                f"{scores.shape}, must be (1, a, 4) and (1, a, n), a at most {most}: export the "
                "model again"
            )
        return anchors

    def _fill_input(self, rgb: np.ndarray) -> None:
        """Scale the image and write it into the network's input."""
        if rgb.shape[:2] != self._fit.image_hw:
            preprocess, hw = self.card.preprocess, self._images.shape[2:]
            self._fit = fit_into(rgb.shape[:2], hw, preprocess.letterbox_at)
            self._scaled = np.empty((*self._fit.hw, 3), np.uint8)
            self._images.fill(preprocess.letterbox_pad * self._scale)
        fit = self._fit
        rgb = scaled(rgb, fit, self._scaled)
        kernels.to_planes(rgb, self._scale, fit.top, fit.left, self._images[0])

    def _select_boxes(
        self, prompt_set: _PromptSet, boxes: np.ndarray, scores: np.ndarray
    ) -> tuple[_BoxBuffer, _BoxBuffer]:
        """Return the boxes of targets and of the context.

        The scores that compete with the targets go to `_competing_score`.

        Args:
            prompt_set: the current prompts.
            boxes: (a, 4) float32.
            scores: (a, texts) float32.
        """
        tau, targets = np.float32(self.config.tau_vl), len(prompt_set.prompts)
        named = targets + len(prompt_set.classes.context)
        kernels.best_per_class(scores, prompt_set.classes.class_of_text, prompt_set.class_scores)
        found, invalid = kernels.candidates(
            boxes, prompt_set.class_scores, named, tau, far_px(self.card), prompt_set.anchor,
            prompt_set.label, prompt_set.score, self._anchor_best,
        )  # fmt: skip
        if invalid:
            if not self.invalid_boxes:
                log.error(
                    "model %s: %d of %d boxes are %s: dropped (further ones are only counted)",
                    self.name, invalid, len(self._anchor_best), WHY_INVALID,
                )  # fmt: skip
            self.invalid_boxes += invalid
        kept = self._suppress(prompt_set, boxes, found, (0, targets), self._target_boxes)
        kernels.competing_scores(
            boxes, prompt_set.class_scores, prompt_set.classes.competes, tau, self._anchor_best,
            prompt_set.anchor, prompt_set.label, kept.selected, len(kept.selected), kept.cut,
            NMS_IOU, self._competing_score,
        )  # fmt: skip
        context = self._suppress(prompt_set, boxes, found, (targets, named), self._context_boxes)
        return kept, context

    def _suppress(
        self,
        prompt_set: _PromptSet,
        boxes: np.ndarray,
        found: int,
        labels: tuple[int, int],
        out: _BoxBuffer,
    ) -> _BoxBuffer:
        """Suppress the candidates with a label in a range, and map the others to the image.

        Args:
            prompt_set: the current prompts.
            boxes: (a, 4) float32.
            found: number of candidates.
            labels: first label of the range, and one past the last.
            out: buffer for the result.

        Returns:
            Views of `out`.
        """
        # A place in the context has one word; targets keep the boxes of all prompts.
        fit, one_word = self._fit, labels[0] > 0
        n = kernels.suppress(
            boxes, prompt_set.anchor, prompt_set.label, prompt_set.score, found, *labels, one_word,
            NMS_IOU, out.selected,
        )  # fmt: skip
        n = kernels.to_image(
            boxes, prompt_set.anchor, out.selected, n, fit.scale, fit.top, fit.left,
            fit.image_hw[1], fit.image_hw[0], out.xyxy_px, out.cut,
        )  # fmt: skip
        return _BoxBuffer(*(array[:n] for array in out))
