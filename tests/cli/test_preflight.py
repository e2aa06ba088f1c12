"""All that a configuration names is checked before anything is loaded, and the same by all."""

from __future__ import annotations

import json
import os
import sys

import pytest
from simulated import simulated

from edge import launch
from edge.cli.main import main
from edge.cli.preflight import check, check_mission
from edge.config import Config
from edge.errors import UserError
from edge.host.ports import free_port
from edge.launch import open_service

ONNX = {"kind": "onnx", "model": "mini-house-256x320-int8-cpu"}
CAMERA = {"kind": "zmq", "options": {"address": "tcp/127.0.0.1:5555"}}


class Fails:
    """A sink that cannot be made."""

    def __init__(self) -> None:
        raise OSError("no such printer")

    def tick(self, result: object) -> None:
        """Never called."""

    def close(self) -> None:
        """Never called."""


def perception(**sections: object) -> dict:
    return {"perception": {"detector": {"kind": "sim"}, **sections}}


NAMED = [
    ({"sinks": ["zenho"]}, "mine.yaml: sinks.0.kind: unknown 'zenho' (choices: zenoh, ros2"),
    (
        {"sinks": [{"kind": "foxglove", "options": {"port": 70000}}]},
        "sinks: foxglove: port: expected a number from 0 to 65535, got 70000",
    ),
    (
        {"sinks": [{"kind": "mcap", "options": {"folder": "x", "compression": "zip"}}]},
        "sinks: mcap: compression: unknown 'zip'",
    ),
    ({"source": {"kind": "zmk"}}, "mine.yaml: source.kind: unknown 'zmk' (choices: zenoh, ros2"),
    ({"source": CAMERA}, "mine.yaml: source.options.address: tcp/127.0.0.1:5555: "),
    ({"mapping": {"input": "cloud"}}, "mine.yaml: mapping.input: cloud needs sensors.lidar"),
    ({"policy": {"kind": "no.such:Policy"}}, "mine.yaml: policy.kind: 'no.such:Policy' cannot"),
    (
        {"mission": {"planner": {"kind": "no.such:Planner"}}},
        "mine.yaml: mission.planner.kind: 'no.such:Planner' cannot be imported: Module",
    ),
    (
        {"mission": {"translator": {"kind": "auto", "card": "nobody"}}},
        "mine.yaml: mission.translator.card: model 'nobody': no such card (choices: ",
    ),
    (
        {"mission": {"translator": {"kind": "llm", "url": "ftp://h/v1", "model": "m"}}},
        "mine.yaml: mission.translator: ",
    ),
    (
        {"tasks": {"planner": {"kind": "model", "url": "ftp://h/v1", "model": "m"}}},
        "mine.yaml: tasks.planner: not the URL of a chat server: 'ftp://h/v1'",
    ),
    ({"zenoh": {"endpoint": "tcp/127.0.0.1"}}, "zenoh.endpoint: cannot listen to tcp/127.0.0.1: "),
    ({"zenoh": {"file": "nowhere.json5"}}, "zenoh.file: nowhere.json5: "),
    ({"http": {"port": 7480, "token_file": "nowhere"}}, "http.token_file: nowhere: "),
    (
        perception(detector={"kind": "onnx", "model": "nobody"}),
        "mine.yaml: perception.detector.model: model 'nobody': no such card (choices: ",
    ),
    (
        perception(detector={"kind": "onnx", "model": "mini-house-text"}),
        "mine.yaml: perception.detector.model: model 'mini-house-text': is a model of task 'text'",
    ),
    (
        perception(detector={"kind": "onnx", "model": "yolo-world-s-256x320-fp32"}),
        "yolo-world-s-256x320-fp32 is not there; run `edge models export",
    ),
    (
        perception(detector={**ONNX, "providers": ["GPU"]}),
        "perception.detector.providers: 'GPU' is not available here (available: ",
    ),
    (perception(similarity="nobody"), "mine.yaml: perception.similarity: model 'nobody': no such"),
    (
        perception(choice={"kind": "onnx", "card": "nobody"}),
        "mine.yaml: perception.choice.card: model 'nobody': no such card",
    ),
    (
        perception(choice={"kind": "openai", "url": "ftp://h", "model": "m"}),
        "perception.choice: not the URL of a chat server: 'ftp://h'",
    ),
    (
        perception(detector={**ONNX, "fallback": "nobody"}),
        "mine.yaml: perception.detector.fallback: model 'nobody': no such card",
    ),
    (
        perception(choice={
            "kind": "openai", "url": "http://h/v1", "model": "m", "fallback": "nobody",
        }),
        "mine.yaml: perception.choice.fallback: model 'nobody': no such card",
    ),
    (
        perception(segmenter={"kind": "onnx", "model": "nobody"}),
        "mine.yaml: perception.segmenter.model: model 'nobody': no such card",
    ),
    (
        perception(detector=ONNX, load_shedding={"levels": [{"model": "nobody"}]}),
        "mine.yaml: perception.load_shedding.levels.0.model: model 'nobody': no such card",
    ),
]  # fmt: skip


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """No model of this machine's user counts, and no signal handler is left behind."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.delenv("EDGE_VOCABULARY", raising=False)
    monkeypatch.setattr("signal.signal", lambda *_: None)


def line_of(command: str, sections: dict, capsys) -> tuple[int, str]:
    """Exit code and last words of a command."""
    with open("mine.yaml", "w", encoding="utf-8") as file:
        json.dump({**perception(), **sections}, file)
    code = main(["--log-level", "error", command, "mine.yaml"])
    return code, capsys.readouterr().err.strip()


@pytest.mark.parametrize(("sections", "says"), NAMED)
def test_config_and_run_refuse_the_same_with_the_same_line(sections, says, capsys, monkeypatch):
    monkeypatch.setattr(launch, "prepare_mission", None)  # nothing is begun
    code, line = line_of("config", sections, capsys)
    assert says in line
    assert "\n" not in line
    assert code != os.EX_OK
    assert line_of("run", sections, capsys) == (code, line)


def test_config_and_run_refuse_an_unknown_target_alike(capsys, monkeypatch):
    monkeypatch.setattr(launch, "warm_up", None)
    sections = {**perception(detector=ONNX), "mission": {"target": "unicorn"}}
    sections["zenoh"] = {"endpoint": f"tcp/127.0.0.1:{free_port()}"}
    code, line = line_of("config", sections, capsys)
    assert line.startswith("prompt 'unicorn': this model knows only")
    assert line_of("run", sections, capsys) == (code, line)


def test_all_faults_are_reported_at_once(capsys):
    sections = {"sinks": ["zenho"], "policy": {"kind": "no.such:Policy"}}
    code, lines = line_of("config", {**perception(similarity="nobody"), **sections}, capsys)
    assert code == os.EX_CONFIG
    assert [line.split(": ")[1] for line in lines.splitlines()] == [
        "sinks.0.kind", "policy.kind", "perception.similarity",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("package", "sections", "says"),
    [
        ("foxglove", {"sinks": ["foxglove"]}, "pip install 'edge-vln[foxglove]'"),
        ("rerun", {"sinks": ["rerun"]}, "pip install 'edge-vln[rerun]'"),
        ("zmq", {"source": CAMERA}, "source.kind: zmq needs pyzmq: pip install 'edge-vln[zmq]'"),
        ("onnxruntime", perception(detector=ONNX), "pip install edge-vln[cpu] (or [gpu])"),
        (
            "pydantic_monty",
            {"tasks": {"planner": {"kind": "model", "url": "http://h/v1", "model": "m"}}},
            "pip install 'edge-vln[tasks]'",
        ),
        (
            "tensorrt",
            perception(detector={**ONNX, "providers": ["tensorrt"]}),
            "pip install edge-vln[tensorrt]",
        ),
    ],
)
def test_a_missing_extra_fails_before_the_start(package, sections, says, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UserError) as caught:
        check(simulated(sections))
    assert says in str(caught.value)


def test_a_sink_that_cannot_open_fails_before_kernels_are_compiled(monkeypatch):
    monkeypatch.setattr(launch, "warm_up", None)
    monkeypatch.setattr(launch, "make_detector", None)
    config = launch.with_free_port(simulated({"sinks": [f"{__name__}:Fails"]}))
    with (
        pytest.raises(UserError, match=r"sinks\.0\.options: .*: OSError: no such printer"),
        open_service(config, []),
    ):
        pass


@pytest.mark.parametrize(
    ("mission", "refused"),
    [
        ({"instruction": "go to the bed, and never go to the bed"}, True),
        ({"instruction": "go to the bed"}, False),
        # A server would have to read it, or a checkpoint's mission goes on in its place.
        (
            {
                "instruction": "go to the bed, and never go to the bed",
                "translator": {"kind": "llm", "url": "http://127.0.0.1:1/v1", "model": "m"},
            },
            False,
        ),
        (
            {
                "instruction": "go to the bed, and never go to the bed",
                "checkpoint": "mission.checkpoint",
            },
            False,
        ),
    ],
)
def test_the_configured_mission_is_checked_if_no_server_is_needed(mission, refused):
    config: Config = simulated({"mission": mission})
    if not refused:
        check_mission(config)
        return
    with pytest.raises(UserError):
        check_mission(config)
