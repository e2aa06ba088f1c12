"""The rules of `config/secure/fleet-router.json5`, with the certificates of docs/fleet.md."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from live_patience import PATIENCE_S, eventually
from secure_files import ROOT, etc_edge, page_commands, page_section

from edge.bus import client, presence, topics
from edge.bus.presence import Presence
from edge.bus.requests import RequestServer
from edge.bus.session import open_session, zenoh_session
from edge.bus.verbs import Verb
from edge.config import ZenohConfig
from edge.config.yaml_text import parse_yaml
from edge.host.ports import free_port

PAGE = (ROOT / "docs/fleet.md").read_text(encoding="utf-8")
ROBOTS = ("anna", "bob", "carl")
KEYS = [topic.key for topic in topics.ALL]


@pytest.fixture(scope="module")
def etc(tmp_path_factory) -> Path:
    folder = etc_edge(tmp_path_factory.mktemp("etc-edge"))
    page_commands(folder, "for who in anna bob carl", page=PAGE)
    for file in folder.glob("*.json5"):
        file.write_text(file.read_text().replace("/etc/edge", str(folder)))
    return folder


def test_a_robot_sees_itself_and_the_operator_sees_all(etc, monkeypatch):
    monkeypatch.setattr(presence, "ANSWER_S", PATIENCE_S)
    port = free_port()
    section = parse_yaml(page_section("robots/anna\n  file", etc, PAGE))["zenoh"]

    def settings(who: str) -> ZenohConfig:
        own = {"endpoint": f"tls/127.0.0.1:{port}", "file": str(etc / f"{who}.json5")}
        return ZenohConfig(**{**section, **own, "prefix": f"robots/{who}"})

    route = ZenohConfig(endpoint=f"tls/127.0.0.1:{port}", file=str(etc / "fleet-router.json5"))
    with zenoh_session(route, "route"), ExitStack() as stack:
        sessions = {
            who: stack.enter_context(open_session(settings(who), "listen"))
            for who in (*ROBOTS, "client")
        }
        operator = sessions["client"]
        for who in ROBOTS:
            present = Presence(sessions[who], settings(who))
            present.announce()
            stack.callback(present.close)
            key = settings(who).key(topics.MISSION_REQUEST)
            server = RequestServer(sessions[who], key, {"status": Verb(read_only=True)}, answer)
            stack.callback(server.close)
            stack.callback(serve(server))
        everyone = {f"robots/{who}" for who in ROBOTS}
        eventually(lambda: presence.online_sessions(operator, "robots/*").keys() == everyone)
        for who in ROBOTS:
            assert presence.online_sessions(sessions[who], "robots/*").keys() <= {f"robots/{who}"}
        heard = {who: put_by_all(sessions, who) for who in ROBOTS}
        assert heard == {who: {who} for who in ROBOTS}
        keys = {who: settings(who).key(topics.MISSION_REQUEST) for who in ROBOTS}
        for who in ROBOTS:  # the router may learn of queryables after the tokens
            for asker in (who, "client"):
                eventually(
                    lambda a=asker, w=who: asked(sessions[a], keys[w]) == {}, f"{asker}: {who}"
                )
            for asker in set(ROBOTS) - {who}:
                assert asked(sessions[asker], keys[who]) != {}, (asker, who)


def answer(request, now_ns) -> dict:
    return {}


def serve(server: RequestServer):
    """Serve on a thread; return a function that stops it."""
    over = threading.Event()

    def run() -> None:
        while not over.wait(0.005):
            server.serve(0)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()

    return end


def put_by_all(sessions: dict[str, zenoh.Session], whom: str) -> set[str]:
    """Return the clients that can publish on a key that the robot subscribes to."""
    ring = sessions[whom].declare_subscriber(f"robots/{whom}/**", zenoh.handlers.FifoChannel(4096))
    heard: set[str] = set()

    def hear() -> bool:
        for who, session in sessions.items():
            for key in KEYS:
                session.put(f"robots/{whom}/{key}", who)
        while (sample := ring.try_recv()) is not None:
            heard.add(sample.payload.to_string())
        return whom in heard

    eventually(hear)
    for _ in range(3):
        time.sleep(0.1)
        hear()
    ring.undeclare()
    return heard


def asked(session: zenoh.Session, key: str) -> dict | str:
    """Return the answer, or the error if there is none."""
    try:
        return client.send_request(session, key, {"do": "status"}, PATIENCE_S, "fleet")
    except client.RequestError as error:
        return str(error)
