"""Scorers of views and directions; the loop asks them, and collects their answers later.

A *similarity scorer* gives an image one score for each target. A *choice scorer* chooses between
the frontiers that are marked in an image. They answer in the background.

The status message reports the answers, and policies may use them. The answers of one scorer are
also written to the value maps, for the part of the map that the camera saw in the question's image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from edge.config import ChoiceCooccurrence, ChoiceNone, ChoiceOnnx, Config
from edge.config.root import ValueSource
from edge.loop.scoring.cooccurrence import PriorChoice, RelatedScores
from edge.loop.scoring.scorer_questions import (
    ChoiceQuestion,
    SimilarityAnswers,
    SimilarityQuestion,
    mark_costs,
    objects_in_view,
    places_m,
)
from edge.mapping.values import RangeProfile, ValueMap
from edge.perception.scoring.choice.factory import ViewScorer, make_view_scorer
from edge.perception.scoring.choice.picture import visible_marks
from edge.perception.scoring.choice.question import MarkedView
from edge.perception.scoring.similarity import (
    SimilarityScorer,
    is_running_detector,
    make_similarity,
    max_score_per_prompt,
    similarity_card,
)
from edge.perception.swap.choice import ChoiceSwap
from edge.perception.tracking.instances import InstanceTracker
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.perception.worker import ScorerWorker
from edge.policies.base import FRONTIER, Candidates, ImageSimilarity, ScorerOutputs, TargetPrior
from edge.types import Detections, Observation

ScoreOf = Callable[[Detections], np.ndarray]
"""Returns (n,) float32 in [0, 1], a score for each prompt."""


class Scorers:
    """The configured scorers. Each has at most one open question.

    Attributes:
        value_source: Scorer that writes the value maps, `similarity` or `choice`; may be set.
        paused: True while no questions are asked; may be set.
        swap: Swaps the model of the choice scorer; None if it cannot be swapped.
        shed: Scorers (`similarity`, `choice`) that get no questions under load; may be set.
    """

    def __init__(
        self,
        similarity: SimilarityScorer | None,
        choice: ViewScorer | None,
        from_detections: str | None = None,
        score_of: ScoreOf = max_score_per_prompt,
        inline: bool = False,
        rest_s: float = 0.0,
        value_source: ValueSource | None = None,
        make_other: Callable[[str], ViewScorer] | None = None,
    ) -> None:
        """Start the workers of the scorers.

        Args:
            similarity: The similarity scorer, if any.
            choice: The choice scorer, if any.
            from_detections: Card of a similarity scorer that uses the running detector's scores.
            score_of: Computes the similarity from the detections, with `from_detections`.
            inline: Answer inside `ask`, so that a run is reproducible.
            rest_s: Pause of the choice scorer after an answer.
            value_source: See the attribute.
            make_other: Makes a choice scorer for another card; None if models cannot be swapped.
        """
        self.answers = ScorerOutputs()
        self._from_detections, self._score_of = from_detections, score_of
        self._detector = ""  # model of the newest detections, with `from_detections`
        self.value_source = value_source
        self.shed: frozenset[str] = frozenset()
        self._n_questions = 0  # number of questions about directions so far
        self._similarity: ScorerWorker | None = None
        self._choice: ScorerWorker | None = None
        if similarity is not None:
            answers = SimilarityAnswers(similarity)
            self._similarity = ScorerWorker("similarity", answers, inline=inline)
        self._by_prior = isinstance(choice, PriorChoice)  # fast, so it needs no thread
        if choice is not None:
            self._choice = ScorerWorker(
                "choice", choice, rest_s, inline or self._by_prior,
                view_of=lambda question: question.view,
            )  # fmt: skip
        self.paused = False
        self.swap: ChoiceSwap | None = None
        if make_other is not None and self._choice is not None:
            self.swap = ChoiceSwap(self._choice, make_other)

    @property
    def _workers(self) -> list[ScorerWorker]:
        return [w for w in (self._similarity, self._choice) if w is not None]

    def wrap_workers(self, wrap: Callable[[str, Any], Any]) -> None:
        """Wrap the workers with `wrap`, which logs their requests and results."""
        if self._similarity is not None:
            self._similarity = wrap("similarity", self._similarity)
        if self._choice is not None:
            self._choice = wrap("choice", self._choice)

    def ask(
        self,
        observation: Observation,
        targets: tuple[str, ...],
        target: str,
        candidates: Candidates,
        tracker: InstanceTracker,
        values: ValueMap,
        prior: TargetPrior | None = None,
        other_objects: TrackedObjects | None = None,
    ) -> None:
        """Ask the idle scorers about this observation. Never block, unless `inline`."""
        if self.paused:
            return
        similarity = None if "similarity" in self.shed else self._similarity
        choice = None if "choice" in self.shed else self._choice
        if similarity is not None and similarity.idle and observation.rgb is not None:
            profile = (
                values.range_profile(observation) if self.value_source == "similarity" else None
            )
            similarity.submit(SimilarityQuestion(observation, targets, profile))
        if choice is not None and choice.idle:
            c = candidates
            frontiers = np.flatnonzero((c.kind[: c.n] == FRONTIER) & ~c.blocked[: c.n])
            marks = visible_marks(observation, c.xy_m[frontiers], c.id[frontiers])
            if marks:
                profile = (
                    values.range_profile(observation) if self.value_source == "choice" else None
                )
                asked_target = self._next_target(targets, target)
                xy_m, ratio = places_m(observation.pose, marks), None
                if self._by_prior and prior is not None:
                    ratio = np.ones(len(marks), np.float32)
                    prior.likelihood_ratio(asked_target, xy_m.astype(np.float32), len(marks), ratio)
                objects = objects_in_view(tracker, other_objects, observation)
                costs = mark_costs(c, frontiers, marks)
                view = MarkedView(observation, asked_target, marks, objects, ratio, costs)
                choice.submit(ChoiceQuestion(view, xy_m, profile))

    def on_detections(self, detections: Detections, values: ValueMap) -> None:
        """Use the running detector's scores as similarity, if so configured."""
        if self._from_detections is not None:
            observation = detections.observation
            self._detector = detections.model
            score = self._score_of(detections)
            answer = ImageSimilarity(
                observation.stamp_ns, observation.pose, detections.prompts, score
            )
            profile = (
                values.range_profile(observation) if self.value_source == "similarity" else None
            )
            self._set_similarity(answer, profile, values)

    def collect_answers(self, values: ValueMap, idle: bool = False) -> None:
        """Collect the new answers and write them to the value maps.

        Directions are written at the frontiers of the question, even if these are gone.
        """
        if self.swap is not None:
            self.swap.step(idle=idle)
        similarity = None if self._similarity is None else self._similarity.poll()
        if similarity is not None:
            question, answer = similarity
            self._set_similarity(answer, question.range_profile, values)
        choice = None if self._choice is None else self._choice.poll()
        if choice is not None:
            choice_question, chosen = choice
            self.answers = replace(self.answers, choice=chosen)
            if choice_question.range_profile is not None:
                index = {mark.id: i for i, mark in enumerate(choice_question.view.marks)}
                xy_m = choice_question.xy_m[[index[i] for i in chosen.ids]]
                values.write_directions(
                    choice_question.range_profile, chosen.target, xy_m, chosen.p, chosen.scene
                )

    def _set_similarity(
        self, answer: ImageSimilarity, profile: RangeProfile | None, values: ValueMap
    ) -> None:
        self.answers = replace(self.answers, similarity=answer)
        if profile is not None:
            values.write_view(profile, answer.targets, answer.score)

    def _next_target(self, targets: tuple[str, ...], target: str) -> str:
        """Return the target of the next question about directions.

        If the value maps are written from the answers, every second question is about one of the
        other targets in turn (ViTL keeps a channel for each). All other questions are about the
        active target.
        """
        others = [t for t in targets if t != target] if self.value_source == "choice" else []
        self._n_questions += 1
        if not others or self._n_questions % 2:
            return target
        return others[self._n_questions // 2 % len(others)]

    def discard_pending(self) -> None:
        """Drop all answers and open questions, for another map or mission."""
        for worker in self._workers:
            worker.discard_all()
        self.answers = ScorerOutputs()

    def names(self) -> list[str]:
        """Return the names of the running models, for people."""
        running = [self._from_detections] if self._from_detections is not None else []
        return running + [worker.name for worker in self._workers]

    def status(self) -> dict[str, object]:
        """Return model, counts and newest answer of each scorer, for the status message."""
        status: dict[str, object] = {}
        similarity, choice = self.answers.similarity, self.answers.choice
        if self._similarity is not None or self._from_detections is not None:
            status["similarity"] = {
                **(
                    {"model": f"{self._from_detections} ({self._detector})"}
                    if self._similarity is None
                    else self._similarity.counts()
                ),
                "stamp_ns": None if similarity is None else similarity.stamp_ns,
                "scores": {}
                if similarity is None
                else _rounded(similarity.targets, similarity.score),
            }
        if self._choice is not None:
            status["choice"] = {
                **self._choice.counts(),
                **({} if self.swap is None else {"swap": self.swap.status()}),
                "stamp_ns": None if choice is None else choice.stamp_ns,
                "target": None if choice is None else choice.target,
                "scene": None if choice is None else choice.scene,
                "elsewhere": None if choice is None else choice.elsewhere,
                "frontiers": {} if choice is None else _rounded(choice.ids, choice.p),
            }
        return status

    def close(self) -> None:
        """Drop all questions and stop the workers. Wait for no server."""
        for worker in self._workers:
            worker.close()
        if self.swap is not None:
            self.swap.close()


def make_scorers(
    config: Config,
    targets: Sequence[str],
    make_similarity: Callable[..., SimilarityScorer] = make_similarity,
    make_choice: Callable[..., ViewScorer] = make_view_scorer,
) -> Scorers | None:
    """Return the configured scorers, or None if there are none.

    Raises:
        ModelError: A card or a model is missing or unusable.
        PromptError: A similarity scorer does not know a target.
        ChatError: The URL of a server, or the API key, cannot be used.
    """
    perception = config.perception
    card = similarity_card(perception)
    choice = perception.choice
    chooser: ViewScorer | None = None
    if isinstance(choice, ChoiceCooccurrence):
        chooser = PriorChoice()
    elif not isinstance(choice, ChoiceNone):
        chooser = make_choice(choice, perception)
    if card is None and chooser is None:
        return None
    make_other: Callable[[str], ViewScorer] | None = None
    if isinstance(choice, ChoiceOnnx):

        def make_checked(name: str) -> ViewScorer:
            settings = choice.model_copy(update={"card": name})
            if perception.isolation == "thread":  # only a process can kill a model that hangs
                in_process = perception.model_copy(update={"isolation": "process"})
                make_choice(settings, in_process).close()
            return make_choice(settings, perception)

        make_other = make_checked
    similarity, from_detections = None, None
    score_of: ScoreOf = max_score_per_prompt
    if card is not None and is_running_detector(card, perception):
        from_detections = card.name
        score_of = max_score_per_prompt if card.related is None else RelatedScores()
    elif card is not None:
        similarity = make_similarity(card, perception, targets)
    return Scorers(
        similarity,
        chooser,
        from_detections,
        score_of,
        inline=config.loop.lockstep,
        rest_s=getattr(choice, "pause_s", 0.0),
        value_source=config.value_source,
        make_other=make_other,
    )


def _rounded(keys: Sequence[object], values: np.ndarray) -> dict[str, float]:
    return {str(k): round(float(v), 4) for k, v in zip(keys, values, strict=True)}
