"""A camera behind a real RTSP server, GStreamer's, that dies and comes back."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from edge_processes import write_config
from live_patience import PATIENCE_S, eventually

from edge.bus.client import send_request
from edge.bus.session import open_session
from edge.config import ZenohConfig
from edge.host.ports import free_port

SERVER = Path(__file__).parents[1] / "rtsp_server.py"
PYTHON = shutil.which("python3", path="/usr/bin") or sys.executable
PROBE = "import gi; gi.require_version('GstRtspServer', '1.0')"
NEEDED = "gir1.2-gst-rtsp-server-1.0 python3-gi gstreamer1.0-plugins-ugly"

pytestmark = pytest.mark.slow


@contextmanager
def serving(port: int) -> Iterator[None]:
    """Stream a moving picture of the simulated camera's size."""
    command = [PYTHON, SERVER, str(port), "320", "256"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "serves\n"
            yield
        finally:
            process.kill()


def test_the_mission_survives_its_server(edge, endpoint, tmp_path):
    if subprocess.run([PYTHON, "-c", PROBE], capture_output=True).returncode:
        pytest.skip(f"no RTSP server: apt-get install --no-install-recommends {NEEDED}")
    port = free_port()
    address = f"rtsp://user:swordfish@127.0.0.1:{port}/stream"
    options = {"address": address, "intrinsics": [277.1, 277.1, 160.0, 128.0]}
    robot = write_config(tmp_path, zenoh={"endpoint": endpoint})
    (tmp_path / "camera").mkdir()
    config = write_config(
        tmp_path / "camera", zenoh={"endpoint": endpoint}, report={"status_hz": 10},
        source={"kind": "camera", "options": options},
    )  # fmt: skip
    service = edge("run", config)
    edge("sim", robot)
    with open_session(ZenohConfig(endpoint=endpoint), "connect") as session:

        def status() -> dict:
            return send_request(session, "edge/mission/request", {"do": "status"}, PATIENCE_S, "t")

        def missing() -> bool:
            return "camera/rgb" in str(status()["robot"])

        with serving(port):
            service.says("ready:")
            eventually(lambda: not missing())
            began = status()
            assert began["phase"] == "searching"
        eventually(missing)
        gone = len(service.lines)
        with serving(port):
            eventually(lambda: any("sends images again" in line for line in service.lines[gone:]))
            eventually(lambda: not missing())
            goes_on = status()
    assert [goes_on[key] for key in ("instruction", "phase")] == [began["instruction"], "searching"]
    assert goes_on["elapsed_s"] > began["elapsed_s"]  # the same mission, which did not begin again
    # A fault is reported once, not at each of the attempts to open the camera again.
    assert service.output.count("opening it again and again") <= 1 + service.output.count(
        "sends images again"
    )
    assert "swordfish" not in service.output
