"""Missions as users give them: through a kill -9, and as a drawing."""

from __future__ import annotations

import re

import pytest
from edge_processes import LOCKED, write_config

from edge.cli.main import main

WORDS = "Clean either the chair or the sofa, then turn on the tv; don't go to the bed before that."

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


@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_its_automaton_is_drawn(tmp_path, suffix):
    file = tmp_path / f"automaton.{suffix}"
    assert main(["mission", "explain", WORDS, "--draw", str(file)]) == 0
    begin = {"svg": b"<?xml", "png": b"\x89PNG"}[suffix]
    assert file.read_bytes().startswith(begin)
