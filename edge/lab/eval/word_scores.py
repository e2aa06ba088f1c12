"""Scores from which on a detector's words can be relied on, measured in simulated worlds.

`edge eval words` looks at worlds from random poses, runs the detector for all words of a world, and
compares its boxes with the objects. A detector that takes chairs for armchairs at any score then
confirms no armchair.

An object counts for a word with its second best score over all images from near by, since one image
does not confirm it (`edge.perception.tracking.instances`).
"""

from __future__ import annotations

import argparse
import math
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np

from edge import names
from edge.config import Config, load
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
        scores: score of each object that has a box in two images.
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

    Args:
        ids: (h, w) uint16 object ids.
        depth_m: (h, w) float32.
        labels: canonical name of each object id.
        range_m: an object farther away is no view, and no box of it counts.
    """

    def __init__(
        self, ids: np.ndarray, depth_m: np.ndarray, labels: dict[int, str], range_m: float
    ) -> None:
        n = max(labels, default=0) + 1
        near, anywhere = (visible_boxes(ids, depth_m, m, n) for m in (range_m, math.inf))
        self._labels = labels
        self._shown = [id_ for id_ in labels if anywhere[id_, 4] >= _LEAST_PX]
        self._is_view = {id_: near[id_, 4] >= MIN_VIEW_PX for id_ in self._shown}
        self._is_near = {id_: near[id_, 4] > 0 for id_ in self._shown}
        self._boxes = anywhere[self._shown, :4]

    def detected(self, word: str, found: Detections) -> tuple[dict[int, float], int, int]:
        """Compare the boxes of a word with the objects.

        Returns:
            The best score of each near object that a box covers; boxes that cover none are left
            out. The number of views of the word, and how many of them a box covers.
        """
        covers_object = overlaps(found.xyxy_px, self._boxes)[0] >= _MIN_IOU  # by box and object
        best: dict[int, float] = {}
        for covers, score in zip(covers_object, found.score.tolist(), strict=True):
            covered = [self._shown[k] for k in np.flatnonzero(covers).tolist()]
            covered.sort(key=lambda id_: not names.is_kind_of(self._labels[id_], word))
            if covered and self._is_near[covered[0]]:
                best[covered[0]] = max(score, best.get(covered[0], 0.0))
        meant = [
            k for k, id_ in enumerate(self._shown)
            if self._is_view[id_] and names.is_kind_of(self._labels[id_], word)
        ]  # fmt: skip
        return best, len(meant), int(covers_object[:, meant].any(axis=0).sum())


def count_words(
    config: Config, world: World, detector: OnnxDetector, text: TextEncoder, poses: int, seed: int
) -> dict[str, WordCount]:
    """Count the objects that the detector takes for each word of a world.

    Args:
        config: camera, ranges and least score.
        world: the world.
        detector: looks for all words at once, but they compete only as in a search for one.
        text: encoder of the detector's words. Names that it does not know are left out.
        poses: number of images.
        seed: of the poses.
    """
    rig, range_m = CameraRig(config, world), config.perception.confirm_range_m
    labels = {item.id: names.canonical(item.label) for item in world.objects}
    known = words_for(sorted(set(labels.values())), text.resolve)
    words = [name for name, word in known.items() if names.same_name(name, word)]
    if not words:
        return {}
    detector.set_prompts(words, independent=True)
    counts = {word: WordCount() for word in words}
    scores: dict[tuple[str, int], list[float]] = defaultdict(list)  # one per image
    for number, pose in enumerate(free_poses(world, poses, seed, config.robot.radius_m)):
        rig.look(pose)
        image = LabelledImage(rig.ids, rig.depth_m, labels, range_m)
        seen = rig.observation(number, number, np.eye(4))  # a detector needs no pose
        found = detector.detect(seen).without_suppressed()
        found = found.above(config.perception.tau_det)
        for row, word in enumerate(words):
            best, views, seen = image.detected(word, found.only(found.class_id == row))
            counts[word].views += views
            counts[word].seen += seen
            for id_, score in best.items():
                scores[word, id_].append(score)
    for (word, id_), at in scores.items():
        if len(at) < 2:
            continue
        count, is_right = counts[word], names.is_kind_of(labels[id_], word)
        count.scores.append(sorted(at)[-2])
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
