"""A model on a server: the same boxes, and whatever the server does costs boxes only."""

from __future__ import annotations

import socket
import threading
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest
import yaml
from kserve_server import Handler, KServe, serving
from patience import PATIENCE_S
from tiny_clip import DIM, IMAGE, SIDE

from edge import config
from edge.host.ports import free_port
from edge.perception.detection import remote as module
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.detection.remote import RemoteDetector
from edge.perception.embedding.clip import ClipImageEncoder
from edge.perception.embedding.text import PromptError
from edge.perception.factory import make_detector
from edge.perception.runtime.card_types import ImageCard, InferenceServer
from edge.perception.runtime.cards import ModelError, load_card, verify_model
from edge.perception.runtime.kserve import ServerError

SMALL = "mini-house-256x320-int8-cpu"
PROMPTS = ("chair", "bed")
LIMIT_S = 60.0  # of a server that answers


def card_of(server: KServe | str, time_limit_s: float = LIMIT_S):
    url = server if isinstance(server, str) else server.url
    told = InferenceServer(url=url, model="m", time_limit_s=time_limit_s)
    return load_card(SMALL).model_copy(update={"server": told, "file": None, "name": "far"})


@pytest.fixture(scope="module")
def session():
    return onnxruntime.InferenceSession(str(load_card(SMALL).path))


@pytest.fixture(scope="module")
def model(session):
    """Return the server's model: the small detector itself."""

    def run(feed):
        found = session.run(["boxes", "scores"], feed)
        return dict(zip(("boxes", "scores"), found, strict=True))

    return run


@pytest.fixture
def picture(make_observation):
    rng = np.random.default_rng(3)
    rgb = rng.integers(0, 255, (200, 280, 3), np.uint8)
    rgb[60:150, 90:200] = (120, 70, 30)
    return make_observation(rgb=rgb)


@pytest.fixture
def far(monkeypatch):
    """Return a function that makes remote detectors; `clock` is theirs."""
    with ExitStack() as stack:

        def make(server, **more):
            card = card_of(server, **more)
            monkeypatch.setattr(
                "edge.perception.detection.onnx.load_detector_card", lambda name: card
            )
            settings = config.DetectorOnnx(model=SMALL, tau_vl=1e-6, threads=1)
            clock = SimpleNamespace(s=0.0)
            made = RemoteDetector(settings, card, PROMPTS, clock=lambda: clock.s)
            made.time = clock
            stack.callback(made.close)
            return made

        yield make


@pytest.mark.parametrize("binary", [True, False])
def test_boxes_are_those_of_the_model_here(model, far, picture, binary):
    here = OnnxDetector(config.DetectorOnnx(model=SMALL, tau_vl=1e-6, threads=1), PROMPTS)
    with serving(KServe(model, binary)) as server:
        there = far(server)
        for prompts in [PROMPTS, ("sofa",)][: 1 + binary]:  # numbers in JSON take long
            here.set_prompts(prompts)
            there.set_prompts(prompts)
            wanted, found = here.detect(picture), there.detect(picture)
            assert len(found.score) > 0
            np.testing.assert_allclose(found.xyxy_px, wanted.xyxy_px, atol=1e-3)
            np.testing.assert_allclose(found.score, wanted.score, atol=1e-5)
            assert (found.prompts, found.model) == (prompts, "far")
        if binary:
            best = there.best_scores(picture.rgb)
            np.testing.assert_allclose(best, here.best_scores(picture.rgb), atol=1e-5)
        assert there.health() == ("ok", "")
        assert server.connections == 1
        assert server.asked[:3] == ["/v2", "/v2/models/m", "/v2/models/m/infer"]


def test_an_unknown_prompt_is_reported_without_the_server(far):
    there = far("http://127.0.0.1:1")
    with pytest.raises(PromptError, match="xylograph"):
        there.set_prompts(["xylograph"])
    assert there.prompts == PROMPTS


def test_a_server_that_starts_later_is_found(model, far, picture):
    port = free_port()
    there = far(f"http://127.0.0.1:{port}")
    with pytest.raises(ServerError, match="no connection: nothing listens there; start the server"):
        there.detect(picture)
    state, detail = there.health()
    assert state == "degraded"
    assert detail.startswith(f"model far: server http://127.0.0.1:{port}: no connection: ")
    with serving(KServe(model), port) as server:
        with pytest.raises(ModelError, match="no connection"):  # not asked again at once
            there.detect(picture)
        assert server.asked == []
        there.time.s += module.PAUSE_S
        assert len(there.detect(picture).score)
        assert there.health() == ("ok", "")


def test_the_pause_doubles_to_its_limit(model, far, picture):
    with serving(KServe(model, behave=lambda h: h.send(b"", 503))) as server:
        there, pauses = far(server), []
        for _ in range(8):
            asked = len(server.asked)
            while len(server.asked) == asked:
                there.time.s += 0.1
                with pytest.raises(ModelError):
                    there.detect(picture)
            pauses.append(there.time.s)
        gaps = np.diff(pauses)
        assert gaps == pytest.approx([0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0], abs=0.11)
        server.behave = None
        there.time.s += 5.0
        there.detect(picture)
        server.behave = lambda h: h.send(b"", 503)
        with pytest.raises(ServerError):
            there.detect(picture)
        asked = len(server.asked)
        there.time.s += 0.2
        with pytest.raises(ServerError):
            there.detect(picture)
        assert len(server.asked) > asked


def cut(handler: Handler) -> None:
    handler.connection.shutdown(socket.SHUT_RDWR)


def silent(handler: Handler) -> None:
    handler.kserve.stopping.wait(PATIENCE_S)


def endless(handler: Handler) -> None:
    handler.send_response(200)
    handler.end_headers()
    while not handler.kserve.stopping.is_set():
        handler.wfile.write(b" " * 65536)


def tensors(**shapes):
    """Zeros of these shapes."""
    return lambda h: h.send_tensors({k: np.zeros(s, np.float32) for k, s in shapes.items()})


GOOD = {"boxes": (1, 1680, 4), "scores": (1, 1680, 1)}
BAD = [
    (cut, "no connection", "closed the connection before its answer was complete"),
    (silent, "timeout", "no complete answer within 0.3 s"),
    (lambda h: h.send(b"", 500), "refused", "HTTP 500: it does not say why"),
    (lambda h: h.send_json({"error": "out of\nmemory"}, 400), "refused",
     "HTTP 400: out of memory; see the server's log"),
    (lambda h: h.send(b"", 302, Location="http://a:b@elsewhere/?key=1"), "refused",
     "the server redirects to http://elsewhere/?*** (HTTP 302); configure the right URL"),
    (lambda h: h.send(b"<html>"), "invalid answer", "not JSON; check what runs there"),
    (lambda h: h.send_json({"outputs": []}), "invalid answer", "the answer lacks the output 'box"),
    (tensors(**(GOOD | {"boxes": (1, 1680, 5)})), "invalid answer",
     "'boxes' has the shape [1, 1680, 5]"),
    (tensors(**(GOOD | {"boxes": (1, 1679, 4)})), "invalid answer",
     "'boxes' has the shape [1, 1679, 4]"),
    (tensors(**(GOOD | {"scores": (1, 1680, 9)})), "invalid answer",
     "'scores' has the shape [1, 1680, 9]"),
    (endless, "invalid answer", "over 16 MB"),
]  # fmt: skip


def limit(there: RemoteDetector, seconds: float) -> None:
    session = there._session
    session._server = session._server.model_copy(update={"time_limit_s": seconds})


@pytest.mark.parametrize(("behave", "kind", "why"), BAD)
def test_a_server_fault_loses_one_image(model, far, picture, behave, kind, why, monkeypatch):
    limit_s = 0.3 if kind == "timeout" else LIMIT_S
    with serving(KServe(model)) as server:
        there = far(server)
        found = there.detect(picture)
        limit(there, limit_s)
        server.behave = behave
        with pytest.raises(ServerError) as error:
            there.detect(picture)
        assert error.value.kind == kind
        assert str(error.value).startswith(f"model far: server {server.url}: {kind}: {why}")
        assert "\n" not in str(error.value)
        assert there.health() == ("degraded", str(error.value))
        server.behave, there.time.s = None, 1e6
        limit(there, LIMIT_S)
        assert len(there.detect(picture).score) == len(found.score)
        assert there.health() == ("ok", "")


def test_a_server_may_return_with_another_model(model, far, picture):
    metadata = {"inputs": [{"name": "images", "datatype": "FP32", "shape": [1, 3, 64, 64]}]}
    with serving(KServe(model)) as server:
        there = far(server)
        there.detect(picture)
        server.run = lambda feed: {k: v[:, :100] for k, v in model(feed).items()}
        with pytest.raises(ServerError, match="invalid answer: 'boxes' has the shape"):
            there.detect(picture)
        there.time.s = 1e3
        there.detect(picture)
        assert len(there._inner._anchor_best) == 100
        server.behave = cut
        with pytest.raises(ServerError):
            there.detect(picture)
        server.behave, server.metadata, there.time.s = None, metadata, 2e3
        with pytest.raises(ServerError, match=r"invalid answer: 'images' is FP32 \(1, 3, 64, 64\)"):
            there.detect(picture)


def test_closing_does_not_wait_for_the_server(model, far, picture):
    asked = threading.Event()

    def hang(handler):
        asked.set()
        silent(handler)

    with serving(KServe(model)) as server:
        there = far(server)
        there.detect(picture)
        server.behave, outcome = hang, []
        thread = threading.Thread(target=lambda: outcome.append(_error(there, picture)))
        thread.start()
        assert asked.wait(PATIENCE_S)
        there.close()
        thread.join(LIMIT_S / 2)
        assert not thread.is_alive()
        assert "it was closed" in outcome[0]
        assert "it was closed" in _error(there, picture, 1e6)


def _error(there, picture, later_s=0.0) -> str:
    there.time.s += later_s
    try:
        there.detect(picture)
    except ModelError as error:
        return str(error)
    return ""


def test_a_server_model_starts_without_server_or_process(tmp_path, monkeypatch):
    write_card(tmp_path, monkeypatch, "http://127.0.0.1:1")
    chosen = config.DetectorOnnx(model="far")
    made = make_detector(config.PerceptionConfig(detector=chosen, isolation="process"), PROMPTS)
    assert isinstance(made, RemoteDetector)
    made.close()


def write_card(tmp_path, monkeypatch, url, **change) -> None:
    folder = tmp_path / "models"
    folder.mkdir(exist_ok=True)
    told = load_card(SMALL).model_dump(mode="json", exclude={"file", "sha256", "measured"})
    told |= {"name": "far", "server": {"url": url, "model": "m"}, **change}
    (folder / "far.yaml").write_text(yaml.safe_dump(told))
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"file": "far.onnx", "sha256": None}, "file: server is set, so this must be null"),
        ({"server": None}, "file: missing: name the model's file, or a server that runs the model"),
        ({"server": None, "file": "far.onnx"}, "sha256: missing: give the file's SHA-256, or null"),
        ({"server": {"url": "base:8000", "model": "m"}}, "not the URL of a model's server"),
        ({"server": {"url": "http://u:p@base", "model": "m"}}, "must not hold a password"),
        ({"server": {"url": "http://base", "model": "../m"}}, "string should match"),
        ({"server": {"url": "http://base"}}, "server.model: missing"),
    ],
)
def test_an_invalid_server_card_is_an_error_of_one_line(tmp_path, monkeypatch, change, why):
    write_card(tmp_path, monkeypatch, "http://127.0.0.1:1", **change)
    with pytest.raises(ModelError, match=r"^[^\n]*$") as error:
        load_card("far")
    assert why in str(error.value).lower() or why in str(error.value)
    assert ":p@" not in str(error.value)


def test_a_server_model_has_no_local_file(tmp_path, monkeypatch):
    write_card(tmp_path, monkeypatch, "http://127.0.0.1:1")
    card = load_card("far")
    assert not card.is_here()
    with pytest.raises(ModelError, match=r"the server http://127\.0\.0\.1:1 runs it$"):
        verify_model(card)


def test_an_image_encoder_on_a_server_gives_unit_rows(picture):
    def run(feed):
        assert feed["pixels"].shape == (1, 3, SIDE, SIDE)
        return {"embeddings": np.arange(DIM, dtype=np.float32)[None] + feed["pixels"].mean()}

    told = {k: v for k, v in IMAGE.items() if k != "file"}
    with serving(KServe(run)) as server:
        card = ImageCard(**told, server={"url": server.url, "model": "clip", "time_limit_s": 60})
        encoder = ClipImageEncoder(card, (), 1)
        row = encoder.embed(picture.rgb)
        server.behave = lambda h: h.send_tensors({"embeddings": np.zeros((1, DIM), np.float32)})
        with pytest.raises(ModelError, match="zero or not finite"):
            encoder.embed(picture.rgb)
        encoder.close()
    assert np.linalg.norm(row) == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(row) > 0).all()
