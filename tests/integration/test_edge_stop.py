"""A stopped robot stays stopped, over kills of its service, until it is released."""

from __future__ import annotations

import json
import signal
import time
import urllib.error
import urllib.request

import pytest
from edge_processes import write_config
from live_patience import PATIENCE_S, eventually

from edge.bus.client import send_request
from edge.bus.session import open_session
from edge.bus.wire import messages
from edge.config import ZenohConfig
from edge.host.ports import free_port

pytestmark = pytest.mark.slow

TOKEN = "a-token-of-a-test"


def test_a_stop_survives_kills_until_it_is_released(edge, endpoint, command, tmp_path, monkeypatch):
    (tmp_path / "token").write_text(TOKEN)
    port = free_port()
    config = write_config(
        tmp_path, zenoh={"endpoint": endpoint}, mission={"target": "toilet"},
        report={"status_hz": 10}, http={"port": port, "token_file": str(tmp_path / "token")},
    )  # fmt: skip
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))  # for the doctor
    service = edge("run", config).says("ready:")
    edge("sim", config)
    service.says("frontier")
    goals, poses, statuses = [], [], []
    with open_session(ZenohConfig(endpoint=endpoint), "connect") as session:
        for topic, received in (("goal", goals), ("odom", poses), ("status", statuses)):
            session.declare_subscriber(
                f"edge/{topic}", lambda sample, received=received: received.append(
                    sample.payload.to_bytes()
                )
            )  # fmt: skip

        def ask(key: str, **request: object) -> dict:
            return send_request(session, f"edge/{key}/request", request, PATIENCE_S, "test")

        def is_still() -> bool:
            """Return True if the robot did not move in its last 20 poses."""
            newest = [messages.decode_odometry(payload).T_map_base for payload in poses[-20:]]
            return len(newest) == 20 and abs(newest[0] - newest[-1]).max() < 1e-4

        def sent() -> set[bytes]:
            """Return the goals from now until ten more statuses have come."""
            goals.clear()
            enough = len(statuses) + 10
            eventually(lambda: len(statuses) >= enough)
            return set(goals)

        eventually(lambda: goals and not is_still())
        code, said = command("stop", config, "--why", "red button")
        assert (code, said.split(";")[0]) == (0, "stopped: red button")
        eventually(is_still)
        assert len(sent()) <= 1  # the goal to stand still
        assert command("mission", "status", config)[1].count("stopped: red button") == 1

        for round in range(2):
            service.stop(signal.SIGKILL)
            service = edge("run", config).says("stopped: red button").says("ready:")
            eventually(lambda: "stopped" in ask("mission", do="status")["robot"])
            answer = ask("mission", do="new", formula=f"F bed{round * ' '}")
            assert answer["phase"] == "stopped"
            assert "waits for `edge release`" in answer["reason"]
            ask("mission", do="resume")
            assert len(sent()) <= 1
            assert is_still()
        assert json.loads(statuses[-1])["stopped"] == "red button"
        assert "stop: the robot is stopped" in command("doctor", config)[1]
        page = f"http://127.0.0.1:{port}"
        ready = urllib.request.Request(
            f"{page}/readyz", headers={"Authorization": f"Bearer {TOKEN}"}
        )
        with pytest.raises(urllib.error.HTTPError) as caught:
            urllib.request.urlopen(ready)
        assert "stopped: red button" in caught.value.read().decode()

        code, said = command("release", config)
        assert (code, said.strip()) == (0, "not stopped")
        eventually(lambda: goals and not is_still())

        def press(token: str) -> dict:
            stop = urllib.request.Request(
                f"{page}/stop/request", b"{}",
                {"Authorization": f"Bearer {token}", "Content-Type": "application/json"},
            )  # fmt: skip
            with urllib.request.urlopen(stop) as response:
                return json.load(response)

        with pytest.raises(urllib.error.HTTPError, match="401"):
            press("wrong-token-of-a-test")
        assert press(TOKEN)["kept"]
        eventually(is_still)
        ask("release")
        service.stop(signal.SIGKILL)
        service = edge("run", config).says("ready:")
        time.sleep(0.1)
        assert ask("mission", do="status")["robot"]["stopped"] == ""
