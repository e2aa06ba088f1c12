"""What scorers say about where to go: asked beside the loop, taken up when they answer.

The status message tells it, policies may go by it, and the value maps are written from one of
them, with what the camera saw when it was asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from edge import names
from edge.config import ChoiceCooccurrence, ChoiceNone, ChoiceOnnx, Config
from edge.config.root import ValueSource
from edge.geometry import SE2
from edge.loop.cooccurrence import PriorChoice, RelatedScores
from edge.mapping.values import Sight, ValueMap
from edge.perception.scoring.choice.factory import ViewScorer, make_choice
from edge.perception.scoring.choice.picture import visible_marks
from edge.perception.scoring.choice.question import Choice, Mark, Sighting, View, Ways
from edge.perception.scoring.similarity import (
    SimilarityScorer,
    best_scores,
    is_running_detector,
    make_similarity,
    similarity_card,
)
from edge.perception.swap.choice import ChoiceSwap
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.sightings import Sightings
from edge.perception.worker import ScorerWorker
from edge.policies.base import FRONTIER, Answers, Candidates, Prior, Similarity
from edge.types import Detections, Observation

SIGHTED_NS = 2_000_000_000  # what was seen longer ago is not in view any more
MAX_SIGHTINGS = 20

ScoreOf = Callable[[Detections], np.ndarray]
"""(n,) float32 in [0, 1], a score for each prompt."""


class _Question(NamedTuple):
    """What a similarity scorer is asked; `sight` is what the view saw, if values are written."""

    observation: Observation
    targets: tuple[str, ...]
    sight: Sight | None


class _Directions(NamedTuple):
    """What a choice scorer is asked; `xy_m` is where the frontiers of the view's marks are."""

    view: View
    xy_m: np.ndarray
    sight: Sight | None

    @property
    def observation(self) -> Observation:
        return self.view.observation


class _SimilarityAnswers:
    """A similarity scorer with the interface that workers run."""

    def __init__(self, scorer: SimilarityScorer) -> None:
        self.name = scorer.name
        self._scorer = scorer

    def look(self, question: _Question) -> tuple[_Question, np.ndarray]:
        """A copy of the image costs less than a frame that is held while a model runs."""
        assert question.observation.rgb is not None
        return question, question.observation.rgb.copy()

    def answer(self, looked: tuple[_Question, np.ndarray]) -> tuple[_Question, Similarity]:
        question, rgb = looked
        seen, targets = question.observation, question.targets
        score = self._scorer.score(rgb, targets)
        return question, Similarity(seen.stamp_ns, seen.pose, targets, score)

    def close(self) -> None:
        self._scorer.close()


class _ChoiceAnswers:
    """A choice scorer that keeps the question beside its answer."""

    def __init__(self, scorer: ViewScorer) -> None:
        self.name = scorer.name
        self._scorer = scorer

    def look(self, question: _Directions) -> tuple[_Directions, Any]:
        return question, self._scorer.look(question.view)

    def answer(self, looked: tuple[_Directions, Any]) -> tuple[_Directions, Choice] | None:
        question, shown = looked
        choice = self._scorer.answer(shown)
        return None if choice is None else (question, choice)

    def close(self) -> None:
        self._scorer.close()


class Scorers:
    """The configured scorers, each with at most one question under way.

    Attributes:
        answers: the newest ones.
        feeds: which of the two the value maps are written from; may be set.
        paused: nothing is asked.
        swap: puts another model in the place of the choice scorer's; None where there are none.
        newest_swap: it was asked later than the detector's was; may be set.
        resting: those of `similarity` and `choice` that are asked nothing; may be set.
    """

    def __init__(
        self,
        similarity: SimilarityScorer | None,
        choice: ViewScorer | None,
        from_detections: str | None = None,
        score_of: ScoreOf = best_scores,
        inline: bool = False,
        rest_s: float = 0.0,
        feeds: ValueSource | None = None,
        remake: Callable[[str], ViewScorer] | None = None,
    ) -> None:
        """
        Args:
            from_detections: card of a similarity scorer that takes the running detector's scores.
            score_of: what it makes of them.
            rest_s: how long the choice scorer is left alone after an answer.
            inline: answer inside `ask`, so that a run replays the same.
            feeds: see the attribute.
            remake: makes the choice scorer of another card; None: there are no others of its kind.
        """
        self.answers = Answers()
        self._from_detections, self._score_of = from_detections, score_of
        self._detector = ""
        self.feeds = feeds
        self.resting: frozenset[str] = frozenset()
        self._turn = 0  # counts questions about directions
        asked = None if similarity is None else _SimilarityAnswers(similarity)
        self._similarity = None if asked is None else ScorerWorker("similarity", asked, 0.0, inline)
        self._by_prior = isinstance(choice, PriorChoice)  # too quick to be worth a thread
        to_choose = None if choice is None else _ChoiceAnswers(choice)
        self._choice = (
            None
            if to_choose is None
            else ScorerWorker("choice", to_choose, rest_s, inline or self._by_prior)
        )
        self.paused = False
        self.newest_swap = False
        self.swap: ChoiceSwap | None = None
        if remake is not None and self._choice is not None:
            self.swap = ChoiceSwap(self._choice, lambda card: _ChoiceAnswers(remake(card)))

    @property
    def _workers(self) -> list[ScorerWorker]:
        return [w for w in (self._similarity, self._choice) if w is not None]

    def through(self, beside: Callable[[str, Any], Any]) -> None:
        """Let what the workers are asked and find pass through `beside`."""
        if self._similarity is not None:
            self._similarity = beside("similarity", self._similarity)
        if self._choice is not None:
            self._choice = beside("choice", self._choice)

    def ask(
        self,
        observation: Observation,
        targets: tuple[str, ...],
        target: str,
        candidates: Candidates,
        tracker: InstanceTracker,
        values: ValueMap,
        prior: Prior | None = None,
        around: Sightings | None = None,
    ) -> None:
        """Put this moment to the scorers that are idle. Never blocks, unless inline.

        Args:
            targets: of the mission; `target` is the active one.
            candidates: the frontiers among them are the directions to choose from.
            tracker: has what was detected.
            values: tells what is in view; written to when the answers are taken up.
            prior: for the choice that goes by it.
            around: has what else was detected.
        """
        if self.paused:
            return
        similarity = None if "similarity" in self.resting else self._similarity
        choice = None if "choice" in self.resting else self._choice
        if similarity is not None and similarity.idle and observation.rgb is not None:
            sight = values.sight(observation) if self.feeds == "similarity" else None
            similarity.submit(_Question(observation, targets, sight))
        if choice is not None and choice.idle:
            c = candidates
            open_ = np.flatnonzero((c.kind[: c.n] == FRONTIER) & ~c.blocked[: c.n])
            marks = visible_marks(observation, c.xy_m[open_], c.id[open_])
            if marks:
                sight = values.sight(observation) if self.feeds == "choice" else None
                about = self._asked_about(targets, target)
                xy_m, lift = _places_m(observation.pose, marks), None
                if self._by_prior and prior is not None:
                    lift = np.ones(len(marks), np.float32)
                    prior.lift(about, xy_m.astype(np.float32), len(marks), lift)
                seen = sightings(tracker, around, observation)
                ways = ways_to(c, open_, marks)
                view = View(observation, about, marks, seen, lift, ways)
                choice.submit(_Directions(view, xy_m, sight))

    def saw(self, detections: Detections, values: ValueMap) -> None:
        """Take the running detector's scores, where they are the similarity that is wanted."""
        if self._from_detections is not None:
            seen = detections.observation
            self._detector = detections.model
            score = self._score_of(detections)
            said = Similarity(seen.stamp_ns, seen.pose, detections.prompts, score)
            sight = values.sight(seen) if self.feeds == "similarity" else None
            self._take_similarity(said, sight, values)

    def take_up(self, values: ValueMap, idle: bool = False) -> None:
        """Take the answers that came meanwhile and write them where they were asked, frontiers
        that are gone included.

        Args:
            idle: no mission asks questions.
        """
        if self.swap is not None:
            self.swap.step(idle=idle)
        similarity = None if self._similarity is None else self._similarity.poll()
        if similarity is not None:
            question, said = similarity
            self._take_similarity(said, question.sight, values)
        choice = None if self._choice is None else self._choice.poll()
        if choice is not None:
            asked, chosen = choice
            self.answers = replace(self.answers, choice=chosen)
            if asked.sight is not None:
                place = {mark.id: i for i, mark in enumerate(asked.view.marks)}
                xy_m = asked.xy_m[[place[i] for i in chosen.ids]]
                values.write_directions(asked.sight, chosen.target, xy_m, chosen.p, chosen.scene)

    def _take_similarity(self, said: Similarity, sight: Sight | None, values: ValueMap) -> None:
        self.answers = replace(self.answers, similarity=said)
        if sight is not None:
            values.write_view(sight, said.targets, said.score)

    def _asked_about(self, targets: tuple[str, ...], target: str) -> str:
        """Which target the next question about directions is about.

        Every other one is about the active target; where the value maps are written from the
        answers, the rest go to the other targets in turn (ViTL keeps a channel for each).
        """
        others = [t for t in targets if t != target] if self.feeds == "choice" else []
        self._turn += 1
        if not others or self._turn % 2:
            return target
        return others[self._turn // 2 % len(others)]

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
                **({} if self.swap is None else {"swap": self.swap.status()}),
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
        if self.swap is not None:
            self.swap.close()


def _places_m(pose: SE2, marks: Sequence[Mark]) -> np.ndarray:
    """(n, 2) float64 in `map`."""
    bearing = pose.yaw_rad + np.array([mark.bearing_rad for mark in marks])
    away_m = np.array([mark.distance_m for mark in marks])
    return np.stack(
        [pose.x_m + away_m * np.cos(bearing), pose.y_m + away_m * np.sin(bearing)], axis=1
    )


def ways_to(candidates: Candidates, open_: np.ndarray, marks: Sequence[Mark]) -> Ways:
    """What the map says of the ways to marks, and of those to the other frontiers.

    Args:
        open_: (k,) indices of the frontiers that may be gone to, the marks' among them.
    """
    path_m, gain_m2 = candidates.path_m[open_], candidates.gain_m2[open_]
    ids = np.array([mark.id for mark in marks], np.int64)
    is_mark = candidates.id[open_] == ids[:, None]  # (marks, k)
    at, others = is_mark.argmax(axis=1), np.isfinite(path_m) & ~is_mark.any(axis=0)
    rest = np.zeros(3, np.float32)
    if others.any():
        rest[:] = np.count_nonzero(others), path_m[others].min(), gain_m2[others].max()
    return Ways(path_m[at], gain_m2[at], rest)


def sightings(
    tracker: InstanceTracker, around: Sightings | None, observation: Observation
) -> tuple[Sighting, ...]:
    """What was detected a moment ago and not refuted, targets and all else, the nearest first."""
    pose, least = observation.pose, tracker.config.min_hits
    found = [
        (instance.label, instance.center_m)
        for instance in tracker.all
        if instance.state != "refuted"
        and instance.hits >= least
        and observation.stamp_ns - instance.last_seen_ns <= SIGHTED_NS
    ]
    if around is not None:
        n, told = around.n, {names.canonical(i.label) for i in tracker.all}
        fresh = around.last_seen_ns[:n] >= observation.stamp_ns - SIGHTED_NS
        for i in np.flatnonzero(fresh & (around.hits[:n] >= least)):
            word = around.words[around.word[i]]
            if word not in told:  # of targets the tracker knows more
                found.append((word, around.xyz_m[i]))
    told_of = [
        Sighting(word, pose.bearing_to(*xy_m), pose.distance_to(*xy_m))
        for word, xy_m in ((word, (float(at[0]), float(at[1]))) for word, at in found)
    ]
    return tuple(sorted(told_of, key=lambda sighting: sighting.distance_m)[:MAX_SIGHTINGS])


def make_scorers(
    config: Config,
    targets: Sequence[str],
    make_similarity: Callable[..., SimilarityScorer] = make_similarity,
    make_choice: Callable[..., ViewScorer] = make_choice,
) -> Scorers | None:
    """The scorers that the configuration names; None where there are none.

    Args:
        targets: of the mission to begin with.
        make_similarity, make_choice: load the models.

    Raises:
        ModelError: a card or a model is missing or unusable.
        PromptError: a similarity scorer does not know a target.
        ChatError: a server's URL or the API key cannot be used.
    """
    perception = config.perception
    card = similarity_card(perception)
    choice = perception.choice
    asked: ViewScorer | None = None
    if isinstance(choice, ChoiceCooccurrence):
        asked = PriorChoice()
    elif not isinstance(choice, ChoiceNone):
        asked = make_choice(choice, perception)
    if card is None and asked is None:
        return None
    remake: Callable[[str], ViewScorer] | None = None
    if isinstance(choice, ChoiceOnnx):

        def made_again(name: str) -> ViewScorer:
            wanted = choice.model_copy(update={"card": name})
            if perception.isolation == "thread":  # a model that never ends is killed only there
                apart = perception.model_copy(update={"isolation": "process"})
                make_choice(wanted, apart).close()
            return make_choice(wanted, perception)

        remake = made_again
    similarity, from_detections = None, None
    score_of: ScoreOf = best_scores
    if card is not None and is_running_detector(card, perception):
        from_detections = card.name
        score_of = best_scores if card.related is None else RelatedScores()
    elif card is not None:
        similarity = make_similarity(card, perception, targets)
    return Scorers(
        similarity,
        asked,
        from_detections,
        score_of,
        inline=config.loop.lockstep,
        rest_s=getattr(choice, "rest_s", 0.0),
        feeds=config.value_source,
        remake=remake,
    )


def _by(keys: Sequence[object], values: np.ndarray) -> dict[str, float]:
    return {str(k): round(float(v), 4) for k, v in zip(keys, values, strict=True)}
