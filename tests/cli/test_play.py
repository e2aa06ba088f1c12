"""`edge play`: a robot's recording through the real service, and its report."""

from __future__ import annotations

import json
import os
import re
import threading

import numpy as np
import pytest
from bags import OPTICAL, RGB, N, camera, odometry, plain, together, write_bag, write_mcap
from public_logs import carmen

from edge.bus.wire import messages
from edge.cli.main import main
from edge.config import load
from edge.errors import UserError
from edge.lab.bench import service as bench

OURS = {
    "perception": {"detector": {"kind": "sim"}},
    "mission": {"target": "chair"},
    "sensors": {"lidar": {"z_m": 0.3}},
}


@pytest.fixture
def config(tmp_path) -> str:
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps(OURS))
    return str(path)


@pytest.fixture
def play(capsys):
    """Run the command; return its exit code, its output and its errors."""

    def run(*words: object) -> tuple[int, str, str]:
        code = main(["--log-level", "error", "play", *map(str, words)])
        content = capsys.readouterr()
        return code, content.out, content.err

    return run


def test_nothing_to_play_is_an_error_of_one_line(play, config, tmp_path):
    path = write_mcap(tmp_path / "robot.mcap", [])
    code, _, error = play(path, config, "--fast")
    assert code == os.EX_IOERR
    assert error.splitlines()[-1].startswith(f"{path}: it gives no observation: searched for")


@pytest.mark.parametrize("pace", [("--fast",), ("--rate", "8")])
def test_a_recording_is_played_and_its_inputs_are_listed(play, config, tmp_path, pace):
    folder, report = write_bag(tmp_path / "robot", plain()), tmp_path / "report"
    code, content, _ = play(folder, config, *pace, "--report", report)
    assert code == os.EX_OK
    lines = [line.split() for line in content.splitlines()]
    assert ["odom", "/odom", str(N), "nav_msgs/msg/Odometry"] in lines  # played inputs
    assert ["odom", "/odom", str(N), "-"] in lines  # and their outcome
    n = int(re.search(r"(\d+) observations", content)[1])
    assert n == N or (n > 0 and "--rate" in pace)  # this computer may be busy
    assert int(content.partition("map: ")[2].split()[0]) > 0
    assert {path.name for path in report.iterdir()} == {"report.png", "report.html"}


def test_playing_publishes_nothing_and_writes_no_checkpoint(play, tmp_path):
    """The robot drives and then stands for a long time without a goal."""
    kept = tmp_path / "checkpoint.json"
    mission = {"target": "chair", "checkpoint": str(kept), "stuck_s": 0.5, "time_limit_s": 0.5}
    sinks = [{"kind": "mcap", "options": {"folder": str(tmp_path / "sink")}}]
    path = tmp_path / "mine.yaml"
    path.write_text(json.dumps({**OURS, "mission": mission, "sinks": sinks}))
    robot = write_mcap(tmp_path / "robot.mcap", together(camera(n=90), odometry(n=90)))
    code, content, _ = play(robot, path, "--fast", "--report", tmp_path)
    assert code == os.EX_OK
    page = (tmp_path / "report.html").read_text()
    assert "stuck: " not in page
    assert "stopped while searching: chair" in content
    assert not kept.exists()
    assert not (tmp_path / "sink").exists()


def test_a_carmen_log_becomes_a_map(play, tmp_path):
    """A robot drives along a corridor of 4 m."""
    beams = " ".join("2.0" for _ in range(180))
    lines = [f"FLASER 180 {beams} {0.1 * k} 0 0 {0.1 * k} 0 0 {0.2 * k} host {0.2 * k}"
             for k in range(20)]  # fmt: skip
    log, path = tmp_path / "robot.log", tmp_path / "mine.yaml"
    log.write_text("\n".join(["ODOM 0 0 0 0 0 0 0 host 0", *lines]))
    mapping = {
        "mapping": {"input": "cloud"},
        "perception": {**OURS["perception"], "back_projection": "cloud"},
    }
    path.write_text(json.dumps({**OURS, **mapping}))
    code, content, _ = play(write_mcap(tmp_path / "robot.mcap", carmen(log)), path, "--fast")
    assert code == os.EX_OK
    assert int(content.partition("map: ")[2].split()[0]) >= 8


def test_a_covered_camera_is_named_by_the_bench(config, tmp_path):
    grey = np.full((12, 16, 3), 90, np.uint8)
    sent = [
        (topic, kind, ns, messages.encode_image(ns, OPTICAL, grey) if topic == RGB else payload)
        for topic, kind, ns, payload in plain()
    ]
    path = write_mcap(tmp_path / "robot.mcap", sent)
    with pytest.raises(UserError, match=r"in 20 s, .*camera/rgb: the image has one colour"):
        bench.run_bench(load(config), path, 20.0, threading.Event())


def test_replay_of_a_robot_recording_names_the_play_command(tmp_path, capsys):
    path = write_mcap(tmp_path / "robot.mcap", plain())
    assert main(["--log-level", "error", "replay", str(path)]) == os.EX_IOERR
    assert "`edge play FILE CONFIG`" in capsys.readouterr().err
