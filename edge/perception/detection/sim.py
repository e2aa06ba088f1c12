"""A detector for simulated worlds: ground-truth boxes with noise, without a network."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge import config, names
from edge.perception.detection import kernels
from edge.perception.embedding.text import PromptError, check_prompts
from edge.perception.runtime.health import ModelHealth
from edge.types import ContextBoxes, Detections, Observation

MIN_VISIBLE_PX = 40
"""An object with fewer visible pixels is not detected."""
_FULL_VIEW = 0.02
"""Share of the image above which an object's size no longer lowers its score."""
_MAX_JITTER = 0.05
"""Largest error of a box edge, as a share of the box's side."""


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """Ground-truth object ids of an image.

    Attributes:
        ids: (h, w) uint16, 0 = no object.
        labels: label of id i at index i - 1.
    """

    ids: np.ndarray
    labels: tuple[str, ...]


TruthAt = Callable[[Observation], "Segmentation | None"]
"""Returns the segmentation of an observation's image, or None if there is none.

Called on the detector's thread.
"""


class _Roles(NamedTuple):
    """Classes of a world's objects for some prompts.

    Attributes:
        prompts: names of the objects to look for.
        classes: class of object i at index i: the index of a prompt, or `len(prompts)` plus the
            index of a word, or -1 for an object that is not looked for.
    """

    prompts: tuple[str, ...]
    words: tuple[str, ...]
    classes: tuple[int, ...]


class _NoisyBox(NamedTuple):
    """A box that the detector reports.

    Attributes:
        score: score in (0, 1].
        class_id: see `_Roles.classes`.
        xyxy_px: (4,) float32.
    """

    score: float
    class_id: int
    xyxy_px: np.ndarray


class SimDetector:
    """A detector (`Detector`) that puts imperfect boxes around the visible pixels of known objects.

    The score falls with the distance and with smaller size in the image, and has Gaussian noise.
    Objects are missed (`miss_rate` near by, three times that at `max_range_m`), and sometimes
    another object is taken for a target (`false_positive_rate`). A prompt means the objects of that
    exact name (a dog bed); if the world has none, the objects of its noun (a bed). All other
    objects of the world are context, unless `config.background` lists the context. Context objects
    are detected and missed in the same way. A context object that is taken for a target is not
    reported as itself in that image. Noise depends on `config.seed` and `observation.seq` only, so
    a run replays the same.

    Args:
        prompts: names of the objects to look for.
        truth: returns the ground truth of an image; None: there is no ground truth, and `detect`
            raises.

    Raises:
        PromptError: there is no prompt, or a prompt is empty.

    Example:
        >>> truth = Segmentation(np.ones((48, 64), np.uint16), ("chair",))
        >>> detector = SimDetector(config.DetectorSim(), ["chair"], lambda seen: truth)
        >>> depth_m = np.full((48, 64), 2.0, np.float32)
        >>> found = detector.detect(Observation(0, 0, np.eye(4), depth_m=depth_m))
        >>> len(found), found.prompts
        (1, ('chair',))
    """

    name = "sim (ground-truth ids + noise, no neural network)"
    invalid_boxes = 0
    looks_at = "depth_m"

    def __init__(
        self, detector: config.DetectorSim, prompts: Sequence[str], truth: TruthAt | None = None
    ) -> None:
        self.config = detector
        self._truth = truth
        # The world's objects: labels, and canonical names in order and as a set.
        self._labels: tuple[str, ...] = ()
        self._names: tuple[str, ...] = ()
        self._present: set[str] = set()
        self._roles = _Roles((), (), ())
        self._resize(0)
        self.set_prompts(prompts)

    @property
    def prompts(self) -> tuple[str, ...]:
        return self._prompts_and_nouns[0]

    def set_prompts(self, prompts: Sequence[str]) -> None:
        prompts = check_prompts(prompts)
        try:
            nouns = tuple(_noun(prompt) for prompt in prompts)
        except names.NotANameError as error:
            raise PromptError(f"prompt: {error}; give a name such as 'chair'") from None
        self._prompts_and_nouns = (prompts, nouns)

    def detect(self, observation: Observation) -> Detections:
        """See `Detector.detect`; needs depth and a segmentation of the same shape."""
        start_ns = time.perf_counter_ns()
        truth = self._truth(observation) if self._truth is not None else None
        depth = observation.depth_m
        if truth is None or depth is None or truth.ids.shape != depth.shape or depth.size == 0:
            raise ValueError(
                f"observation {observation.seq}: no segmentation with a depth image of the same "
                "size; only the simulator sends both: for a real camera set "
                "perception.detector.kind: onnx"
            )
        ids = truth.ids
        if truth.labels != self._labels:
            self._set_labels(truth.labels)
        kernels.object_boxes(ids, depth, self._box, self._pixels, self._distance)
        prompts, nouns = self._prompts_and_nouns
        if self._roles.prompts != prompts:
            self._roles = self._assign_roles(prompts, nouns)
        roles = self._roles
        found = self._detect_with_noise(observation.seq, roles, ids.shape)
        found.sort(key=lambda box: -box.score)
        xyxy_px = np.array([box.xyxy_px for box in found], np.float32).reshape(-1, 4)
        score = np.array([box.score for box in found], np.float32)
        class_id = np.array([box.class_id for box in found], np.int32)
        is_target, is_context = class_id < len(prompts), class_id >= len(prompts)
        return Detections(
            observation=observation,
            xyxy_px=xyxy_px[is_target],
            score=score[is_target],
            class_id=class_id[is_target],
            prompts=prompts,
            context=ContextBoxes(
                xyxy_px[is_context],
                score[is_context],
                class_id[is_context] - np.int32(len(prompts)),
                roles.words,
            ),
            model=self.name,
            latency_ns=time.perf_counter_ns() - start_ns,
        )

    def health(self) -> ModelHealth:
        return ModelHealth()

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _set_labels(self, labels: tuple[str, ...]) -> None:
        """Prepare for other objects, given by their labels in the simulator."""
        self._labels = labels
        self._names = tuple(names.canonical(label) for label in labels)
        self._present = set(self._names)
        self._roles = _Roles((), (), ())
        self._resize(len(labels))

    def _resize(self, n: int) -> None:
        """Allocate the buffers for `n` objects; see `kernels.object_boxes`."""
        self._box = np.empty((n, 4), np.int32)
        self._pixels = np.empty(n, np.int32)
        self._distance = np.empty(n, np.float32)

    def _assign_roles(self, prompts: tuple[str, ...], nouns: tuple[str, ...]) -> _Roles:
        """Return the class of each object for these prompts."""
        exact = [names.canonical(prompt) for prompt in prompts]
        wanted = tuple(e if e in self._present else n for e, n in zip(exact, nouns, strict=True))
        background = self.config.background
        if background is None:
            context = sorted(self._present)
        else:
            context = [names.canonical(word) for word in background]
        words = names.non_targets(context, (*wanted, *prompts))
        class_of = {word: len(prompts) + i for i, word in enumerate(words)}
        for i in reversed(range(len(wanted))):  # the first of two prompts for one object wins
            class_of[wanted[i]] = i
        return _Roles(prompts, words, tuple(class_of.get(name, -1) for name in self._names))

    def _detect_with_noise(
        self, seq: int, roles: _Roles, image_hw: tuple[int, int]
    ) -> list[_NoisyBox]:
        """Return the box of every reported object, unsorted."""
        c, targets = self.config, len(roles.prompts)
        random = np.random.default_rng((c.seed, seq))
        h, w = image_hw
        found: list[_NoisyBox] = []
        for i in np.flatnonzero(self._pixels >= MIN_VISIBLE_PX):
            # Draw for every visible object, so that prompts do not change each other's noise.
            missed, mistaken, noise, edges = (
                random.random(), random.random(), random.normal(), random.uniform(-1, 1, 4),
            )  # fmt: skip
            distance = float(self._distance[i])
            if not 0.0 < distance <= c.max_range_m:
                continue
            far = distance / c.max_range_m
            # An object at the largest distance has 60 % of the quality of one near by.
            quality = (1.0 - 0.4 * far) * min(
                1.0, math.sqrt(self._pixels[i] / (_FULL_VIEW * (h * w)))
            )
            class_id = roles.classes[i]
            # Another object is taken for a target; its random number also chooses which target.
            if not 0 <= class_id < targets and mistaken < c.false_positive_rate:
                class_id, quality = int(mistaken * 1e6) % targets, 0.5 * quality
            elif class_id < 0 or missed < c.miss_rate * (1.0 + 2.0 * far):
                continue
            score = min(1.0, max(0.0, 0.9 * quality + c.score_noise * noise))
            if score >= c.tau_vl and score > 0.0:
                found.append(_NoisyBox(score, class_id, _jitter(self._box[i], edges, w, h)))
        return found


def _noun(prompt: str) -> str:
    """Return the canonical name of a prompt's object.

    The name is that of the prompt's longest ending that is known, else of the entire head phrase.
    """
    phrase = names.head_phrase(prompt)
    if names.is_known(prompt):
        return names.canonical(prompt)
    known = (noun for noun in names.head_nouns(phrase) if names.is_known(noun))
    return names.canonical(next(known, phrase))


def _jitter(box: np.ndarray, edges: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the box with its edges moved by noise in [-1, 1] times `_MAX_JITTER`, (4,) float32."""
    size = np.array([box[2] - box[0], box[3] - box[1]] * 2)
    moved = box + edges * _MAX_JITTER * size
    limit = np.array([width, height] * 2)
    return np.clip(moved, 0, limit).astype(np.float32)
