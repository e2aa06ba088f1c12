"""Scores from which on a detector's words can be relied on, measured in simulated worlds.

`edge eval words` looks at worlds from random poses, runs the detector for all words of a world, and
compares its boxes with the objects. A detector that takes chairs for armchairs at any score then
confirms no armchair.

An object counts for a word if the robot would confirm it from these images: `confirm_lead` and
`confirm_mean` hold (`edge.perception.tracking.fusion`). It counts with its second best score, since
one image does not confirm it.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np

from edge import names
from edge.config import Config, PerceptionConfig, load
from edge.errors import UserError
from edge.geometry import overlaps
from edge.lab.eval import world_list
from edge.lab.eval.recall import MIN_VIEW_PX, visible_boxes
from edge.lab.sim.base import World, free_poses
from edge.lab.sim.sensors import CameraRig
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import TextEncoder, words_for
from edge.perception.runtime.cards import load_detector_card
from edge.text import format_table
from edge.types import Detections

NEVER = 1.0
"""Score for a word whose detections are too often wrong at any score, or that are rare."""
MIN_RECALL = 0.25
"""Least share of views with a box. Below it, a search passes the object, and then look-alikes."""
PRIOR_OBJECTS = 4
"""A word's share of right objects counts as if it had this many more, of the share of all words."""
_MIN_IOU = 0.5
_LEAST_PX = 30  # an object with fewer visible pixels cannot be what a box shows
_STEP = 0.05


@dataclass
class WordCount:
    """The objects that the detector takes for a word.

    Attributes:
        views: number of views of such an object or of a kind of it.
        seen: number of these views that have a box.
        scores: score of each object that the robot would confirm.
        right: for each of them, True if the object has this name or is a kind of it.
        mistaken: names of the others.
    """

    views: int = 0
    seen: int = 0
    scores: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    mistaken: Counter[str] = field(default_factory=Counter)

    def add(self, other: WordCount) -> None:
        """Add the objects of other worlds."""
        self.views += other.views
        self.seen += other.seen
        self.scores += other.scores
        self.right += other.right
        self.mistaken += other.mistaken

    def n_right(self, score: float) -> tuple[int, int]:
        """Return how many objects have at least this score and are right, and how many have it."""
        kept = [right for at, right in zip(self.scores, self.right, strict=True) if at >= score]
        return sum(kept), len(kept)


def score_for(count: WordCount, everything: WordCount, precision: float, least: float) -> float:
    """Return the lowest score at which enough objects of a word are right.

    Few objects say little, so the share is drawn to that of all words: `PRIOR_OBJECTS`.

    Returns:
        `least`, or more by a multiple of 0.05; `NEVER` if no score is high enough, or if the recall
        is below `MIN_RECALL`.

    Example:
        >>> found = WordCount(40, 40, [0.4] * 5 + [0.8] * 40, [False] * 5 + [True] * 40)
        >>> score_for(found, found, 0.95, 0.3)
        0.45
        >>> score_for(WordCount(), WordCount(), 0.95, 0.3)
        1.0
    """
    if count.seen < MIN_RECALL * count.views:
        return NEVER
    for score in np.arange(least, 0.95 + 1e-9, _STEP).round(2).tolist():
        right, n = count.n_right(score)
        all_right, all_n = everything.n_right(score)
        typical = all_right / all_n if all_n else 0.0
        if right + PRIOR_OBJECTS * typical >= precision * (n + PRIOR_OBJECTS):
            return score
    return NEVER


class LabelledImage:
    """The objects that one image of a world shows.

    `labels` has the canonical name of each object id. An object farther away than `range_m` is no
    view, and no box of it counts.

    Attributes:
        is_view: object id → True if enough of it is visible from near by.
    """

    def __init__(
        self, ids: np.ndarray, depth_m: np.ndarray, labels: dict[int, str], range_m: float
    ) -> None:
        n = max(labels, default=0) + 1
        near, anywhere = (visible_boxes(ids, depth_m, m, n) for m in (range_m, math.inf))
        self._ids, self._labels = ids, labels
        self._shown = [id_ for id_ in labels if anywhere[id_, 4] >= _LEAST_PX]
        self.is_view = {id_: near[id_, 4] >= MIN_VIEW_PX for id_ in self._shown}
        self._is_near = {id_: near[id_, 4] > 0 for id_ in self._shown}
        self._boxes = anywhere[self._shown, :4]

    def shown(self, word: str, found: Detections) -> dict[int, int]:
        """Return the row of the best box of each near object that boxes of a word show.

        A box shows an object that it covers, or else the object with the most pixels in it: a
        search also stops at the end of a bed that looks like a chair.
        """
        covers_object = self._covers(found)
        best: dict[int, int] = {}
        for row in np.argsort(-found.score, kind="stable").tolist():
            covered = [self._shown[k] for k in np.flatnonzero(covers_object[row]).tolist()]
            covered.sort(key=lambda id_: not names.is_kind_of(self._labels[id_], word))
            shown = covered[0] if covered else self._most_visible(found.xyxy_px[row])
            if self._is_near.get(shown):
                best.setdefault(shown, row)
        return best

    def views(self, word: str, found: Detections) -> tuple[int, int]:
        """Return the number of views of a word, and how many of them a box covers."""
        meant = [
            k for k, id_ in enumerate(self._shown)
            if self.is_view[id_] and names.is_kind_of(self._labels[id_], word)
        ]  # fmt: skip
        return len(meant), int(self._covers(found)[:, meant].any(axis=0).sum())

    def _covers(self, found: Detections) -> np.ndarray:
        """Return (boxes, objects) bool: True if the box covers the object."""
        return overlaps(found.xyxy_px, self._boxes)[0] >= _MIN_IOU

    def _most_visible(self, xyxy_px: np.ndarray) -> int:
        """Return the id of the object with the most pixels in a box; 0 if more show none."""
        x0, y0, x1, y1 = np.maximum(xyxy_px, 0).round().astype(int).tolist()
        inside = self._ids[y0:y1, x0:x1]
        return int(np.bincount(inside.ravel()).argmax()) if inside.size else 0


@dataclass
class ObjectEvidence:
    """The best boxes of a word at one object, at most one in an image.

    Attributes:
        good: scores of boxes with no competing class ahead.
        target_sum: sum of all scores.
        competing_sum: sum of the scores of the best competing classes.
    """

    good: list[float] = field(default_factory=list)
    target_sum: float = 0.0
    competing_sum: float = 0.0

    @property
    def score(self) -> float:
        """Second best good score; 0.0 if there is none."""
        return sorted(self.good)[-2] if len(self.good) > 1 else 0.0

    def add(self, boxes: Detections, row: int) -> None:
        """Add a box of one image."""
        self.target_sum += float(boxes.score[row])
        if boxes.competing_score is not None:
            self.competing_sum += float(boxes.competing_score[row])
        if boxes.not_suppressed()[row]:
            self.good.append(float(boxes.score[row]))

    def confirms(self, views: int, c: PerceptionConfig) -> bool:
        """Return True if the robot would confirm the object, if the word's score allowed it."""
        return (
            self.score > c.tau_det
            and self.target_sum >= c.confirm_lead * self.competing_sum
            and self.target_sum >= c.confirm_mean * views
        )


def count_words(
    config: Config, world: World, detector: OnnxDetector, text: TextEncoder, poses: int, seed: int
) -> dict[str, WordCount]:
    """Count the objects that the detector takes for each word of a world, in `poses` images.

    It looks for all words at once, but they compete only as in a search for one. Names that the
    text encoder does not know are left out.
    """
    rig, range_m = CameraRig(config, world), config.perception.confirm_range_m
    labels = {item.id: names.canonical(item.label) for item in world.objects}
    known = words_for(sorted(set(labels.values())), text.resolve)
    words = [name for name, word in known.items() if names.same_name(name, word)]
    if not words:
        return {}
    detector.set_prompts(words, independent=True)
    counts = {word: WordCount() for word in words}
    objects: dict[tuple[str, int], ObjectEvidence] = defaultdict(ObjectEvidence)
    views: Counter[int] = Counter()  # by object
    for number, pose in enumerate(free_poses(world, poses, seed, config.robot.radius_m)):
        rig.look(pose)
        image = LabelledImage(rig.ids, rig.depth_m, labels, range_m)
        views.update(id_ for id_, is_view in image.is_view.items() if is_view)
        found = detector.detect(rig.observation(number, number, np.eye(4)))  # it needs no pose
        for row, word in enumerate(words):
            boxes = found.only(found.class_id == row)
            strong = boxes.without_suppressed().above(config.perception.tau_det)
            n_views, seen = image.views(word, strong)
            counts[word].views += n_views
            counts[word].seen += seen
            for id_, best in image.shown(word, boxes).items():
                objects[word, id_].add(boxes, best)
    for (word, id_), evidence in objects.items():
        if not evidence.confirms(views[id_], config.perception):
            continue
        count, is_right = counts[word], names.is_kind_of(labels[id_], word)
        count.scores.append(evidence.score)
        count.right.append(is_right)
        if not is_right:
            count.mistaken[labels[id_]] += 1
    return counts


def run(args: argparse.Namespace) -> int:
    """Run `edge eval words`; see `edge.cli.eval_parsers`."""
    config = load(args.config)
    if config.perception.detector.kind != "onnx":
        raise UserError(
            f"{config.locate('perception.detector.kind')}: got "
            f"{config.perception.detector.kind}; `edge eval words` measures a detector of kind onnx"
        )
    chosen = config.perception.detector
    text = make_text_encoder(load_detector_card(chosen.model), chosen.vocabulary)
    detector = OnnxDetector(chosen, ["chair"], text=text)
    counts: dict[str, WordCount] = defaultdict(WordCount)
    for house, world in world_list.worlds(config, args.worlds):
        for word, more in count_words(house, world, detector, text, args.poses, args.seed).items():
            counts[word].add(more)
    print(_table(counts, args.precision, config.perception.tau_det))
    return 0


def _table(counts: dict[str, WordCount], precision: float, least: float) -> str:
    """Return a table of the words, most views first, and the lines for the configuration."""
    everything = WordCount()
    for count in counts.values():
        everything.add(count)
    default = score_for(WordCount(), everything, precision, least)
    rows, lines = [("word", "views", "recall", "right", "score", "mistaken for it")], []
    for word, count in sorted(counts.items(), key=lambda item: (-item[1].views, item[0])):
        score = score_for(count, everything, precision, least)
        mistaken = ", ".join(f"{name} {k}" for name, k in count.mistaken.most_common(3))
        recall = f"{count.seen / count.views:.2f}" if count.views else "–"
        right = f"{sum(count.right)}/{len(count.right)}"
        rows.append((word, str(count.views), recall, right, f"{score:g}", mistaken))
        if score != default:
            lines.append(f"    {word}: {score:g}")
    default_line = f"  confirm_score: {default:g}"
    return "\n".join(
        [format_table(rows), "", "perception:", default_line, "  confirm_scores:", *sorted(lines)]
    )
