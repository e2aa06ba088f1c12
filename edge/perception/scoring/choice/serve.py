"""Program of a model's own process for VLM frontier selection, started by `process.py` only.

It loads the model and answers its requests; `edge.perception.process` describes the messages.
"""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from edge.config import ChoiceOnnx
from edge.host.priority import lower_priority
from edge.perception.process import wire
from edge.perception.process.child import Answer, run_child
from edge.perception.process.wire import FrameView
from edge.perception.runtime.card_types import MarksCard
from edge.perception.runtime.cards import load_card
from edge.perception.scoring.vlm.answers import MultipleChoice

Ask = Callable[[dict[str, Any], Any], list[np.ndarray]]
"""(request, image or None) → the probabilities of the answers of each question."""


def load(request: dict[str, Any], control: socket.socket) -> Answer:
    """Load the model; return the function that answers a request with probabilities."""
    lower_priority()  # before the model starts threads, which inherit the priority
    ask = open_ask(ChoiceOnnx.model_validate(request["choice"]))

    def answer(request: dict[str, Any], frames: FrameView) -> bytes:
        seq = request["seq"]
        image = None if request["hw"] is None else frames.read(seq, request["hw"])
        return wire.encode(seq=seq, p=[p.tolist() for p in ask(request, image)])

    return answer


def open_ask(choice: ChoiceOnnx) -> Ask:
    """Open the model of a card; return the function that answers the requests of `process.py`."""
    card = load_card(choice.card)
    if isinstance(card, MarksCard):
        from edge.perception.scoring.choice.mark_scorer import open_network

        network = open_network(card, choice)
        return lambda request, image: network.ask(
            image, np.array(request["marks"], np.float32), np.array(request["others"], np.float32),
            request["target"], request["limit_s"],
        )  # fmt: skip
    from edge.perception.scoring.choice.factory import open_model

    model = open_model(choice)

    def ask(request: dict[str, Any], image: np.ndarray | None) -> list[np.ndarray]:
        questions = [MultipleChoice(text, tuple(answers)) for text, answers in request["asked"]]
        view = request["view"] if image is None else image
        return model.ask(request["rules"], view, questions, request["limit_s"])

    return ask


if __name__ == "__main__":
    sys.exit(run_child(load))
