"""`edge models use`: following a swap to its end, and the desk it asks."""

from __future__ import annotations

import json
import os
from types import SimpleNamespace

import pytest
from simulated import simulated

from edge.bus.asking import OrderError
from edge.cli.main import main
from edge.loop.models_desk import ModelOrder, handle, parse_order
from edge.models.use import follow
from edge.perception.sim_detector import SimDetector
from edge.perception.swap.swapper import Swapper
from edge.perception.worker import DetectorWorker


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
        for s in follow(service, "new", True, lambda: next(left, None) is not None, 0.0)
    ]


@pytest.mark.parametrize("end", ["kept", "rolled back", "refused"])
def test_every_change_is_told_once(end):
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


def test_the_end_of_another_swap_is_not_told_as_the_end_of_this_one():
    with pytest.raises(OrderError, match="another swap has begun since"):
        followed(Service(swap("loading"), swap("kept", number=2)))


def test_patience_has_an_end():
    service = Service(swap("checking", progress="0 of 4 images at hand"))
    line = r"^models: still checking \(0 of 4 images at hand\), not waited for any longer; "
    with pytest.raises(OrderError, match=line):
        followed(service, patience=3)
    assert len(service.requests) == 4


def test_no_service_is_one_line_and_a_failure(tmp_path, capsys):
    path = tmp_path / "c.yaml"
    data = {"zenoh": {"endpoint": "tcp/127.0.0.1:1"}, "perception": {"detector": {"kind": "sim"}}}
    path.write_text(json.dumps(data))
    words = ["--log-level", "warning", "models", "use", "x", str(path), "--timeout", "0.1"]
    assert main(words) == os.EX_UNAVAILABLE
    assert capsys.readouterr().err == (
        "models: no service at tcp/127.0.0.1:1; start one with `edge run`\n"
    )


def test_without_a_configuration_it_is_that_of_a_robot(monkeypatch):
    asked = []
    monkeypatch.setattr("edge.models.use.run", lambda args: asked.append(args.config) or 0)
    assert main(["models", "use", "x"]) == main(["models", "use", "x", "robot.yaml"]) == 0
    assert asked == ["cpu", "robot.yaml"]


# -- the other side: what the desk takes ---------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "order"),
    [
        ({"do": "status"}, ModelOrder("status")),
        ({"do": "use", "model": "a"}, ModelOrder("use", "a")),
        ({"do": "use", "model": "a", "force": True}, ModelOrder("use", "a", True)),
    ],
)
def test_an_order(data, order):
    assert parse_order(json.dumps(data).encode()) == order


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        (b"", "not JSON"),
        (b"[]", "not a JSON object"),
        (b"{}", "do: unknown None (choices: use, status)"),
        (b'{"do": ["use"]}', "do: unknown a list"),
        (b'{"do": "use"}', "model: expected text, got None"),
        (b'{"do": "use", "model": 3}', "model: expected text, got 3"),
        (b'{"do": "use", "model": "' + b"a" * 201 + b'"}', "model: 201 characters, at most 200"),
        (b'{"do": "use", "model": "a", "force": 1}', "force: expected true or false"),
        (b'{"do": "use", "model": "a", "why": 1}', "'why': not taken with do: use"),
        (b'{"do": "status", "model": "a"}', "'model': not taken with do: status"),
    ],
)
def test_no_order(payload, text):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        parse_order(payload)
    assert text in str(caught.value)


def test_orders_are_answered_with_how_the_swap_stands():
    perception = simulated().perception
    worker = DetectorWorker(SimDetector(perception.detector, ["chair"]), inline=True)
    swapper = Swapper(perception, worker, lambda text, now_ns: None)
    said: list = []

    def asked(do: str, prepared: object = None) -> object:
        handle(swapper, SimpleNamespace(do=do, prepared=prepared, answer=said.append,
                                        refuse=said.append), 0)  # fmt: skip
        return said[-1]

    assert asked("status")["state"] == "idle"
    assert asked("use", ModelOrder("use", worker.detector.name)).endswith(" runs already")
    begun = asked("use", ModelOrder("use", "nothing"))
    assert (begun["model"], begun["number"]) == ("nothing", 1)
    swapper.close()
    json.dumps(said)
