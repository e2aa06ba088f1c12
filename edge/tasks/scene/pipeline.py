"""Open-vocabulary perception as a pipeline of replaceable parts (OpenNav eq. 1).

The parts are tags → boxes → masks → captions. The paper uses RAM, Grounding DINO and TAP. Here the
words of a vocabulary are the tags, the configured detector and segmenter make boxes and masks, and
`edge.tasks.scene.captions` composes the captions. `SceneBuilder` uses the pipeline.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from edge import config
from edge.perception.detection.detector import check_rgb
from edge.perception.detection.sim import TruthAt
from edge.perception.factory import make_detector
from edge.perception.masks.masker import make_masker
from edge.tasks.scene.captions import compose_captions
from edge.types import Detections, Observation

# A wide picture is cut into parts (`in_tiles`) if it is this many times as wide as a part.
TILE_FROM = 1.5
TILE_OVERLAP = 0.25  # share of a part's width that neighbours have in common
TILE_MERGE_SHARE = 0.6  # share of the smaller box from which two boxes are merged

# The parts of a `PerceptionPipeline`.
Tags = Callable[[Observation], Sequence[str]]
Boxes = Callable[[Observation, Sequence[str]], Detections]
Masks = Callable[[Detections], Detections]
Captions = Callable[[Detections], Sequence[str]]


class GroundKinds(Protocol):
    """Names the kind of ground in each pixel (`edge.perception.masks.ground.GroundClassifier`)."""

    kinds: tuple[str, ...]

    def classify(self, rgb: np.ndarray) -> np.ndarray:
        """Return (h, w) uint8: index into `kinds` plus 1; 0: no ground."""
        ...


class PerceptionPipeline(NamedTuple):
    """The parts of the pipeline of OpenNav eq. 1, each a function.

    Attributes:
        tags: words to look for in a picture (RAM).
        boxes: boxes of these words (Grounding DINO).
        masks: pixels of the objects in the boxes (TAP); `boxes_as_masks` uses the entire boxes.
        captions: one caption per box (TAP).
        ground: kinds of ground in a picture; None: all ground is of one kind.
    """

    tags: Tags
    boxes: Boxes
    masks: Masks
    captions: Captions = compose_captions
    ground: GroundKinds | None = None


class CaptionedDetections(NamedTuple):
    """Result of a pipeline for one picture.

    Attributes:
        found: n boxes, with their masks if there is a segmenter.
        caption: one for each box.
    """

    found: Detections
    caption: tuple[str, ...]


def run_pipeline(pipeline: PerceptionPipeline, observation: Observation) -> CaptionedDetections:
    """Run the pipeline on a picture (OpenNav eq. 1).

    Raises:
        ValueError: the observation has no usable image, or a part returned a wrong number of
            results.
    """
    found = pipeline.masks(pipeline.boxes(observation, pipeline.tags(observation)))
    caption = tuple(pipeline.captions(found))
    if len(caption) != len(found):
        raise ValueError(f"{len(found)} boxes, but {len(caption)} captions; expected one a box")
    return CaptionedDetections(found, caption)


def boxes_as_masks(found: Detections) -> Detections:
    """Use each box as its own mask, without a segmenter."""
    return found


def in_tiles(boxes: Boxes, aspect: float = 4.0 / 3.0) -> Boxes:
    """Return a detector that also looks at the parts of a wide picture.

    Otherwise a detector with a narrow input would see a wide picture at a fraction of its size.
    Parts are as high as the picture and overlap by `TILE_OVERLAP`. Boxes of one word that cover
    each other by `TILE_MERGE_SHARE` of the smaller box are merged into one around both.

    Args:
        boxes: the detector.
        aspect: width over height of a part. A picture less than `TILE_FROM` times as wide is not
            cut.
    """

    def detect_in_tiles(observation: Observation, tags: Sequence[str]) -> Detections:
        on_full = boxes(observation, tags)
        rgb = check_rgb(observation)
        height, width = rgb.shape[:2]
        side = round(aspect * height)
        if width < TILE_FROM * side:
            return on_full
        n = math.ceil((width - TILE_OVERLAP * side) / ((1.0 - TILE_OVERLAP) * side))
        parts = [on_full]
        for left in np.linspace(0, width - side, n).round().astype(int):
            part = np.ascontiguousarray(rgb[:, left : left + side])
            found = boxes(replace(observation, rgb=part, camera=None, depth_m=None), tags)
            shift = np.array([left, 0, left, 0], np.float32)
            parts.append(replace(found, xyxy_px=found.xyxy_px + shift))
        return _merge_boxes(on_full, parts)

    return detect_in_tiles


def _merge_boxes(on_full: Detections, parts: Sequence[Detections]) -> Detections:
    """Merge boxes of one object that were found in several parts of a picture."""
    xyxy, score, class_id = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("xyxy_px", "score", "class_id")
    )
    order = np.argsort(-score, kind="stable")
    kept: list[int] = []
    for i in order.tolist():
        same = next((k for k in kept if class_id[k] == class_id[i]
                     and _overlap_share(xyxy[k], xyxy[i]) >= TILE_MERGE_SHARE), None)  # fmt: skip
        if same is None:
            kept.append(i)
        else:
            xyxy[same, :2] = np.minimum(xyxy[same, :2], xyxy[i, :2])
            xyxy[same, 2:] = np.maximum(xyxy[same, 2:], xyxy[i, 2:])
    return replace(
        on_full, xyxy_px=xyxy[kept], score=score[kept], class_id=class_id[kept],
        competing_score=None, context=None, mask=None,
        latency_ns=sum(part.latency_ns for part in parts),
    )  # fmt: skip


def _overlap_share(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of the smaller box that the other box covers."""
    overlap = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    smaller = min(np.prod(a[2:] - a[:2]), np.prod(b[2:] - b[:2]))
    return float(np.prod(overlap) / smaller) if overlap.min() > 0.0 and smaller > 0.0 else 0.0


def _with_context(found: Detections, context: Detections | None) -> Detections:
    """Add the boxes of the context, with its words after the prompts."""
    if context is None:
        return found
    score = np.concatenate((found.score, context.score))
    order = np.argsort(-score, kind="stable")
    return replace(
        found, xyxy_px=np.concatenate((found.xyxy_px, context.xyxy_px))[order], score=score[order],
        class_id=np.concatenate((found.class_id, context.class_id + len(found.prompts)))[order],
        prompts=(*found.prompts, *context.prompts), context=None,
    )  # fmt: skip


@contextmanager
def open_pipeline(
    perception: config.PerceptionConfig, words: Sequence[str], truth: TruthAt | None = None
) -> Iterator[PerceptionPipeline]:
    """Open the pipeline that a configuration describes, and close its models at the end.

    A box counts from the score `perception.tau_det` on, if no other word explains its place better.
    Words of the detector's `background` are detected too, except words that the model does not
    know.

    Yields:
        The pipeline.

    Raises:
        PromptError: a word cannot be looked for.
        ModelError: a model cannot be loaded.
    """
    with ExitStack() as stack:
        detector = make_detector(perception, words, truth=truth)
        stack.callback(detector.close)
        masker = make_masker(perception, timed=False)
        if masker is not None:
            stack.callback(masker.close)

        def boxes(observation: Observation, tags: Sequence[str]) -> Detections:
            if tuple(tags) != detector.prompts:
                detector.set_prompts(tags)
            found = detector.detect(observation)
            return _with_context(found.without_suppressed(), found.context_detections()).above(
                perception.tau_det
            )

        yield PerceptionPipeline(
            lambda observation: tuple(words),
            in_tiles(boxes),
            boxes_as_masks if masker is None else masker.add,
        )
