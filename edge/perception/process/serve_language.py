"""The program of a language model's process, started by `language.py` only."""

from __future__ import annotations

import logging
import os
import socket
import sys

from edge.config import ChoiceOnnx
from edge.host.priority import give_way
from edge.perception.choice.onnx_scorer import open_model
from edge.perception.process import wire
from edge.perception.process.serve import begin, by_kind
from edge.perception.process.wire import FrameView
from edge.perception.vlm.model import Asked, LanguageModel
from edge.text import read_json_object

log = logging.getLogger(__name__)


def main() -> int:
    """Read from stdin what to do, load the model, answer until told to end."""
    told, questions, control, frames = begin()
    give_way()  # before its threads are started
    try:
        model = open_model(ChoiceOnnx.model_validate(told["choice"]))
    except Exception as error:
        control.send(wire.encode_error(error))
        return 1
    control.send(wire.encode())
    try:
        answer_questions(questions, model, frames)
    except BaseException:
        log.exception("model %s: its process ends", model.name)
        os._exit(1)
    return 0


def answer_questions(questions: socket.socket, model: LanguageModel, frames: FrameView) -> None:
    """Answer every request with the shares of its answers, or with what was raised."""
    while said := questions.recv(wire.MAX_BYTES):
        request = read_json_object(said)
        seq = request["seq"]
        try:
            view = request["view"] if request["hw"] is None else frames.read(seq, request["hw"])
            asked = [Asked(question, tuple(answers)) for question, answers in request["asked"]]
            found = model.ask(request["rules"], view, asked, request["limit_s"])
        except Exception as error:
            questions.send(wire.encode_error(by_kind(error), seq=seq))
        else:
            questions.send(wire.encode(seq=seq, p=[p.tolist() for p in found]))


if __name__ == "__main__":
    sys.exit(main())
