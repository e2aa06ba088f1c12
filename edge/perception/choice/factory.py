"""Which choice scorers there are, and the one that a configuration names."""

from __future__ import annotations

from typing import Any, Protocol

from edge.config import ChoiceOnnx, ChoiceOpenai, ChoiceText, Perception
from edge.perception.card_types import MarksCard
from edge.perception.cards import load_card
from edge.perception.choice.question import Choice, View
from edge.perception.choice.scorer import make_server_choice
from edge.perception.model_file import ModelError


class ViewScorer(Protocol):
    """Chooses among the frontiers of a view; a `Scorer` of `edge.perception.worker`."""

    name: str

    def look(self, view: View) -> Any: ...

    def answer(self, looked: Any) -> Choice | None: ...

    def close(self) -> None: ...


def make_choice(
    choice: ChoiceOnnx | ChoiceOpenai | ChoiceText, perception: Perception
) -> ViewScorer:
    """The scorer that a configuration names, ready to be asked.

    Args:
        perception: says whether a model that runs here has a process of its own.

    Raises:
        ChatError: the URL or the key of a server cannot be used.
        ModelError: a model or its card is missing or unusable.
    """
    if isinstance(choice, ChoiceOnnx):
        return _make_onnx(choice, perception)
    return make_server_choice(choice)


def _make_onnx(choice: ChoiceOnnx, perception: Perception) -> ViewScorer:
    """The card's task tells what runs it."""
    try:
        card = load_card(choice.card)
    except ModelError as error:
        raise ModelError(f"perception.choice.card: {error}") from None
    if isinstance(card, MarksCard):
        from edge.perception.choice.mark_scorer import open_mark_scorer

        return open_mark_scorer(card, choice)
    from edge.perception.choice.onnx_scorer import OnnxChoice, choice_card, open_model

    if perception.isolation == "process":
        from edge.perception.process.language import ProcessModel

        model = ProcessModel(choice_card(choice), choice, perception.process)
    else:
        model = open_model(choice)
    return OnnxChoice(model, choice.max_image_px, choice.time_limit_s)
