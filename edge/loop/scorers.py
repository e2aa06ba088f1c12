"""What slow models say about where to go: asked beside the loop, taken up when they answer.

The status message tells it, and policies may go by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from edge.config import ChoiceNone, Config
from edge.perception.choice.picture import visible_marks
from edge.perception.choice.question import Sighting, View
from edge.perception.choice.scorer import ChoiceScorer, make_choice
from edge.perception.instances import InstanceTracker
from edge.perception.similarity import (
    SimilarityScorer,
    best_scores,
    is_running_detector,
    make_similarity,
    similarity_card,
)
from edge.perception.worker import ScorerWorker
from edge.policies.base import FRONTIER, Answers, Candidates, Similarity
from edge.types import Detections, Observation

SIGHTED_NS = 2_000_000_000  # what was seen longer ago is not in view any more
MAX_SIGHTINGS = 20


class _Question(NamedTuple):
    """What a similarity scorer is asked."""

    observation: Observation
    targets: tuple[str, ...]


class _SimilarityAnswers:
    """A similarity scorer with the interface that workers run."""

    def __init__(self, scorer: SimilarityScorer) -> None:
        self.name = scorer.name
        self._scorer = scorer

    def look(self, question: _Question) -> tuple[_Question, np.ndarray]:
        """A copy of the image costs less than a frame that is held while a model runs."""
        assert question.observation.rgb is not None
        return question, question.observation.rgb.copy()

    def answer(self, looked: tuple[_Question, np.ndarray]) -> Similarity:
        question, rgb = looked
        seen, targets = question.observation, question.targets
        score = self._scorer.score(rgb, targets)
        return Similarity(seen.stamp_ns, seen.pose, targets, score)

    def close(self) -> None:
        self._scorer.close()


class Scorers:
    """The configured scorers, each with at most one question under way.

    Attributes:
        answers: the newest ones.
    """

    def __init__(
        self,
        similarity: SimilarityScorer | None,
        choice: ChoiceScorer | None,
        from_detections: str | None = None,
        inline: bool = False,
        rest_s: float = 0.0,
    ) -> None:
        """
        Args:
            from_detections: card of a similarity scorer that takes the running detector's scores.
            rest_s: how long the choice scorer is left alone after an answer.
            inline: answer inside `ask`, so that a run replays the same.
        """
        self.answers = Answers()
        self._from_detections = from_detections
        self._detector = ""
        asked = None if similarity is None else _SimilarityAnswers(similarity)
        self._similarity = None if asked is None else ScorerWorker("similarity", asked, 0.0, inline)
        self._choice = None if choice is None else ScorerWorker("choice", choice, rest_s, inline)
        self._workers = [w for w in (self._similarity, self._choice) if w is not None]

    def ask(
        self,
        observation: Observation,
        targets: tuple[str, ...],
        target: str,
        candidates: Candidates,
        tracker: InstanceTracker,
    ) -> None:
        """Put this moment to the scorers that are idle. Never blocks, unless inline.

        Args:
            targets: of the mission; `target` is the active one.
            candidates: the frontiers among them are the directions to choose from.
            tracker: has what was detected.
        """
        similarity, choice = self._similarity, self._choice
        if similarity is not None and similarity.idle and observation.rgb is not None:
            similarity.submit(_Question(observation, targets))
        if choice is not None and choice.idle:
            c = candidates
            open_ = np.flatnonzero((c.kind[: c.n] == FRONTIER) & ~c.blocked[: c.n])
            marks = visible_marks(observation, c.xy_m[open_], c.id[open_])
            if marks:
                choice.submit(View(observation, target, marks, sightings(tracker, observation)))

    def saw(self, detections: Detections) -> None:
        """Take the running detector's scores, where they are the similarity that is wanted."""
        if self._from_detections is not None:
            seen = detections.observation
            self._detector = detections.model
            score = best_scores(detections)
            said = Similarity(seen.stamp_ns, seen.pose, detections.prompts, score)
            self.answers = replace(self.answers, similarity=said)

    def take_up(self) -> None:
        """Answers that came meanwhile are the newest."""
        similarity = None if self._similarity is None else self._similarity.poll()
        if similarity is not None:
            self.answers = replace(self.answers, similarity=similarity)
        choice = None if self._choice is None else self._choice.poll()
        if choice is not None:
            self.answers = replace(self.answers, choice=choice)

    def forget(self) -> None:
        """Another map or mission: what was said, and what is being asked, is void."""
        for worker in self._workers:
            worker.forget()
        self.answers = Answers()

    def names(self) -> list[str]:
        """What runs, for people."""
        running = [self._from_detections] if self._from_detections is not None else []
        return running + [worker.name for worker in self._workers]

    def status(self) -> dict[str, object]:
        """For the status message: model, counts and newest answer of each scorer that runs."""
        said: dict[str, object] = {}
        similarity, choice = self.answers.similarity, self.answers.choice
        if self._similarity is not None or self._from_detections is not None:
            said["similarity"] = {
                **(
                    {"model": f"{self._from_detections} ({self._detector})"}
                    if self._similarity is None
                    else self._similarity.counts()
                ),
                "stamp_ns": None if similarity is None else similarity.stamp_ns,
                "scores": {} if similarity is None else _by(similarity.targets, similarity.score),
            }
        if self._choice is not None:
            said["choice"] = {
                **self._choice.counts(),
                "stamp_ns": None if choice is None else choice.stamp_ns,
                "target": None if choice is None else choice.target,
                "scene": None if choice is None else choice.scene,
                "elsewhere": None if choice is None else choice.elsewhere,
                "frontiers": {} if choice is None else _by(choice.ids, choice.p),
            }
        return said

    def close(self) -> None:
        """Give up every question; waits for no server."""
        for worker in self._workers:
            worker.close()


def sightings(tracker: InstanceTracker, observation: Observation) -> tuple[Sighting, ...]:
    """What was detected a moment ago and not refuted, the nearest first."""
    pose, least = observation.pose, tracker.config.min_hits
    found = []
    for instance in tracker.all:
        ago_ns = observation.stamp_ns - instance.last_seen_ns
        if instance.state != "refuted" and instance.hits >= least and ago_ns <= SIGHTED_NS:
            x_m, y_m = float(instance.center_m[0]), float(instance.center_m[1])
            bearing_rad, distance_m = pose.bearing_to(x_m, y_m), pose.distance_to(x_m, y_m)
            found.append(Sighting(instance.label, bearing_rad, distance_m))
    return tuple(sorted(found, key=lambda sighting: sighting.distance_m)[:MAX_SIGHTINGS])


def make_scorers(config: Config, targets: Sequence[str]) -> Scorers | None:
    """The scorers that the configuration names; None where there are none.

    Args:
        targets: of the mission to begin with.

    Raises:
        ModelError: a card or a model is missing or unusable.
        PromptError: a similarity scorer does not know a target.
        ChatError: a server's URL or the API key cannot be used.
    """
    perception = config.perception
    card = similarity_card(perception)
    choice = perception.choice
    asked = None if isinstance(choice, ChoiceNone) else make_choice(choice)
    if card is None and asked is None:
        return None
    how = {
        "inline": config.loop.lockstep,
        "rest_s": 0.0 if isinstance(choice, ChoiceNone) else choice.rest_s,
    }
    if card is None:
        return Scorers(None, asked, **how)
    if is_running_detector(card, perception):
        return Scorers(None, asked, from_detections=card.name, **how)
    return Scorers(make_similarity(card, perception, targets), asked, **how)


def _by(keys: Sequence[object], values: np.ndarray) -> dict[str, float]:
    return {str(k): round(float(v), 4) for k, v in zip(keys, values, strict=True)}
