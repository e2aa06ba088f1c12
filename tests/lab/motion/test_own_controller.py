"""docs/controllers.md: its controller, word for word, drives the simulated robot to its target."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from edge_processes import edge, endpoint, write_config  # noqa: F401, fixtures

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "controllers.md").read_text("utf-8")
MAX_LINES = 20
SMALL = {"sensors": {"camera": {"width_px": 160, "height_px": 128, "rate_hz": 10}}}
# The controller avoids no obstacles, so the room has none; the robot has to turn to see the target.
CORNERS = [(0, 0), (6, 0), (6, 5), (0, 5)]
ROOM = {
    "name": "room",
    "start": [4.5, 2.5, 0.0],
    "rooms": [{"name": "living room", "rect": [0, 0, 6, 5]}],
    "walls": [
        {"start": a, "end": b} for a, b in zip(CORNERS, CORNERS[1:] + CORNERS[:1], strict=True)
    ],
    "objects": [{"category": "television", "at": [0.4, 2.5]}],
}


@pytest.fixture
def code() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    return code


def test_the_example_controller_is_as_short_as_documented(code):
    lines = [line for line in code.splitlines() if line and not re.match("import|from", line)]
    assert len(lines) <= MAX_LINES


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_plugin_controller_drives_the_robot_to_its_target(code, edge, endpoint, tmp_path):  # noqa: F811
    (tmp_path / "my_controller.py").write_text(code, "utf-8")
    (tmp_path / "room.json").write_text(json.dumps(ROOM), "utf-8")
    world = {"kind": "house", "house": str(tmp_path / "room.json")}
    sections = {**SMALL, "sim": {"world": world}}
    config = write_config(tmp_path, zenoh={"endpoint": endpoint}, **sections)
    service = edge("run", config, "--once").says("ready:")
    edge("sim", config, "--no-motion")
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "my_controller.py", endpoint]
    with subprocess.Popen(command, cwd=tmp_path, env=environ) as controller:
        try:
            assert service.wait() == 0, service.output
            assert "reached: television" in service.output
            assert controller.poll() is None
        finally:
            controller.kill()
