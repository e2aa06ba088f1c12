"""Questions to scorers: their content, and the data that is collected for them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from edge import names
from edge.geometry import SE2
from edge.mapping.values import RangeProfile
from edge.perception.scoring.choice.question import (
    DetectedObject,
    Mark,
    MarkCosts,
    MarkedView,
)
from edge.perception.scoring.similarity import SimilarityScorer
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.policies.base import Candidates, ImageSimilarity
from edge.types import Observation

IN_VIEW_NS = 2_000_000_000  # objects seen longer ago do not count as in view
MAX_NAMED_OBJECTS = 20  # largest number of objects that a question names


class SimilarityQuestion(NamedTuple):
    """A question to a similarity scorer.

    Attributes:
        targets: The targets to compare the image with.
        range_profile: The part of the map that the camera sees; None if the answer is not written
            to the value maps.
    """

    observation: Observation
    targets: tuple[str, ...]
    range_profile: RangeProfile | None


class ChoiceQuestion(NamedTuple):
    """A question to a choice scorer.

    Attributes:
        xy_m: (n, 2) float64 in `map`, places of the frontiers of the marks.
        range_profile: As in `SimilarityQuestion`.
    """

    view: MarkedView
    xy_m: np.ndarray
    range_profile: RangeProfile | None

    @property
    def observation(self) -> Observation:
        return self.view.observation


class SimilarityAnswers:
    """A similarity scorer as a `Scorer` of `edge.perception.worker`."""

    def __init__(self, scorer: SimilarityScorer) -> None:
        self.name = scorer.name
        self._scorer = scorer

    def prepare(self, question: SimilarityQuestion) -> tuple[SimilarityQuestion, np.ndarray]:
        """Return the question with a copy of the image, so that the frame is not held."""
        assert question.observation.rgb is not None
        return question, question.observation.rgb.copy()

    def answer(self, prepared: tuple[SimilarityQuestion, np.ndarray]) -> ImageSimilarity:
        (observation, targets, _), rgb = prepared
        score = self._scorer.score(rgb, targets)
        return ImageSimilarity(observation.stamp_ns, observation.pose, targets, score)

    def close(self) -> None:
        self._scorer.close()


def places_m(pose: SE2, marks: Sequence[Mark]) -> np.ndarray:
    """Return the places of marks, (n, 2) float64 in `map`."""
    bearing = pose.yaw_rad + np.array([mark.bearing_rad for mark in marks])
    away_m = np.array([mark.distance_m for mark in marks])
    return np.stack(
        [pose.x_m + away_m * np.cos(bearing), pose.y_m + away_m * np.sin(bearing)], axis=1
    )


def mark_costs(candidates: Candidates, unblocked: np.ndarray, marks: Sequence[Mark]) -> MarkCosts:
    """Return path lengths and gains of the marks, and a summary of the other frontiers.

    Args:
        candidates: The candidates.
        unblocked: (k,) indices of the frontiers that are not blocked, including those of the marks.
        marks: Marks in the image.
    """
    path_m, gain_m2 = candidates.path_m[unblocked], candidates.gain_m2[unblocked]
    ids = np.array([mark.id for mark in marks], np.int64)
    is_mark = candidates.id[unblocked] == ids[:, None]  # (marks, k)
    # `index`: the frontier of each mark. Other frontiers count only if a path is known.
    index, is_other = is_mark.argmax(axis=1), np.isfinite(path_m) & ~is_mark.any(axis=0)
    others = np.zeros(3, np.float32)  # their number, shortest path and largest gain
    if is_other.any():
        others[:] = np.count_nonzero(is_other), path_m[is_other].min(), gain_m2[is_other].max()
    return MarkCosts(path_m[index], gain_m2[index], others)


def objects_in_view(
    tracker: InstanceTracker, other_objects: TrackedObjects | None, observation: Observation
) -> tuple[DetectedObject, ...]:
    """Return the objects detected in the last `IN_VIEW_NS` and not rejected, nearest first."""
    pose, min_hits = observation.pose, tracker.config.min_hits
    found = [
        (instance.label, instance.center_m)
        for instance in tracker.all
        if instance.state != "rejected"
        and instance.hits >= min_hits
        and observation.stamp_ns - instance.last_seen_ns <= IN_VIEW_NS
    ]
    if other_objects is not None:
        n, targets = other_objects.n, {names.canonical(i.label) for i in tracker.all}
        is_recent = other_objects.last_seen_ns[:n] >= observation.stamp_ns - IN_VIEW_NS
        for i in np.flatnonzero(is_recent & (other_objects.hits[:n] >= min_hits)):
            word = other_objects.words[other_objects.word[i]]
            if word not in targets:  # the tracker knows more about targets
                found.append((word, other_objects.xyz_m[i]))
    objects = [
        DetectedObject(word, pose.bearing_to(*xy_m), pose.distance_to(*xy_m))
        for word, xy_m in ((word, (float(at[0]), float(at[1]))) for word, at in found)
    ]
    return tuple(sorted(objects, key=lambda obj: obj.distance_m)[:MAX_NAMED_OBJECTS])
