"""Which choice scorers there are, and the one that a configuration names."""

from __future__ import annotations

from typing import Any, Protocol

from edge.config import ChoiceOnnx, ChoiceOpenai, ChoiceText, Perception
from edge.perception.choice.question import Choice, View
from edge.perception.choice.scorer import make_server_choice


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
        from edge.perception.choice.onnx_scorer import make_onnx_choice

        return make_onnx_choice(choice)
    return make_server_choice(choice)
