"""Missions as users give them: in words, by request, through a kill -9, and with bad input."""

from __future__ import annotations

import json
import os
import re
import socket
from collections.abc import Callable

import pytest
from edge_processes import LOCKED, LOCKSTEP, write_config

from edge.cli.main import main

WORDS = "Clean either the chair or the sofa, then turn on the tv; don't go to the bed before that."

THREE = (
    "Clean either the chair or the sofa, then turn on the tv, then go to the bed; "
    "don't go to the toilet before that."
)


@pytest.mark.slow
def test_three_targets_with_a_choice_and_a_prohibition(edge, tmp_path):
    demo = edge("demo", "--mission", THREE, **LOCKSTEP)
    assert demo.wait() == 0, demo.output
    assert "target: sofa: sofa was seen" in demo.output, "the branch that was seen first"
    assert re.search(r"reached: (sofa|chair), then television, then bed", demo.output)
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "<svg" in page
    assert "Do not reach the toilet until the bed is reached" in page


HOLDS = """
import pathlib, time

class Holds:
    ticks = None

    def tick(self, result):
        if any(event.text.startswith("reached: sofa") for event in result.events):
            self.ticks = 0
        if self.ticks is not None:
            self.ticks += 1
            while self.ticks > 30 and not pathlib.Path("go on").exists():
                time.sleep(0.01)

    def close(self): ...
"""


def test_a_mission_resumes_after_kill_9(edge, endpoint, tmp_path):
    kept = tmp_path / "mission.json"
    words = "Clean either the chair or the sofa, then turn on the tv, then go to the trash can."
    mission = {"instruction": words, "checkpoint": str(kept), "search_limit_s": 100}
    # It holds the loop 6 s after the first target is reached: a map is kept every 5 s.
    (tmp_path / "holds.py").write_text(HOLDS)
    sinks = ["zenoh", {"kind": "holds:Holds"}]
    config = write_config(
        tmp_path, zenoh={"endpoint": endpoint}, mission=mission, sinks=sinks, **LOCKED
    )
    path = {"PYTHONPATH": str(tmp_path)}
    edge("sim", config)
    first = edge("run", config, **path).says("reached: sofa").says("target: television")
    first.until(lambda: b'"reached":["sofa"' in kept.read_bytes(), "it was never kept")
    first.until((tmp_path / "mission.json.map").exists, "the map was never kept")
    first.kill()
    (tmp_path / "go on").touch()
    second = edge("run", config, "--once", **path)
    assert second.wait() == 0, second.output
    restored = re.search(r"restored map \((\d+) m²\) and (\d+) objects", second.output)
    assert restored, second.output
    assert int(restored[1]) > 10
    assert int(restored[2]) > 0
    assert "continuing the saved mission" in second.output
    assert "reached: sofa (" not in second.output, "what was reached stays reached"
    assert "reached: sofa, then television, then trash can" in second.output


@pytest.fixture
def request_of(command) -> Callable[..., tuple[int, str]]:
    """Run `edge mission` in this process."""

    def request(*arguments: object, timeout_s: float = 60) -> tuple[int, str]:
        return command("mission", *arguments, "--timeout", timeout_s)

    return request


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_its_automaton_is_drawn(tmp_path, suffix):
    file = tmp_path / f"automaton.{suffix}"
    assert main(["mission", "explain", WORDS, "--draw", str(file)]) == 0
    begin = {"svg": b"<?xml", "png": b"\x89PNG"}[suffix]
    assert file.read_bytes().startswith(begin)


def test_a_language_model_that_is_silent_costs_only_its_mission(
    edge, endpoint, tmp_path, request_of
):
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen()
        url = f"http://127.0.0.1:{server.getsockname()[1]}/v1"
        translator = {"kind": "llm", "url": url, "time_limit_s": 2.0}
        mission = {"target": "toilet", "translator": translator}
        config = write_config(tmp_path, zenoh={"endpoint": endpoint}, mission=mission)
        edge("run", config).says("ready:")
        code, said = request_of("new", config, "go to the sofa")
        assert code == os.EX_DATAERR, said
        assert url.removesuffix("/v1") in said
        assert json.loads(request_of("status", config, "--json")[1])["formula"] == "F toilet"
