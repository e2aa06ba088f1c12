"""Open-vocabulary perception as a pipeline of replaceable parts (OpenNav eq. 1).

The parts are tags → boxes → masks → captions. The paper uses RAM, Grounding DINO and TAP. Here the
words of a vocabulary are the tags, the configured detector and segmenter make boxes and masks, and
`edge.tasks.captions` composes the captions. Each part is a function.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge import config
from edge.perception.detection.detector import check_rgb
from edge.perception.detection.sim import TruthAt
from edge.perception.factory import make_detector
from edge.perception.masks.masker import make_masker
from edge.tasks.captions import compose_captions
from edge.types import Detections, Observation

TILE_FROM, TILE_OVERLAP, TILE_SAME = 1.5, 0.25, 0.6

Tags = Callable[[Observation], Sequence[str]]
Boxes = Callable[[Observation, Sequence[str]], Detections]
Masks = Callable[[Detections], Detections]
Captions = Callable[[Detections], Sequence[str]]
Embeddings = Callable[[Detections], np.ndarray]


class PerceptionPipeline(NamedTuple):
    """The parts of eq. 1.

    Attributes:
        tags: words to look for in a picture (RAM).
        boxes: boxes of these words (Grounding DINO).
        masks: pixels of the objects in the boxes (TAP); `boxes_as_masks` uses the whole boxes.
        captions: one caption per box (TAP).
        embeddings: (n, d) float32, one per box; None: no embeddings.
    """

    tags: Tags
    boxes: Boxes
    masks: Masks
    captions: Captions = compose_captions
    embeddings: Embeddings | None = None


class CaptionedDetections(NamedTuple):
    """Result of a pipeline for one picture; `caption` and `embedding` are parallel to the boxes."""

    found: Detections
    caption: tuple[str, ...]
    embedding: np.ndarray | None


def run_pipeline(chain: PerceptionPipeline, observation: Observation) -> CaptionedDetections:
    """Run the pipeline on a picture (OpenNav eq. 1).

    Raises:
        ValueError: the observation has no usable image, or a part returned a wrong number of
            results.
    """
    found = chain.masks(chain.boxes(observation, chain.tags(observation)))
    caption = tuple(chain.captions(found))
    embedding = None if chain.embeddings is None else chain.embeddings(found)
    for what, answers in (("captions", caption), ("embeddings", embedding)):
        if answers is not None and len(answers) != len(found):
            raise ValueError(f"{len(found)} boxes, but {len(answers)} {what}; expected as many")
    return CaptionedDetections(found, caption, embedding)


def boxes_as_masks(found: Detections) -> Detections:
    """Use each box as its own mask, without a segmenter."""
    return found


def in_tiles(boxes: Boxes, aspect: float = 4.0 / 3.0) -> Boxes:
    """Return a detector that also looks at the parts of a wide picture.

    Otherwise a detector with a narrow input would see a wide picture at a fraction of its size.
    Parts are as high as the picture and overlap by `TILE_OVERLAP`. Boxes of one word that cover
    each other by `TILE_SAME` of the smaller box are merged into one around both.

    Args:
        boxes: the detector.
        aspect: width over height of a part. A picture less than `TILE_FROM` times as wide is not
            cut.
    """

    def tiled(observation: Observation, tags: Sequence[str]) -> Detections:
        whole = boxes(observation, tags)
        rgb = check_rgb(observation)
        height, width = rgb.shape[:2]
        side = round(aspect * height)
        if width < TILE_FROM * side:
            return whole
        n = math.ceil((width - TILE_OVERLAP * side) / ((1.0 - TILE_OVERLAP) * side))
        parts = [whole]
        for left in np.linspace(0, width - side, n).round().astype(int):
            part = np.ascontiguousarray(rgb[:, left : left + side])
            found = boxes(replace(observation, rgb=part, camera=None, depth_m=None), tags)
            shift = np.array([left, 0, left, 0], np.float32)
            parts.append(replace(found, xyxy_px=found.xyxy_px + shift))
        return _united(whole, parts)

    return tiled


def _united(whole: Detections, parts: Sequence[Detections]) -> Detections:
    """Merge boxes of one object that were found in several parts of a picture."""
    xyxy, score, class_id = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("xyxy_px", "score", "class_id")
    )
    order = np.argsort(-score, kind="stable")
    kept: list[int] = []
    for i in order.tolist():
        same = next((k for k in kept if class_id[k] == class_id[i]
                     and _covered(xyxy[k], xyxy[i]) >= TILE_SAME), None)  # fmt: skip
        if same is None:
            kept.append(i)
        else:
            xyxy[same, :2] = np.minimum(xyxy[same, :2], xyxy[i, :2])
            xyxy[same, 2:] = np.maximum(xyxy[same, 2:], xyxy[i, 2:])
    return replace(
        whole, xyxy_px=xyxy[kept], score=score[kept], class_id=class_id[kept],
        competing_score=None, context=None, mask=None,
        latency_ns=sum(part.latency_ns for part in parts),
    )  # fmt: skip


def _covered(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of the smaller box that the other box covers."""
    both = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    least = min(np.prod(a[2:] - a[:2]), np.prod(b[2:] - b[:2]))
    return float(np.prod(both) / least) if both.min() > 0.0 and least > 0.0 else 0.0


def _with_context(found: Detections, around: Detections | None) -> Detections:
    """Add the boxes of the context, with its words after the prompts."""
    if around is None:
        return found
    score = np.concatenate((found.score, around.score))
    order = np.argsort(-score, kind="stable")
    return replace(
        found, xyxy_px=np.concatenate((found.xyxy_px, around.xyxy_px))[order], score=score[order],
        class_id=np.concatenate((found.class_id, around.class_id + len(found.prompts)))[order],
        prompts=(*found.prompts, *around.prompts), context=None,
    )  # fmt: skip


@contextmanager
def open_pipeline(
    perception: config.PerceptionConfig, words: Sequence[str], truth: TruthAt | None = None
) -> Iterator[PerceptionPipeline]:
    """Open the pipeline that a configuration describes, and close its models at the end.

    A box counts from the score `perception.tau_det` on, if no other word explains its place better.
    Words of the detector's `background` are detected too, except words that the model does not
    know.

    Args:
        perception: the settings of perception.
        words: the vocabulary; each picture is tagged with all of it.
        truth: see `edge.perception.factory.make_detector`.

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
