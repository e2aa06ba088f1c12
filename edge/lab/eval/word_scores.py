"""Scores from which on a detector's words can be relied on, measured in simulated worlds.

`edge eval words` looks at worlds from random poses, runs the detector for each word that an image
shows, and compares its boxes with the objects. A detector that takes chairs for armchairs at any
score then confirms no armchair, and a trash can only at a high score.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from edge import names
from edge.config import Config, load, parse
from edge.errors import UserError
from edge.lab.eval import world_list
from edge.lab.eval.arms import Data, data_of, merged
from edge.lab.eval.recall import MIN_VIEW_PX, iou, visible_boxes
from edge.lab.sim.base import World, free_poses
from edge.lab.sim.sensors import CameraRig
from edge.perception.detection.detector import Detector
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import TextEncoder, words_for
from edge.perception.factory import make_detector
from edge.perception.runtime.cards import load_detector_card
from edge.text import format_table
from edge.types import Detections, Observation

NEVER = 1.0
"""Score for a word whose detections are too often wrong at any score."""
MIN_DETECTIONS = 8
"""A word with fewer detections gets no score."""
_MIN_IOU = 0.5
_LEAST_PX = 30  # an object with fewer visible pixels cannot be what a box shows
_STEP = 0.05


@dataclass
class WordCount:
    """The detections of a word.

    Attributes:
        views: number of views of such an object or of a kind of it.
        seen: number of these views that have a box.
        scores: score of each box that covers an object.
        right: for each of them, True if the object has this name or is a kind of it.
        mistaken: names of the other objects that were taken for it.
    """

    views: int = 0
    seen: int = 0
    scores: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    mistaken: Counter[str] = field(default_factory=Counter)

    def add(self, other: WordCount) -> None:
        """Add the detections of other images."""
        self.views += other.views
        self.seen += other.seen
        self.scores += other.scores
        self.right += other.right
        self.mistaken += other.mistaken


def score_for(count: WordCount, precision: float, default: float) -> float | None:
    """Return the lowest score at which enough detections of a word are right.

    Args:
        count: the word's detections.
        precision: wanted share of right detections.
        default: lowest score to return; no detection is weaker.

    Returns:
        A multiple of 0.05 over `default`; `NEVER` if no score is high enough; None if there are
        fewer than `MIN_DETECTIONS`.

    Example:
        >>> found = WordCount(20, 20, [0.4] * 5 + [0.8] * 20, [False] * 5 + [True] * 20)
        >>> score_for(found, 0.95, 0.3)
        0.45
        >>> score_for(WordCount(), 0.95, 0.3)
    """
    scores, right = np.array(count.scores), np.array(count.right, bool)
    if len(scores) < MIN_DETECTIONS:
        return None
    for score in np.arange(default, 0.95 + 1e-9, _STEP).round(2).tolist():
        kept = right[scores >= score]
        if len(kept) >= MIN_DETECTIONS and kept.mean() >= precision:
            return score
    return NEVER


class LabelledImage:
    """The objects that one image of a world shows.

    Args:
        ids: (h, w) uint16 object ids.
        depth_m: (h, w) float32.
        labels: canonical name of each object id.
        range_m: an object farther away is no view.

    Attributes:
        words: names of the objects in view.
    """

    def __init__(
        self, ids: np.ndarray, depth_m: np.ndarray, labels: dict[int, str], range_m: float
    ) -> None:
        near, anywhere = np.zeros((2, max(labels, default=0) + 1, 5), np.int64)
        visible_boxes(ids, depth_m, range_m, near)
        visible_boxes(ids, depth_m, np.inf, anywhere)
        shown = [id_ for id_ in labels if anywhere[id_, 4] >= _LEAST_PX]
        self._is_view = [near[id_, 4] >= MIN_VIEW_PX for id_ in shown]
        self._boxes = anywhere[shown, :4].astype(float)
        self._labels = [labels[id_] for id_ in shown]
        self.words = {label for label, view in self._shown() if view}

    def _shown(self) -> Iterator[tuple[str, bool]]:
        """Yield the name of each object in the image, and True if it is in view."""
        return zip(self._labels, self._is_view, strict=True)

    def count(self, word: str, found: Detections) -> WordCount:
        """Compare the detections of a word with the objects; boxes that cover none are left out."""
        is_meant = np.array(
            [v and names.is_kind_of(label, word) for label, v in self._shown()], bool
        )
        boxes = found.xyxy_px.astype(float)
        has_box = (iou(self._boxes, boxes) >= _MIN_IOU).any(axis=1)
        count = WordCount(int(is_meant.sum()), int((is_meant & has_box).sum()))
        for box, score in zip(boxes, found.score.tolist(), strict=True):
            overlaps = iou(box[None], self._boxes)[0]
            covered = [self._labels[k] for k in np.flatnonzero(overlaps >= _MIN_IOU).tolist()]
            if not covered:
                continue
            is_right = any(names.is_kind_of(label, word) for label in covered)
            count.scores.append(score)
            count.right.append(is_right)
            if not is_right:
                count.mistaken[self._labels[int(overlaps.argmax())]] += 1
        return count


def count_words(
    config: Config, world: World, detector: Detector, text: TextEncoder, poses: int, seed: int
) -> Iterator[tuple[str, WordCount]]:
    """Yield the counts of each word that an image of a world shows.

    Args:
        config: camera and ranges.
        world: the world.
        detector: looks for one word at a time, as in a search.
        text: encoder of the detector's words; words that it does not know are left out.
        poses: number of images.
        seed: of the poses.
    """
    rig = CameraRig(config, world)
    labels = {item.id: names.canonical(item.label) for item in world.objects}
    range_m = config.perception.back_projection_max_range_m
    for number, pose in enumerate(free_poses(world, poses, seed, config.robot.radius_m)):
        rig.look(pose)
        image = LabelledImage(rig.ids, rig.depth_m, labels, range_m)
        for word in words_for(sorted(image.words), text.resolve):
            detector.set_prompts([word])
            found = detector.detect(_observation(rig, number)).without_suppressed()
            yield word, image.count(word, found.above(config.perception.confirm_score))


def _observation(rig: CameraRig, number: int) -> Observation:
    """Return the rig's last image; a detector needs no pose."""
    return Observation(
        number, number, np.eye(4), rgb=rig.rgb, depth_m=rig.depth_m, camera=rig.model,
        T_base_camera=rig.T_base_camera,
    )  # fmt: skip


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
    detector = make_detector(config.perception, ["chair"])
    counts: dict[str, WordCount] = defaultdict(WordCount)
    for section in world_list.world_sections(args.worlds):
        data: Data = merged(data_of(config), {"sim": {"world": section}})
        house = parse(data, config.path)
        world = world_list.load(house)
        for word, more in count_words(house, world, detector, text, args.poses, args.seed):
            counts[word].add(more)
    print(_table(counts, args.precision, config.perception.confirm_score))
    return 0


def _table(counts: dict[str, WordCount], precision: float, default: float) -> str:
    """Return a table of the words, most views first, and the lines for the configuration."""
    rows, lines = [("word", "views", "recall", "right", "score", "mistaken for it")], []
    for word, count in sorted(counts.items(), key=lambda item: (-item[1].views, item[0])):
        n, n_right = len(count.right), sum(count.right)
        score = score_for(count, precision, default)
        mistaken = ", ".join(f"{name} {k}" for name, k in count.mistaken.most_common(3))
        recall = f"{count.seen / count.views:.2f}" if count.views else "–"
        shown = "–" if score is None else f"{score:g}"
        rows.append((word, str(count.views), recall, f"{n_right}/{n}", shown, mistaken))
        if score is not None and score > default:
            lines.append(f"    {word}: {score:g}")
    table = format_table(rows)
    return "\n".join([table, "", "perception:", "  confirm_scores:", *sorted(lines)])
