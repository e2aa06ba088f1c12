"""What slow models say about where to go: asked beside the loop, taken up when they answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.config import ChoiceNone, Config
from edge.geometry import SE2
from edge.loop.candidates import FRONTIER, CandidatePool
from edge.perception.choice.picture import visible_marks
from edge.perception.choice.question import Choice, Sighting, View
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
from edge.types import Detections, Observation

SIGHTED_NS = 2_000_000_000  # what was seen longer ago is not in view any more
MAX_SIGHTINGS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """How well one image goes with each target of the mission.

    Attributes:
        stamp_ns: of the observation, `pose` is where the robot stood then.
        score: (n,) float32, one for each target; see `SimilarityScorer.score` for the scale.
        round: see `View.round`.
    """

    stamp_ns: int
    pose: SE2
    targets: tuple[str, ...]
    score: np.ndarray
    round: int


@dataclass(slots=True)
class Advice:
    """What the scorers last said of this map and mission; None: nothing yet.

    The service has it as its `advice` and its status message tells it; no policy reads it yet.
    VLFM goes by `similarity`, over the whole field of view, and ViTL by `choice`, by frontier:
    `Choice.ids` are ids of the pool's candidates, and those that the pool has no longer are stale.
    Either may be seconds old, or never come.
    """

    similarity: Similarity | None = None
    choice: Choice | None = None


class _Look(NamedTuple):
    """A question to a similarity scorer."""

    observation: Observation
    targets: tuple[str, ...]
    round: int


class _SimilarityAsker:
    """A similarity scorer with the interface that workers run."""

    def __init__(self, scorer: SimilarityScorer) -> None:
        self.name = scorer.name
        self._scorer = scorer

    def look(self, question: _Look) -> tuple[_Look, np.ndarray]:
        """A copy of the image costs less than a frame that is held while a model runs."""
        assert question.observation.rgb is not None
        return question, question.observation.rgb.copy()

    def answer(self, looked: tuple[_Look, np.ndarray]) -> Similarity:
        question, rgb = looked
        seen, targets = question.observation, question.targets
        score = self._scorer.score(rgb, targets)
        return Similarity(seen.stamp_ns, seen.pose, targets, score, question.round)

    def close(self) -> None:
        self._scorer.close()


class Advisers:
    """The configured scorers, each with at most one question under way.

    Attributes:
        advice: the newest answers.
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
        self.advice = Advice()
        self._from_detections = from_detections
        self._detector = ""
        self._round = 0
        asker = None if similarity is None else _SimilarityAsker(similarity)
        self._similarity = None if asker is None else ScorerWorker("similarity", asker, 0.0, inline)
        self._choice = None if choice is None else ScorerWorker("choice", choice, rest_s, inline)

    def ask(
        self,
        observation: Observation,
        targets: tuple[str, ...],
        target: str,
        pool: CandidatePool,
        tracker: InstanceTracker,
    ) -> None:
        """Put this moment to the scorers that are idle. Never blocks, unless inline.

        Args:
            targets: of the mission; `target` is the active one.
            pool: its frontiers are the directions to choose among.
            tracker: has what was detected.
        """
        similarity, choice = self._similarity, self._choice
        if similarity is not None and similarity.idle and observation.rgb is not None:
            similarity.submit(_Look(observation, targets, self._round))
        if choice is not None and choice.idle:
            open_ = np.flatnonzero((pool.kind[: pool.n] == FRONTIER) & ~pool.blocked[: pool.n])
            marks = visible_marks(observation, pool.xy_m[open_], pool.id[open_])
            if marks:
                seen = sightings(tracker, observation)
                choice.submit(View(observation, target, marks, seen, self._round))

    def saw(self, detections: Detections) -> None:
        """Take the running detector's scores, where they are the similarity that is wanted."""
        if self._from_detections is not None:
            seen = detections.observation
            self._detector = detections.model
            self.advice.similarity = Similarity(
                seen.stamp_ns, seen.pose, detections.prompts, best_scores(detections), self._round
            )

    def take_up(self) -> None:
        """Answers that came meanwhile become the advice, unless they are of another round."""
        if self._similarity is not None:
            similarity = self._similarity.poll()
            if similarity is not None and similarity.round == self._round:
                self.advice.similarity = similarity
        if self._choice is not None:
            choice = self._choice.poll()
            if choice is not None and choice.round == self._round:
                self.advice.choice = choice

    def forget(self) -> None:
        """Another map or mission: what was said, and what is being asked, is void."""
        self._round += 1
        self.advice.similarity = self.advice.choice = None

    def names(self) -> list[str]:
        """What runs, for people."""
        workers = (self._similarity, self._choice)
        running = [self._from_detections] if self._from_detections is not None else []
        return running + [worker.name for worker in workers if worker is not None]

    def status(self) -> dict[str, object]:
        """For the status message: model, counts and newest answer of each scorer that runs."""
        said: dict[str, object] = {}
        similarity, choice = self.advice.similarity, self.advice.choice
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
        for worker in (self._similarity, self._choice):
            if worker is not None:
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


def make_advisers(config: Config, targets: Sequence[str]) -> Advisers | None:
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
        return Advisers(None, asked, **how)
    if is_running_detector(card, perception):
        return Advisers(None, asked, from_detections=card.name, **how)
    return Advisers(make_similarity(card, perception, targets), asked, **how)


def _by(keys: Sequence[object], values: np.ndarray) -> dict[str, float]:
    return {str(k): round(float(v), 4) for k, v in zip(keys, values, strict=True)}
