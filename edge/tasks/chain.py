"""Open-vocabulary perception as a chain of parts that can each be replaced (OpenNav eq. 1).

Tags → boxes → masks → captions: the paper has RAM, Grounding DINO and TAP. Here a vocabulary's
words are the tags, the configured detector and segmenter make boxes and masks, and captions are
composed (`edge.tasks.captions`). A part is a function; a chain holds one of each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np

from edge import config
from edge.perception.factory import make_detector
from edge.perception.masks.masker import make_masker
from edge.perception.sim_detector import TruthAt
from edge.tasks.captions import composed
from edge.types import Detections, Observation

Tags = Callable[[Observation], Sequence[str]]
Boxes = Callable[[Observation, Sequence[str]], Detections]
Masks = Callable[[Detections], Detections]
Captions = Callable[[Detections], Sequence[str]]
Embeddings = Callable[[Detections], np.ndarray]


class Chain(NamedTuple):
    """The parts of eq. 1.

    Attributes:
        tags: what to look for in a picture (RAM).
        boxes: where that is (GD).
        masks: which pixels of the boxes are the things' (TAP); `boxes_alone`: the boxes.
        captions: what is said of each box (TAP).
        embeddings: (n, d) float32, one a box; None: there are none.
    """

    tags: Tags
    boxes: Boxes
    masks: Masks
    captions: Captions = composed
    embeddings: Embeddings | None = None


class Seen(NamedTuple):
    """What a chain makes of a picture: `caption` and `embedding` are parallel to the boxes."""

    found: Detections
    caption: tuple[str, ...]
    embedding: np.ndarray | None


def see(chain: Chain, observation: Observation) -> Seen:
    """Masks and captions of what a picture shows (OpenNav eq. 1).

    Raises:
        ValueError: the observation has no usable image, or a part answers for another number of
            boxes than it was given.
    """
    found = chain.masks(chain.boxes(observation, chain.tags(observation)))
    caption = tuple(chain.captions(found))
    embedding = None if chain.embeddings is None else chain.embeddings(found)
    for what, answers in (("captions", caption), ("embeddings", embedding)):
        if answers is not None and len(answers) != len(found):
            raise ValueError(f"{len(found)} boxes, but {len(answers)} {what}")
    return Seen(found, caption, embedding)


def boxes_alone(found: Detections) -> Detections:
    """No segmenter: each box is its own mask."""
    return found


@contextmanager
def open_chain(
    perception: config.Perception, words: Sequence[str], truth: TruthAt | None = None
) -> Iterator[Chain]:
    """The chain of what a configuration names, closed at the end.

    Boxes count from `perception.tau_det`, where no other word explains their place better.

    Args:
        words: the vocabulary; each picture is tagged with all of it.
        truth: see `edge.perception.factory.make_detector`.

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
            return detector.detect(observation).without_rivals().above(perception.tau_det)

        yield Chain(
            lambda observation: tuple(words), boxes, boxes_alone if masker is None else masker.add
        )
