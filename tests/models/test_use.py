"""`edge models use`: following a swap to its end."""

from __future__ import annotations

import json
import os
from contextlib import nullcontext

import pytest

from edge.bus import client
from edge.bus.client import RequestError
from edge.cli.main import main
from edge.models.use import follow_swap


class Service:
    """Answers a request with the next of these swaps, then with the last for ever."""

    def __init__(self, *swaps: dict) -> None:
        self.swaps, self.requests = list(swaps), []

    def __call__(self, request: dict) -> dict:
        self.requests.append(request)
        return self.swaps.pop(0) if len(self.swaps) > 1 else self.swaps[0]


def swap(state: str, detail: str = "", number: int = 1, progress: str = "") -> dict:
    return {"state": state, "detail": detail, "number": number, "progress": progress}


def followed(service: Service, patience: int = 100) -> list[tuple[str, str]]:
    left = iter(range(patience))
    return [
        (s["state"], s["detail"])
        for s in follow_swap(service, "new", True, lambda: next(left, None) is not None, 0.0)
    ]


@pytest.mark.parametrize("end", ["kept", "rolled back", "refused"])
def test_every_change_is_reported_once(end):
    service = Service(
        swap("loading"), swap("loading", "building engine: 5 s"), swap("checking"),
        swap("checking"), swap("on probation", "fast", progress="1 of 9 images"),
        swap("on probation", "fast", progress="2 of 9 images"), swap(end, "so it is"),
    )  # fmt: skip
    assert followed(service) == [
        ("loading", ""), ("loading", "building engine: 5 s"), ("checking", ""),
        ("on probation", "fast"), (end, "so it is"),
    ]  # fmt: skip
    assert service.requests[0] == {"do": "use", "model": "new", "force": True}
    assert service.requests[1:] == [{"do": "status"}] * 6


def test_a_swap_that_is_over_at_once():
    assert followed(Service(swap("refused", "no"))) == [("refused", "no")]


def test_the_end_of_another_swap_is_not_reported():
    with pytest.raises(RequestError, match="another swap began before this one ended"):
        followed(Service(swap("loading"), swap("kept", number=2)))


def test_patience_has_an_end():
    service = Service(swap("checking", progress="0 of 4 images collected"))
    line = (
        r"^models: the change to new is not finished within --timeout \(state: checking, 0 of 4 "
        r"images collected\); the service goes on with the change: "
    )
    with pytest.raises(RequestError, match=line):
        followed(service, patience=3)
    assert len(service.requests) == 4


@pytest.mark.parametrize("more", [{}, {"key": "perception.choice.card"}])
def test_a_kept_model_names_the_key_that_keeps_it(monkeypatch, capsys, more):
    monkeypatch.setattr(client, "connect", lambda *_: nullcontext())
    monkeypatch.setattr(client, "send_request", lambda *_, **__: {**swap("kept", "ok"), **more})
    assert main(["models", "use", "new", "demo"]) == 0
    key = more.get("key", "perception.detector.model")
    assert capsys.readouterr().out == (
        f"kept: ok\nvalid until the service stops; to keep it, set {key}: new in demo\n"
    )


def test_without_a_service_the_command_fails_in_one_line(tmp_path, capsys):
    path = tmp_path / "c.yaml"
    data = {"zenoh": {"endpoint": "tcp/127.0.0.1:1"}, "perception": {"detector": {"kind": "sim"}}}
    path.write_text(json.dumps(data))
    words = ["--log-level", "warning", "models", "use", "x", str(path), "--timeout", "0.1"]
    assert main(words) == os.EX_UNAVAILABLE
    assert capsys.readouterr().err == (
        "models: no service at tcp/127.0.0.1:1; start one with `edge run`\n"
    )
