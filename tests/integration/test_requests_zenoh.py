"""Requests between real processes: services that stop and die, clients that vanish, garbage."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import requests_peer
import zenoh
from edge_processes import write_config
from live_patience import PATIENCE_S, eventually

from edge.bus.client import RequestError, send_request
from edge.bus.session import open_session
from edge.config import ZenohConfig

PEER = Path(__file__).with_name("requests_peer.py")
KEY = "edge/mission/request"


@pytest.fixture
def config(endpoint, tmp_path) -> Path:
    return write_config(tmp_path, zenoh={"endpoint": endpoint})


@pytest.fixture
def service(script, endpoint) -> subprocess.Popen:
    return started_service(script, endpoint)


@pytest.fixture
def session(endpoint, service) -> Iterator[zenoh.Session]:
    with open_session(ZenohConfig(endpoint=endpoint), "connect") as session:
        yield session


def started_service(script: Callable[..., subprocess.Popen], endpoint: str) -> subprocess.Popen:
    process = script(PEER, "service", endpoint)
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.fixture
def command(capsys) -> Callable[..., tuple[int, str, list[str]]]:
    """Exit code, output and lines of the error output of a command, in this process."""

    def run(*arguments: object) -> tuple[int, str, list[str]]:
        code = requests_peer.main("request", *map(str, arguments))
        said = capsys.readouterr()
        return code, said.out, said.err.splitlines()

    return run


def release(service: subprocess.Popen, n: int = 1) -> None:
    """Let it understand `n` missions that are slow to understand."""
    service.stdin.write("\n" * n)
    service.stdin.flush()


def status(session: zenoh.Session) -> dict:
    return send_request(session, KEY, {"do": "status"}, PATIENCE_S, "mission")


def test_the_life_of_a_mission(config, service, command):
    def reply(verb: str, *more: str) -> dict:
        code, out, _ = command(verb, config, *more, "--json")
        assert code == 0
        return json.loads(out)

    assert reply("status")["formula"] == "F chair"
    assert reply("new", "F (bed & F tv)")["formula"] == "F (bed & F tv)"
    assert reply("pause")["paused"] is True
    assert reply("status")["paused"] is True
    assert reply("resume")["paused"] is False
    assert reply("new", "[] !bed", "--formula")["formula"] == "G !bed"
    assert reply("cancel")["phase"] == "cancelled"


def test_a_service_that_hangs_and_wakes_up(service, session):
    assert status(session)["phase"] == "exploring"
    service.send_signal(signal.SIGSTOP)
    with pytest.raises(RequestError, match=r"edge/mission/request: no answer within 0\.3 s"):
        send_request(session, KEY, {"do": "pause"}, 0.3, "mission")
    service.send_signal(signal.SIGCONT)
    assert status(session)["phase"] == "exploring"


def test_a_killed_service_answers_again_after_its_restart(script, endpoint, service, session):
    send_request(session, KEY, {"do": "new", "formula": "F bed"}, PATIENCE_S, "mission")
    service.kill()
    service.wait()
    with pytest.raises(RequestError, match="mission: "):
        send_request(session, KEY, {"do": "status"}, 2.0, "mission")
    started_service(script, endpoint)

    def answers() -> bool:  # the session finds the new one by itself
        try:
            return status(session)["formula"] == "F chair"
        except RequestError:
            return False

    eventually(answers)


def test_a_request_outlives_its_killed_client(script, config, service, session):
    client = script(PEER, "request", "new", config, "slow F sofa")
    assert service.stdout.readline() == "slow\n"
    client.kill()
    client.wait()
    assert status(session)["formula"] == "F chair"
    release(service)
    eventually(lambda: status(session)["formula"] == "F sofa")  # it was asked for
