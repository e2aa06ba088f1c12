"""The product as its user starts it: processes that come, go, stop, and are talked nonsense to."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import Request, urlopen

import cv2
import numpy as np
import psutil
import pytest
from edge_processes import LOCKSTEP, STOP_S, write_config

from edge.bus.session import open_session
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.host.ports import free_port

RENAMED = {
    "camera/rgb": "front/image_raw", "odom": "base/odom", "goal": "map", "map": "grid",
    "goal_status": "nav/state", "sim/segmentation": "front/ids", "mission/request": "orders",
}  # fmt: skip
FAST = {**LOCKSTEP, "EDGE__SIM__STEP_S": "0.2"}  # a camera of 5 Hz sees enough


@pytest.fixture
def config(endpoint, tmp_path) -> Path:
    """Write a configuration of the built-in house with its own endpoint and a near target."""
    return write_config(tmp_path, zenoh={"endpoint": endpoint})


def check_report(folder: Path, outcome: str) -> None:
    """Check that the report has a picture, and a page without external files."""
    picture = cv2.imread(str(folder / "report.png"))
    assert min(picture.shape[:2]) > 300
    assert picture.std() > 5.0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f">{outcome}<" in page
    assert "data:image/png;base64," in page
    assert not re.search(r"(?:src|href)=[\"'](?!data:|#)", page)
    assert "<script" not in page


def test_the_demo_ends_with_reached_and_a_report(edge, tmp_path):
    demo = edge("demo", **FAST, EDGE__MISSION__TIME_LIMIT_S="1e6")
    assert demo.wait() == 0, demo.output
    assert demo.lines[-3].startswith("reached: ")
    assert [Path(line).name for line in demo.lines[-2:]] == ["report.html", "report.png"]
    check_report(tmp_path / "report", "reached")


def test_a_stopped_demo_leaves_a_report_and_no_process(edge, config, tmp_path):
    demo = edge("demo", config, "--target", "bed", "--report", "here").says("ready:")
    assert len(demo.children()) == 2
    demo.says("frontier")
    assert demo.stop(signal.SIGTERM) == 0, demo.output
    assert not demo.orphans()
    assert "stopped while" in demo.output
    check_report(tmp_path / "here", "searching")


def test_a_demo_with_a_page_takes_missions_until_ctrl_c(edge, config, tmp_path):
    file, token = tmp_path / "token", "a-token-of-the-tests"
    file.write_text(token)
    demo = edge("demo", config, "--live", EDGE__MISSION__TIME_LIMIT_S="1",
                EDGE__HTTP__PORT=str(free_port()), EDGE__HTTP__TOKEN_FILE=str(file))  # fmt: skip
    demo.says("mission failed; the live view stays open until Ctrl-C: http://127.0.0.1:")
    url = re.search(r"Ctrl-C: (http://[0-9.:]+/)", demo.output)[1]
    new = b'{"do": "new", "instruction": "go to the toilet"}'
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    with urlopen(Request(f"{url}mission/request", new, headers)) as answer:
        assert b"toilet" in answer.read()
    demo.says("target: toilet")
    demo.stop(signal.SIGINT)


def test_a_service_loads_nothing_that_is_not_configured(edge, config, tmp_path):
    hook = "import atexit, sys\natexit.register(lambda: print('loaded:', *sys.modules))\n"
    (tmp_path / "sitecustomize.py").write_text(hook)
    service = edge("run", config, PYTHONPATH=str(tmp_path)).says("ready:")
    assert service.stop(signal.SIGTERM) == 0, service.output
    (line,) = (line for line in service.lines if line.startswith("loaded: "))
    loaded = line.split()
    assert {"edge.loop.service", "edge.sources.zenoh"} <= {*loaded}
    unwanted = (
        "mcp", "anyio", "uvicorn", "rerun", "foxglove", "zmq", "torch", "transformers",
        "tokenizers", "edge.mcp_server", "edge.lab", "edge.sources.camera", "edge.sinks.rerun",
        "edge.perception.detection.fallback", "edge.perception.scoring.vlm.model",
    )  # fmt: skip
    assert not [name for name in loaded if name.startswith(unwanted)]


def test_a_demo_ends_when_its_simulator_does(edge, config):
    demo = edge("demo", config).says("ready:")
    victim = next(child for child in demo.children() if "sim" in child.cmdline())
    victim.kill()
    assert demo.wait() == os.EX_SOFTWARE
    assert "`edge sim --no-motion` ended too early (signal 9)" in demo.lines[-1]
    assert not demo.orphans()


def test_a_killed_demo_ends_its_children_and_leaves_no_files(edge, config, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    demo = edge("demo", config, TMPDIR=str(temporary)).says("ready:")
    children = demo.children()
    assert len(children) >= 2
    demo.process.kill()
    gone, alive = psutil.wait_procs(children, timeout=STOP_S)
    assert not alive
    assert len(gone) == len(children)
    assert list(temporary.iterdir()) == []


@pytest.mark.slow
def test_the_mission_outlives_simulator_and_controller(edge, endpoint, tmp_path):
    """Kill and restart both; start the controller after the goal. All topics are renamed."""
    settings = ZenohConfig(endpoint=endpoint, topics=RENAMED)
    config = write_config(tmp_path, zenoh=settings.model_dump())
    service = edge("run", config, "--once").says("ready:")
    simulator = edge("sim", config, "--no-motion")
    service.says("seen | map")
    controller = edge("sim", config, "--motion-only")
    with odometer(settings) as driven_m:
        service.until(lambda: driven_m[0] > 0.4, "the robot never drove")
        controller.kill()
        controller = edge("sim", config, "--motion-only")
        before_m = driven_m[0]
        service.until(lambda: driven_m[0] > before_m + 0.3, "it never drove on")
        simulator.kill()
        edge("sim", config, "--no-motion")  # the robot stands at the start again
        assert service.wait() == 0, service.output
    assert "reached: television" in service.output


@contextmanager
def odometer(settings: ZenohConfig) -> Iterator[list[float]]:
    """Metres that the robot has moved so far, in a list of one."""
    driven_m, last = [0.0], []

    def take(sample) -> None:
        x, y = messages.decode_odometry(sample.payload.to_bytes()).T_map_base[:2, 3]
        if last:
            driven_m[0] += float(np.hypot(x - last[0], y - last[1]))
        last[:] = [x, y]

    with open_session(settings, "connect") as session:
        session.declare_subscriber(f"{settings.prefix}/base/odom", take)
        yield driven_m
