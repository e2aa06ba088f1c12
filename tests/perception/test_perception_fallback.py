"""A model on a server with a local fallback: answers, and retries of the server."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import onnxruntime
import pytest
import yaml
from chat_server import likeliest, send
from chat_server import serving as chatting
from kserve_server import Handler, KServe, serving
from patience import PATIENCE_S, eventually

from edge.config import ChoiceOpenai, ChoiceText, DetectorOnnx, PerceptionConfig
from edge.errors import UserError
from edge.perception import factory
from edge.perception.detection.fallback import FallbackDetector
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector
from edge.perception.runtime import fallback as module
from edge.perception.runtime.cards import ModelError, load_card
from edge.perception.runtime.fallback import FallbackModel
from edge.perception.scoring.choice.factory import make_view_scorer
from edge.perception.scoring.choice.question import Mark, MarkCosts, MarkedView

SMALL = "mini-house-256x320-int8-cpu"
CHOICE = "mini-house-choice"


class Server:
    """A model that fails on request; it keeps its questions and the held frames."""

    def __init__(self) -> None:
        self.fault: Exception | None = None
        self.asked: list[object] = []
        self.held: list[object] = []
        self.clock = SimpleNamespace(s=0.0)
        self.model = FallbackModel(
            "detector", "far", "near", self._ask, self.held.append, self.held.remove,
            clock=lambda: self.clock.s,
        )  # fmt: skip

    def _ask(self, item):
        self.asked.append(item)
        if self.fault is not None:
            raise self.fault
        return f"far {item}"

    def ask(self, item, after_s: float = 0.0):
        """Return the answer to an item, once the background is idle."""
        self.clock.s += after_s
        answer = self.model.ask(item, lambda: f"near {item}")
        eventually(lambda: self.model._background.idle)
        return answer


@pytest.fixture
def server():
    made = Server()
    yield made
    made.model.close()
    assert made.held == []


def test_a_new_fallback_asks_no_server(server):
    assert (server.model.detail, server.asked) == ("", [])


def test_the_local_model_answers_until_the_server_returns(server, caplog):
    caplog.set_level(logging.INFO)
    assert server.ask(1) == "far 1"
    server.fault = UserError("no connection")
    assert [server.ask(2), server.ask(3)] == ["near 2", "near 3"]
    assert server.asked == [1, 2]  # pause
    assert server.model.detail == "near answers until far does again: no connection"
    assert [server.ask(4, module.MAX_PAUSE_S), server.ask(7)] == ["near 4", "near 7"]
    assert server.asked == [1, 2, 4]  # in the background, and again only after a pause
    server.fault = None
    assert [server.ask(5, module.MAX_PAUSE_S), server.ask(6)] == ["near 5", "far 6"]
    assert server.asked == [1, 2, 4, 5, 6]
    assert server.model.detail == ""
    reported = [record.getMessage() for record in caplog.records]
    assert reported == [
        "detector: near answers until far does again: no connection",
        "detector: far answers again",
    ]


def test_an_unreliable_server_is_asked_at_growing_intervals(server):
    pauses = []
    for item in range(8):
        server.fault = UserError("oh no")
        server.ask(item, module.STEADY_S)
        pauses.append(server.model._next_s - server.clock.s)
        server.fault = None
        server.ask(item, module.MAX_PAUSE_S)
    assert pauses[:3] == [1.0, 2.0, 4.0]
    assert pauses[-1] == module.MAX_PAUSE_S
    server.clock.s += module.STEADY_S + 1.0
    server.fault = UserError("oh no")
    server.ask(9)
    assert server.model._next_s - server.clock.s == module.PAUSE_S


@pytest.mark.parametrize("fault", [ValueError("no image"), MemoryError()])
def test_an_error_not_of_the_server_is_raised(server, fault):
    server.fault = fault
    with pytest.raises(type(fault)):
        server.ask(1)
    assert server.model.detail == ""


@pytest.mark.parametrize("fault", [UserError("no connection"), ValueError("no image")])
def test_after_any_failure_the_server_gets_a_pause(server, fault):
    server.fault = UserError("no connection")
    server.ask(1)
    server.fault = fault
    server.ask(2, module.MAX_PAUSE_S)
    for item in range(3, 9):
        server.ask(item, 0.1 * module.PAUSE_S)
    assert server.asked == [1, 2]


# -- detectors --------------------------------------------------------------------------------


@pytest.fixture
def cards(tmp_path, monkeypatch):
    """Return a function that writes the card of the small detector for a server."""
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    folder = tmp_path / "models"
    folder.mkdir()

    def write(url: str, **server) -> None:
        card = load_card(SMALL).model_dump(mode="json", exclude={"file", "sha256", "path"})
        card |= {"name": "far", "server": {"url": url, "model": "m", **server}}
        (folder / "far.yaml").write_text(yaml.safe_dump(card))

    return write


def perception(fallback: str | None = SMALL) -> PerceptionConfig:
    detector = DetectorOnnx(model="far", tau_vl=1e-6, threads=1, fallback=fallback)
    return PerceptionConfig(detector=detector)


def test_a_detector_continues_while_its_server_is_away(cards, make_observation, monkeypatch):
    monkeypatch.setattr(module, "PAUSE_S", 0.0)
    monkeypatch.setattr(module, "MAX_PAUSE_S", 0.0)
    session = onnxruntime.InferenceSession(str(load_card(SMALL).path))

    def run(feed):
        return dict(zip(("boxes", "scores"), session.run(["boxes", "scores"], feed), strict=True))

    rgb = np.random.default_rng(3).integers(0, 255, (200, 280, 3), np.uint8)
    picture = make_observation(rgb=rgb)
    with serving(KServe(run)) as server:
        cards(server.url, time_limit_s=PATIENCE_S)
        detector = make_detector(perception(), ("chair", "bed"))
        assert isinstance(detector, FallbackDetector)
        assert detector._remote._session._server.time_limit_s == module.LONGEST_WAIT_S
        eventually(lambda: detector.detect(picture).model == "far")  # under load, 1.5 s may pass
        server.behave = Handler.send_nothing
        assert detector.detect(picture).model == SMALL
        assert detector.health().state == "ok"
        assert (
            f"{SMALL} answers until far does again: model far: server" in detector.health().detail
        )
        detector.set_prompts(("sofa",))
        assert detector.detect(picture).prompts == detector.prompts == ("sofa",)
        with pytest.raises(PromptError):
            detector.set_prompts(("",))
        server.behave = None
        eventually(lambda: detector.detect(picture).model == "far")
        assert detector.detect(picture).prompts == ("sofa",)
        assert detector.health() == ("ok", "")
        detector.close()


def test_a_fallback_on_a_server_is_refused(cards):
    cards("http://127.0.0.1:1")
    says = r"^perception\.detector\.fallback: model far runs on a server; name one of this[^\n]*$"
    with pytest.raises(ModelError, match=says):
        make_detector(perception("far"), ("chair",))


@pytest.mark.parametrize("error", [PromptError("no"), ModelError("no"), RuntimeError("no")])
def test_the_local_detector_is_closed_if_the_remote_cannot_be_opened(cards, monkeypatch, error):
    cards("http://127.0.0.1:1")
    local = Mock()
    monkeypatch.setattr(factory, "make_detector", lambda *_, **__: local)
    monkeypatch.setattr(factory, "open_detector", Mock(side_effect=error))
    with pytest.raises(type(error)):
        make_detector(perception(), ("chair",))
    local.close.assert_called_once_with()


# -- choice -----------------------------------------------------------------------------------


@pytest.fixture
def view(make_observation):
    rgb = np.full((256, 320, 3), 90, np.uint8)
    marks = (Mark(3, 80.0, 128.0, 0.3, 2.0), Mark(4, 240.0, 128.0, -0.3, 2.0))
    two = np.full(2, 3.0, np.float32)
    costs = MarkCosts(two, two, np.zeros(3, np.float32))
    return MarkedView(make_observation(rgb=rgb, hw=(256, 320)), "bed", marks, (), None, costs)


@pytest.mark.parametrize("kind", [ChoiceOpenai, ChoiceText])
def test_a_choice_continues_while_its_server_is_away(view, kind, monkeypatch):
    monkeypatch.setattr(module, "PAUSE_S", 0.0)
    monkeypatch.setattr(module, "MAX_PAUSE_S", 0.0)
    faults = [500]

    def behave(handler):
        if faults:
            return send(handler, b"", faults[0])
        yes_no = "Yes" in str(handler.asked)
        p = {"Yes": math.log(0.9), "No": math.log(0.1)}
        return send(handler, likeliest(p if yes_no else {"A": math.log(0.97)}))

    with chatting(behave) as server:
        choice = kind(url=server.url, model="m", fallback=CHOICE, time_limit_s=PATIENCE_S)
        scorer = make_view_scorer(choice, perception())
        first = scorer.answer(scorer.prepare(view))
        assert first.ids == (3, 4)
        assert scorer.detail.startswith(f"{CHOICE} answers until m at {server.url} does again: ")
        faults.clear()
        eventually(lambda: scorer.answer(scorer.prepare(view)) and not scorer.detail)
        assert scorer.answer(scorer.prepare(view)).p[0] > 0.9
        scorer.close()


def test_an_image_model_does_not_block_a_text_model(view):
    blind = replace(view, observation=replace(view.observation, rgb=None))
    with chatting(lambda handler: send(handler, likeliest({"A": -0.1, "Yes": -0.1}))) as server:
        choice = ChoiceText(url=server.url, model="m", fallback=CHOICE, time_limit_s=PATIENCE_S)
        scorer = make_view_scorer(choice, perception())
        assert scorer.answer(scorer.prepare(blind)).p[0] > 0.5
        scorer.close()
    scorer = make_view_scorer(choice, perception())
    prepared = scorer.prepare(blind)
    with pytest.raises(ModelError):  # the server is gone
        scorer.answer(prepared)
    scorer.close()


def test_a_fallback_without_a_card_is_refused():
    choice = ChoiceOpenai(url="http://127.0.0.1:1/v1", model="m", fallback="none")
    with pytest.raises(ModelError, match=r"perception\.choice\.fallback: .*'none': no such card"):
        make_view_scorer(choice, perception())
