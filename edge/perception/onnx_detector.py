"""Open-vocabulary detection with an ONNX model (YOLO-World) in onnxruntime."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from edge import config, names
from edge.host import resources
from edge.perception import kernels
from edge.perception.backends.binding import Bound, bind
from edge.perception.backends.engines import EngineOptions
from edge.perception.backends.runtime import (
    TENSORRT_PROVIDERS,
    failing_as,
    open_session,
)
from edge.perception.card_types import ImageCard
from edge.perception.cards import (
    DetectCard,
    ModelError,
    expected_sha256,
    load_detector_card,
    verify_model,
)
from edge.perception.detector import Health, Tell, check_rgb, log_progress
from edge.perception.encoders import make_text_encoder
from edge.perception.text import PromptError, check_prompts, words_for
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

INPUTS = ("images", "txt_feats")
OUTPUTS = ("boxes", "scores")
USUAL_COLUMNS, MAX_COLUMNS = 16, 256
"""Prompts, background counted in, that a TensorRT engine is tuned for and can take."""


def engine_options(
    card: DetectCard | ImageCard,
    detector: config.DetectorOnnx,
    progress: Tell = log_progress,
) -> EngineOptions:
    """What TensorRT is told of a model; only a detector's number of prompts may change."""
    shapes = {}
    if isinstance(card, DetectCard):
        few, usual, many = ((1, n, card.text_dim) for n in (1, USUAL_COLUMNS, MAX_COLUMNS))
        shapes["txt_feats"] = (few, usual, many)
    cache = None if detector.engine_cache is None else resources.expand(detector.engine_cache)
    return EngineOptions(card.name, card.precision, shapes, cache, progress, expected_sha256(card))


@dataclass(frozen=True, slots=True)
class _Asked:
    """The prompts of one moment with all buffers bound for them; swapped whole."""

    prompts: tuple[str, ...]
    text: np.ndarray
    competes: np.ndarray
    anchor: np.ndarray
    label: np.ndarray
    score: np.ndarray
    bound: Bound | None


@dataclass(frozen=True, slots=True)
class _Placement:
    """Where an image of some size comes to lie in the network's input."""

    width_px: int
    height_px: int
    scale: float
    top: int
    left: int
    resized: np.ndarray | None


class OnnxDetector:
    """Every buffer is made once; an image costs one resize, one run and two kernels.

    Each prompt has its own boxes, also where another scores higher: whoever weighs what a thing
    is over many images needs to hear of the losers too. Background prompts
    (`config.background`) have none. The best score of any other prompt, background or not, on the
    place of a box is its `Detections.rival`; a prompt that is a kind of the other (sofa bed, bed)
    does not compete.

    Attributes:
        invalid_boxes: how many were dropped since they are not finite.
        stages_ns: what filling the input, the session and picking boxes took at the last image.
    """

    def __init__(
        self,
        detector: config.DetectorOnnx,
        prompts: Sequence[str],
        progress: Tell = log_progress,
    ) -> None:
        """
        Args:
            progress: told while a TensorRT engine is built, which takes minutes.

        Raises:
            ModelError: card, file or providers are unusable.
            PromptError: see `make_text_encoder`, `TextEncoder.embed`.
        """
        self.config = detector
        self.card = load_detector_card(detector.model)
        self.name = self.card.name
        self.invalid_boxes = 0
        self.stages_ns = (0, 0, 0)
        self._text = make_text_encoder(self.card, detector.vocabulary)
        self._background = self._known_background()
        height, width = self.card.input.height, self.card.input.width
        self._images = np.empty((1, 3, height, width), np.float32)
        self._place = _Placement(0, 0, 1.0, 0, 0, None)
        self._scale = np.float32(self.card.preprocess.scale)
        self._session = open_session(
            verify_model(self.card, believe_cache=True),
            detector.providers,
            detector.threads,
            detector.device_id,
            engine_options(self.card, detector, progress),
        )
        self._anchors = self._count_anchors()
        self._top = np.empty(self._anchors, np.float32)
        self._keep = np.empty(detector.max_detections, np.int32)
        self._against = np.empty(detector.max_detections, np.float32)
        self._cut = np.empty(detector.max_detections, np.bool_)
        self._xyxy = np.empty((detector.max_detections, 4), np.float32)
        self.set_prompts(prompts)

    @property
    def prompts(self) -> tuple[str, ...]:
        return self._asked.prompts

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """See `Detector.set_prompts`."""
        with failing_as(f"model {self.name}: it cannot be given the prompts"):
            self._asked = self._ask(check_prompts(prompts))

    def _ask(self, prompts: tuple[str, ...]) -> _Asked:
        """Encode prompts and bind buffers for them, which may take memory of a GPU."""
        contrasts = (c for prompt in prompts for c in self._text.contrasts(prompt))
        others = dict.fromkeys((*self._background, *contrasts))
        columns = [*prompts, *(other for other in others if other not in prompts)]
        competes = self._competitors(prompts, columns)
        useful = competes.any(axis=(0, 1))
        useful[: len(prompts)] = True
        competes = np.ascontiguousarray(competes[:, :, useful])
        text = self._text.embed([c for c, kept in zip(columns, useful, strict=True) if kept])
        if text.shape[1] > MAX_COLUMNS and self._session.get_providers()[0] in TENSORRT_PROVIDERS:
            raise PromptError(
                f"{text.shape[1]} prompts, background and contrasts counted in: engines of "
                f"TensorRT are built for at most {MAX_COLUMNS}; name fewer"
            )
        bound = bind(
            self._session,
            dict(zip(INPUTS, (self._images, text), strict=True)),
            {"boxes": (1, self._anchors, 4), "scores": (1, self._anchors, text.shape[1])},
            live=("images",),
        )
        most = self._anchors * len(prompts)
        return _Asked(
            prompts, text, competes, np.empty(most, np.int32),
            np.empty(most, np.int32), np.empty(most, np.float32), bound,
        )  # fmt: skip

    def _known_background(self) -> tuple[str, ...]:
        """The configured background, made for any model, without what this one has no word for."""
        known = tuple(words_for(self.config.background, self._text.resolve))
        unknown = [repr(word) for word in self.config.background if word not in known]
        if unknown:
            log.warning(
                "model %s does not know %s of perception.detector.background: goes without",
                self.name, ", ".join(unknown),
            )  # fmt: skip
        return known

    def _competitors(self, prompts: Sequence[str], columns: Sequence[str]) -> np.ndarray:
        """(2, prompts, columns) bool: whether a column's word is another thing than the prompt's,
        where the thing is wholly in view and where the image cuts it off.

        A kind of the prompt's thing never is, unless it is what the prompt is not (another colour,
        another size as far as that can be seen); neither is its broader name between two prompts,
        nor for a prompt that has contrasts: a white chair is a chair, and what tells it from a red
        one is the contrast.
        """
        words = [(column, self._text.resolve(column)) for column in columns]

        def kind_of(i: int, j: int) -> bool:
            return any(names.is_kind_of(a, b) for a in words[i] for b in words[j])

        competes = np.ones((2, len(prompts), len(columns)), np.bool_)
        for row, prompt in enumerate(prompts):
            contrasts = set(self._text.contrasts(prompt))
            seen_in_part = set(self._text.contrasts(prompt, whole=False))
            for column in range(len(columns)):
                broader = (column < len(prompts) or contrasts) and kind_of(row, column)
                contrast = not contrasts.isdisjoint(words[column])
                unseen = contrast and seen_in_part.isdisjoint(words[column])
                competes[0, row, column] = contrast or not (kind_of(column, row) or broader)
                competes[1, row, column] = competes[0, row, column] and not unseen
        return competes

    def detect(self, observation: Observation) -> Detections:
        """See `Detector.detect`."""
        start_ns = time.perf_counter_ns()
        rgb, asked = check_rgb(observation), self._asked
        self._fill_input(rgb)
        filled_ns = time.perf_counter_ns()
        boxes, scores = asked.bound.run()
        ran_ns = time.perf_counter_ns()
        n = self._pick(asked, boxes[0], scores[0])
        kept = self._keep[:n]
        end_ns = time.perf_counter_ns()
        self.stages_ns = (filled_ns - start_ns, ran_ns - filled_ns, end_ns - ran_ns)
        return Detections(
            observation=observation,
            xyxy_px=self._xyxy[:n].copy(),
            score=asked.score[kept],
            class_id=asked.label[kept],
            prompts=asked.prompts,
            rival=self._against[:n].copy(),
            model=self.name,
            latency_ns=end_ns - start_ns,
        )

    def best_scores(self, rgb: np.ndarray) -> np.ndarray:
        """The highest score that each prompt has anywhere in an image, however low.

        Args:
            rgb: (h, w, 3) uint8.

        Returns:
            (n,) float32, NaN where the model says NaN.
        """
        asked = self._asked
        self._fill_input(np.ascontiguousarray(rgb))
        _, scores = asked.bound.run()
        return scores[0, :, : len(asked.prompts)].max(axis=0)

    def health(self) -> Health:
        """See `Detector.health`."""
        return Health()

    def close(self) -> None:
        """Let the session and its buffers go; no detect afterwards."""
        self._session = None
        self._asked = replace(self._asked, bound=None)

    def _count_anchors(self) -> int:
        """Boxes per image, from one run on an empty image (it also warms the session up)."""
        self._images.fill(self.card.preprocess.letterbox_pad * self._scale)
        text = np.zeros((1, 1, self.card.text_dim), np.float32)
        text[..., 0] = 1.0
        with failing_as(f"model {self.name}: it fails at its first image"):
            boxes, scores = self._session.run(
                list(OUTPUTS), {"images": self._images, "txt_feats": text}
            )
        anchors = boxes.shape[1] if boxes.ndim == 3 else 0
        if boxes.shape != (1, anchors, 4) or scores.shape != (1, anchors, 1):
            raise ModelError(
                f"{self.card.file}: boxes {boxes.shape} and scores {scores.shape} do not belong "
                "together, must be (1, a, 4) and (1, a, n): export it again"
            )
        return anchors

    def _fill_input(self, rgb: np.ndarray) -> None:
        height, width = rgb.shape[:2]
        if (width, height) != (self._place.width_px, self._place.height_px):
            self._place = self._placement(width, height)
            self._images.fill(self.card.preprocess.letterbox_pad * self._scale)
        place = self._place
        if place.resized is not None:
            size = (place.resized.shape[1], place.resized.shape[0])
            how = cv2.INTER_AREA if place.scale < 1.0 else cv2.INTER_LINEAR
            rgb = cv2.resize(rgb, size, dst=place.resized, interpolation=how)
        kernels.to_planes(rgb, self._scale, place.top, place.left, self._images[0])

    def _placement(self, width_px: int, height_px: int) -> _Placement:
        """Scaled to fit and centred, as in training."""
        h, w = self.card.input.height, self.card.input.width
        scale = min(w / width_px, h / height_px)
        new_w, new_h = max(1, round(width_px * scale)), max(1, round(height_px * scale))
        resized = None if scale == 1.0 else np.empty((new_h, new_w, 3), np.uint8)
        top, left = (h - new_h) // 2, (w - new_w) // 2
        return _Placement(width_px, height_px, scale, top, left, resized)

    def _pick(self, asked: _Asked, boxes: np.ndarray, scores: np.ndarray) -> int:
        """Boxes (a, 4) and scores (a, n) → `_keep`, `_xyxy`, `_against`; how many."""
        c, place, tau = self.config, self._place, np.float32(self.config.tau_vl)
        found, invalid = kernels.candidates(
            boxes, scores, len(asked.prompts), tau, asked.anchor, asked.label, asked.score,
            self._top,
        )  # fmt: skip
        if invalid:
            if not self.invalid_boxes:
                log.error(
                    "model %s: %d of %d boxes are not finite; dropped and counted",
                    self.name, invalid, self._anchors,
                )  # fmt: skip
            self.invalid_boxes += invalid
        n = kernels.suppress(
            boxes, asked.anchor, asked.label, asked.score, found, c.nms_iou, self._keep
        )
        n = kernels.to_image(
            boxes, asked.anchor, self._keep, n, place.scale, place.top, place.left,
            place.width_px, place.height_px, self._xyxy, self._cut,
        )  # fmt: skip
        kernels.strongest_rivals(
            boxes, scores, asked.competes, tau, self._top, asked.anchor, asked.label,
            self._keep, n, self._cut, c.nms_iou, self._against,
        )  # fmt: skip
        return n
