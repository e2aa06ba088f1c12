"""The service as systemd sees it: a process, a socket for its state, and signals.

No systemd takes part, for it wants a machine of its own; the socket is real, the process is, and
what hangs does hang.
"""

from __future__ import annotations

import json
import signal
import socket
import time
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest
from edge_processes import Edge, write_config
from live_patience import PATIENCE_S

from edge.host.ports import free_port

WATCHDOG_S = 2.0
UNSEEN = (
    "no usable observations: no message yet on edge/camera/rgb, edge/camera/depth, "
    "edge/camera/info, edge/odom"
)
TOKEN = "a token of more than sixteen letters".replace(" ", "-")
HANGING = """
import pathlib, threading

class Hanging:
    def tick(self, result):
        if pathlib.Path("hang").exists():
            threading.Event().wait()

    def close(self): ...
"""


@pytest.fixture(autouse=True)
def _not_under_nohup() -> Iterator[None]:
    """Restore SIGHUP: under nohup, child processes would ignore it."""
    before = signal.signal(signal.SIGHUP, lambda signum, frame: None)
    yield
    signal.signal(signal.SIGHUP, before)


class Manager:
    """The end of the socket that systemd would have."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "notify"
        self.heard: list[str] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self._socket.settimeout(PATIENCE_S)

    def hears(self, beginning: str) -> str:
        """Wait for a line that begins with this text."""
        while True:
            lines = self._socket.recv(65536).decode().split("\n")
            self.heard += lines
            if found := [line for line in lines if line.startswith(beginning)]:
                return found[0]

    def silence(self, least_s: float) -> bool:
        """Return True if no message comes for this time, after all pending ones."""
        self._socket.settimeout(least_s)
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            try:
                self.heard.append(self._socket.recv(65536).decode())
            except TimeoutError:
                return True
        return False

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path) -> Iterator[Manager]:
    listening = Manager(tmp_path)
    yield listening
    listening.close()


@pytest.fixture
def config(endpoint, tmp_path) -> Path:
    (tmp_path / "hanging.py").write_text(HANGING)
    return write_config(tmp_path, zenoh={"endpoint": endpoint}, sinks=[{"kind": "hanging:Hanging"}],
                        mission={"target": "bed"})  # fmt: skip


def change(config: Path, **sections: dict) -> None:
    config.write_text(json.dumps({**json.loads(config.read_text()), **sections}))


def started(edge, config: Path, manager: Manager, **environ: str) -> Edge:
    return edge(
        "run", config, NOTIFY_SOCKET=str(manager.path), PYTHONPATH=f"{config.parent}:{_path()}",
        WATCHDOG_USEC=str(int(WATCHDOG_S * 1e6)), **environ,
    )  # fmt: skip


def supervised(edge, config: Path, manager: Manager, **environ: str) -> Edge:
    service = started(edge, config, manager, **environ)
    manager.hears("READY=1")
    return service


def _path() -> str:
    return str(Path(__file__).parents[2])


def test_from_the_start_to_the_stop(edge, config, manager):
    service = supervised(edge, config, manager)
    steps = [line for line in manager.heard if line.startswith("STATUS=")]
    assert "STATUS=loading the detector" in steps
    assert steps[-1] == "STATUS=preparing kernels 7/7: tasks"
    assert "WATCHDOG=1" not in manager.heard, "the start has a limit of its own"
    manager.hears("WATCHDOG=1")
    manager.hears(f"STATUS=not ready: {UNSEEN} (searching: bed)")
    assert service.stop(signal.SIGTERM) == 0, service.output
    manager.hears("STOPPING=1")


@pytest.mark.slow  # a hang takes 10 s to be one
def test_a_hanging_loop_sends_no_watchdog_pings(edge, config, manager, tmp_path):
    port = free_port()
    (tmp_path / "http.token_file").write_text(TOKEN)
    service = supervised(
        edge, config, manager, EDGE__HTTP__PORT=str(port), EDGE__HTTP__TOKEN_FILE="/root/only",
        CREDENTIALS_DIRECTORY=str(tmp_path),
    )  # fmt: skip
    assert answer(port, "/readyz") == (503, b""), "a probe has no token"
    assert asked(port, "/healthz") == (200, [])
    service.until(lambda: asked(port, "/readyz") == (503, [UNSEEN]), "it names no input")
    manager.hears("WATCHDOG=1")
    (tmp_path / "hang").touch()
    assert manager.silence(2 * WATCHDOG_S), "systemd would have killed it by now"
    assert service.process.poll() is None
    service.process.send_signal(signal.SIGUSR1)  # as the unit has it before it is killed
    service.says("thread MainThread (most recent call last)")
    service.says("hanging.py")
    service.until(lambda: asked(port, "/healthz")[0] == 503, "it is still said to live")


def asked(port: int, path: str) -> tuple[int, list[str]]:
    status, body = answer(port, path, Authorization=f"Bearer {TOKEN}")
    return status, json.loads(body)["why"]


def answer(port: int, path: str, **headers: str) -> tuple[int, bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.request("GET", path, headers=headers)
    said = connection.getresponse()
    body = said.read()
    connection.close()
    return said.status, body


def test_a_hang_up_switches_all_that_changed_or_nothing(edge, config, manager):
    service = started(edge, config, manager)
    manager.hears("STATUS=loading the detector")
    mission = json.loads(config.read_text())["mission"]
    change(config, mission={**mission, "reach_m": 0.8})
    service.process.send_signal(signal.SIGHUP)
    manager.hears("READY=1")
    assert reloaded(manager) == "switched: mission.reach_m", "what is asked early is done later"
    good = {"policy": {"kind": "nearest_frontier"},
            "perception": {"detector": {"kind": "sim"}, "tau_det": 0.4}}  # fmt: skip
    change(config, **good)
    assert reload(service, manager) == "switched: perception.tau_det, policy"
    change(config, policy={"kind": "search"}, robot={"name": "other"})
    assert reload(service, manager) == (
        "refused, nothing has changed: robot.name: restart the service to change it"
    )
    config.write_text("perception: {detector: {kind: simm}}")
    assert "perception.detector.kind: unknown 'simm'" in reload(service, manager)
    assert service.stop(signal.SIGTERM) == 0, service.output


def reload(service: Edge, manager: Manager) -> str:
    """Return the reload's result from `systemctl status`."""
    service.process.send_signal(signal.SIGHUP)
    return reloaded(manager)


def reloaded(manager: Manager) -> str:
    manager.hears("RELOADING=1")
    manager.hears("READY=1")
    return manager.hears("STATUS=").partition("; reload: ")[2]
