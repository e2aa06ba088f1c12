"""Servers of models that are stopped or killed: the models here take over, and give back."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from live_patience import eventually
from live_service import live
from server_peer import MODEL

from edge.host.ports import free_port
from edge.perception.runtime.cards import load_card

pytestmark = pytest.mark.slow

PEER = Path(__file__).with_name("server_peer.py")


class ServerProcess:
    """A server of models; `leave` takes it away, and `come_back` brings it back.

    Args:
        kill: True: it is killed and started again; False: it is stopped (SIGSTOP) and hangs.
    """

    def __init__(self, kill: bool) -> None:
        self.port, self._kill = free_port(), kill
        self.url = f"http://127.0.0.1:{self.port}"
        self._start()

    def _start(self) -> None:
        command = [sys.executable, str(PEER), str(self.port)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"

    def leave(self) -> None:
        self.process.send_signal(signal.SIGKILL if self._kill else signal.SIGSTOP)
        if self._kill:
            self.process.communicate()

    def come_back(self) -> None:
        if self._kill:
            self._start()
        else:
            self.process.send_signal(signal.SIGCONT)

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture(params=[False, True], ids=["stopped", "killed"])
def server(request) -> Iterator[ServerProcess]:
    made = ServerProcess(request.param)
    yield made
    made.end()


@pytest.fixture
def reported(capsys):
    """Return a function that prints how long something took, also without -s."""

    def tell(what: str, since_s: float) -> None:
        with capsys.disabled():
            print(f"\n{what}: {time.monotonic() - since_s:.2f} s")

    return tell


def test_a_mission_continues_without_its_detectors_server(server, tmp_path, monkeypatch, reported):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path))
    card = load_card(MODEL).model_dump(mode="json", exclude={"file", "sha256", "path"})
    card |= {"name": "far", "server": {"url": server.url, "model": "m"}}
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "far.yaml").write_text(yaml.safe_dump(card))
    detector = {"kind": "onnx", "model": "far", "threads": 1, "fallback": MODEL}
    mission = {"target": "bed", "time_limit_s": 1e6}
    with live({"perception": {"detector": detector}, "mission": mission}) as service:

        def detail() -> str:
            return service.statuses[-1]["detector"]["detail"]

        def images() -> int:
            return service.running.worker.stats.done

        def detects() -> None:
            enough = images() + 3
            eventually(lambda: images() >= enough, "it detects nothing")

        eventually(lambda: not detail(), "the server is never used")
        detects()
        begun = service.statuses[-1]["mission"]["id"]
        server.leave()
        since_s = time.monotonic()
        eventually(lambda: f"{MODEL} answers until far does again" in detail(), "no fallback")
        detects()
        reported("from the end of the server to the third image of the local detector", since_s)
        assert service.statuses[-1]["detector"]["state"] == "ok"
        server.come_back()
        since_s = time.monotonic()
        eventually(lambda: not detail(), "the server is not used again")
        detects()
        reported("and back", since_s)
        assert service.statuses[-1]["mission"]["id"] == begun
        assert service.statuses[-1]["phase"] == "searching"
