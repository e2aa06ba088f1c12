"""Program of a model's own process for VLM frontier selection, started by `process.py` only.

It loads the model and answers its requests; `edge.perception.process` describes the messages.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from edge.config import ChoiceOnnx
from edge.host.priority import lower_priority
from edge.perception.process import wire
from edge.perception.process.child import as_memory_error, set_up_child
from edge.perception.process.wire import FrameView
from edge.perception.runtime.card_types import MarksCard
from edge.perception.runtime.cards import load_card
from edge.perception.scoring.vlm.answers import MultipleChoice
from edge.text import read_json_object

log = logging.getLogger(__name__)

Answer = Callable[[dict[str, Any], Any], list[np.ndarray]]
"""(request, image or None) → the probabilities of the answers of each question."""


def main() -> int:
    """Load the model that stdin names, and answer requests until the service ends this process."""
    request, requests, control, frames = set_up_child()
    lower_priority()  # before the model starts threads, which inherit the priority
    try:
        answer = open_answer(ChoiceOnnx.model_validate(request["choice"]))
    except Exception as error:
        control.send(wire.encode_error(error))
        return 1
    control.send(wire.encode())
    try:
        answer_questions(requests, answer, frames)
    except BaseException:
        log.exception("model %s: its process ends after an error", request["choice"]["card"])
        os._exit(1)
    return 0


def open_answer(choice: ChoiceOnnx) -> Answer:
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

    def answer(request: dict[str, Any], image: np.ndarray | None) -> list[np.ndarray]:
        questions = [MultipleChoice(text, tuple(answers)) for text, answers in request["asked"]]
        view = request["view"] if image is None else image
        return model.ask(request["rules"], view, questions, request["limit_s"])

    return answer


def answer_questions(requests: socket.socket, answer: Answer, frames: FrameView) -> None:
    """Answer every request with the probabilities of the possible answers, or with the error."""
    while message := requests.recv(wire.MAX_BYTES):
        request = read_json_object(message)
        seq = request["seq"]
        try:
            image = None if request["hw"] is None else frames.read(seq, request["hw"])
            found = answer(request, image)
        except Exception as error:
            requests.send(wire.encode_error(as_memory_error(error), seq=seq))
        else:
            requests.send(wire.encode(seq=seq, p=[p.tolist() for p in found]))


if __name__ == "__main__":
    sys.exit(main())
