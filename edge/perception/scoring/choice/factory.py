"""Factory of the scorer for VLM frontier selection, by the configuration (`perception.choice`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge.config import ChoiceOnnx, ChoiceOpenai, ChoiceText, ModelProcessConfig, PerceptionConfig
from edge.perception.runtime.card_types import MAX_MARKS, ChoiceCard, MarksCard
from edge.perception.runtime.cards import load_card, load_card_of
from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.choice.letter_scorer import LetterScorer, both_questions
from edge.perception.scoring.choice.mark_scorer import MarkScorer, check_size, open_network
from edge.perception.scoring.choice.process import ProcessMarks, ProcessModel
from edge.perception.scoring.choice.question import FrontierChoice, MarkedView
from edge.perception.scoring.choice.server import make_server_scorer
from edge.perception.worker import Scorer

if TYPE_CHECKING:
    from edge.perception.scoring.vlm.model import LanguageModel

ViewScorer = Scorer[MarkedView, FrontierChoice]
"""A scorer that chooses among the frontiers of a view; None if there is no mark to choose from."""


def make_view_scorer(
    choice: ChoiceOnnx | ChoiceOpenai | ChoiceText, perception: PerceptionConfig
) -> ViewScorer:
    """Make the scorer that the configuration names, ready to be asked.

    Raises:
        ChatError: the URL or the key of a server cannot be used.
        ModelError: a model or its card is missing or unusable.
        PromptError: a mark network has no text encoder.
    """
    if isinstance(choice, ChoiceOnnx):
        isolated = perception.isolation == "process"
        return open_view_scorer(choice, perception.process if isolated else None)
    if choice.fallback is None:
        return make_server_scorer(choice)
    # Import late: nothing of it is needed without a fallback.
    from edge.perception.scoring.choice.fallback import FallbackScorer

    try:
        local = make_view_scorer(ChoiceOnnx(card=choice.fallback), perception)
    except ModelError as error:
        reason = str(error).removeprefix("perception.choice.card: ")
        raise ModelError(f"perception.choice.fallback: {reason}") from None
    return FallbackScorer(make_server_scorer(choice), local)


def open_view_scorer(choice: ChoiceOnnx, process: ModelProcessConfig | None = None) -> ViewScorer:
    """Open the scorer of a local model: a mark network or a language model, by the card's task.

    A mark network is a small network that gets the marks' positions as numbers (`mark_scorer`).

    Raises:
        ModelError: a model or its card is missing or unusable.
        PromptError: a mark network has no text encoder.
    """
    try:
        card = load_card(choice.card)
    except ModelError as error:
        raise ModelError(f"perception.choice.card: {error}") from None
    if isinstance(card, MarksCard):
        check_size(card, choice)
        network = (
            open_network(card, choice) if process is None else ProcessMarks(card, choice, process)
        )
        return MarkScorer(card, network, choice.time_limit_s)
    model = (
        open_model(choice)
        if process is None
        else ProcessModel(_choice_card(choice), choice, process)
    )
    return LetterScorer(model, choice.max_image_px, choice.time_limit_s)


def open_model(choice: ChoiceOnnx) -> LanguageModel:
    """Open the language model of the configured card, ready to be asked.

    Raises:
        ModelError: there is no such card, it is of another task, or its model is unusable.
    """
    # Import late: it loads packages that only language models need.
    from edge.perception.scoring.vlm.model import LanguageModel

    questions = both_questions(MAX_MARKS, "chair")  # with every answer that will ever be offered
    return LanguageModel(
        _choice_card(choice), questions, choice.providers, choice.threads, choice.device_id
    )


def _choice_card(choice: ChoiceOnnx) -> ChoiceCard:
    """Return the configured card; see `open_model`."""
    try:
        return load_card_of(ChoiceCard, choice.card)
    except ModelError as error:
        raise ModelError(f"perception.choice.card: {error}") from None
