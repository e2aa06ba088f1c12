"""A language model in a process of its own: asked, killed, brought back, ended."""

from __future__ import annotations

import os
import signal

import numpy as np
import psutil
import pytest
from live_patience import PATIENCE_S, eventually
from tiny_vlm import publish

from edge.config import ChoiceOnnx, ModelProcessConfig, PerceptionConfig
from edge.host import priority, resources
from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.choice.factory import make_view_scorer, open_model
from edge.perception.scoring.choice.letter_scorer import both_questions
from edge.perception.scoring.choice.process import ProcessModel, _decode
from edge.perception.scoring.choice.question import SYSTEM

RULES = ModelProcessConfig(timeout_s=PATIENCE_S, start_timeout_s=PATIENCE_S)
ASKED = both_questions(2, "lamp")


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """opened(family): a model in a process, and its configuration; closed at the end."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    made = []

    def opened(family, spoil=lambda card: None):
        card = publish(resources.models_dir(), family)
        spoil(card)
        choice = ChoiceOnnx(card="tiny", threads=1)
        made.append(ProcessModel(card, choice, RULES))
        return made[-1], choice

    yield opened
    for model in made:
        model.close()


def pid_of(model: ProcessModel) -> int | None:
    """None while it is started again."""
    return model._link and model._link._process.pid


def test_an_isolated_model_gives_the_same_answers_and_recovers(opened):
    model, choice = opened("smolvlm")
    here = open_model(choice)
    for seed, hw in [(0, (48, 64)), (1, (240, 320))]:
        view = np.random.default_rng(seed).integers(0, 255, (*hw, 3), np.uint8)
        told = (one.ask(SYSTEM, view, ASKED, PATIENCE_S) for one in (model, here))
        for there, ours in zip(*told, strict=True):
            np.testing.assert_array_equal(there, ours)
    with pytest.raises(ModelError, match=r"tiny: no answer within 0 s .*time_limit_s"):
        model.ask(SYSTEM, view, ASKED, 0.0)
    pid = pid_of(model)
    assert os.getpriority(os.PRIO_PROCESS, pid) == priority.BACKGROUND_NICE
    os.kill(pid, signal.SIGKILL)
    eventually(lambda: not psutil.pid_exists(pid))
    eventually(lambda: pid_of(model) not in (None, pid))
    assert len(model.ask(SYSTEM, view, ASKED, PATIENCE_S)) == 2
    last = pid_of(model)
    model.close()
    assert not psutil.pid_exists(last)
    with pytest.raises(ModelError, match="its process"):
        model.ask(SYSTEM, view, ASKED, PATIENCE_S)


def test_isolated_text_models_give_the_same_answers(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    resources.models_dir().mkdir(parents=True)
    publish(resources.models_dir(), "text")
    choice = {"kind": "onnx", "card": "tiny", "threads": 1}
    perception = PerceptionConfig.model_validate(
        {
            "isolation": "process",
            "process": RULES.model_dump(),
            "detector": {"kind": "onnx"},
            "choice": choice,
        }
    )
    asks = make_view_scorer(perception.choice, perception)
    there = asks._model
    assert isinstance(there, ProcessModel)
    assert not there.takes_images
    here = open_model(perception.choice)
    told = (one.ask(SYSTEM, "a bed", ASKED, PATIENCE_S) for one in (there, here))
    for one, other in zip(*told, strict=True):
        np.testing.assert_array_equal(one, other)
    asks.close()


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ({"seq": 1, "p": [[0.5, 0.5]]}, "seq: expected 2, got 1"),
        ({"seq": 2}, "p: .*got None"),
        ({"seq": 2, "p": []}, "p"),
        ({"seq": 2, "p": [["x", 1]]}, "p"),
        ({"seq": 2, "p": [[1.0]]}, "expected 2 probabilities"),
        ({"seq": 2, "p": [[0.5, float("nan")]]}, "expected 2 probabilities"),
        ({"seq": 2, "p": [[1.5, -0.5]]}, "expected 2 probabilities"),
        ({"seq": 2, "p": [[0.5, 0.2]]}, "expected 2 probabilities"),
    ],
)
def test_invalid_answers_of_a_process_are_refused(header, says):
    with pytest.raises(ValueError, match=says):
        _decode([2], 2, header, b"")
    (p,) = _decode([2], 2, {"seq": 2, "p": [[0.25, 0.75]]}, b"")
    assert p.tolist() == [0.25, 0.75]
