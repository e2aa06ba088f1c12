"""Configurations of `config/secure` with the certificates that docs/security.md makes.

Real sessions in real processes.
"""

from __future__ import annotations

import base64
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
import zenoh
from edge_processes import LOCKSTEP, write_config
from live_patience import PATIENCE_S, eventually
from secure_files import (
    ROOT,
    etc_edge,
    out_of_date,
    page_commands,
    page_section,
    refusal,
    settings_of,
)
from secure_peer import KEYS, ROS

from edge.bus import client, topics
from edge.bus.session import open_session
from edge.config import ZenohConfig
from edge.config.yaml_text import parse_yaml
from edge.host.ports import free_port

PEER = Path(__file__).with_name("secure_peer.py")
IDLE = 120  # more than Zenoh's own limit of 100

# The keys below the prefix that each client may send, ask and hear.
REQUESTS = set(topics.REQUESTS)
EVERY = set(KEYS)
BY_SENSORS = {t.key for t in topics.ALL if t.writer in ("sensors", "simulator")}
BY_CONTROLLER = {t.key for t in topics.ALL if t.writer == "controller"}
BY_SERVICE = {t.key for t in topics.ALL if t.writer == "service"}
MAY_PUT = {
    "robot": BY_SENSORS,
    "controller": BY_CONTROLLER,
    "adapter": set(ROS),
    "operator": set(),
    "recorder": set(),
    "agent": set(),
}
MAY_ASK = {who: {topics.STOP_REQUEST} for who in MAY_PUT} | {
    "operator": REQUESTS,
    "agent": {topics.STOP_REQUEST, topics.AGENT_REQUEST},
}
MAY_HEAR = {
    "robot": BY_SERVICE | {"cmd_vel"},
    "controller": BY_SERVICE | {"odom"},
    "adapter": BY_SERVICE | set(ROS),
    "operator": BY_SERVICE,
    "recorder": EVERY,
    "agent": BY_SERVICE,
}


@pytest.fixture(scope="module")
def etc(tmp_path_factory) -> Path:
    return etc_edge(tmp_path_factory.mktemp("etc-edge"))


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory, etc) -> Path:
    """Return the same certificates of another authority."""
    return etc_edge(tmp_path_factory.mktemp("elsewhere"))


class Service:
    """The peer's process.

    Attributes:
        reached: all that has reached it: (`put` or `query`, key, payload).
    """

    def __init__(self, settings: ZenohConfig) -> None:
        self.reached: set[tuple[str, ...]] = set()
        self.process = subprocess.Popen(
            [sys.executable, str(PEER), settings.model_dump_json()],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout.readline() == "ready\n"
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.reached.add(tuple(line.rstrip().split(maxsplit=2)))

    def end(self) -> set[tuple[str, ...]]:
        self.process.terminate()
        self._reader.join(PATIENCE_S)
        return self.reached


@contextmanager
def service(settings: ZenohConfig) -> Iterator[Service]:
    running = Service(settings)
    try:
        yield running
    finally:
        running.process.kill()
        running.process.wait()


@pytest.mark.parametrize(
    ("kind", "prefix"),
    [("certificates", "edge"), ("passwords", "edge"), ("certificates", "robots/a")],
)
def test_each_client_has_exactly_its_permissions(etc, kind, prefix, tmp_path):
    if prefix != "edge":
        etc = shutil.copytree(etc, tmp_path / "etc")
        page_commands(etc, "sed -i")
    of = settings_of(etc, kind, free_port(), prefix)
    heard, may = {}, set()
    with service(of("robot")) as running:
        for who in MAY_PUT:
            may.update(("put", f"{prefix}/{key}", who) for key in MAY_PUT[who])
            may.update(("query", f"{prefix}/{key}", who) for key in MAY_ASK[who])
            with open_session(of(who), "connect") as session:
                heard[who] = heard_by(session, prefix, MAY_HEAR[who])
                attempt = partial(tried_all, session, prefix, who)
                eventually(lambda attempt=attempt: attempt() and may <= running.reached)
                attempt()
        time.sleep(0.2)  # for messages that must not come
        reached = running.end()
    assert reached == may
    assert heard == MAY_HEAR


def tried_all(session: zenoh.Session, prefix: str, who: str) -> bool:
    """Send and ask every key; return True if exactly the permitted queries were answered."""
    for key in EVERY:
        session.put(f"{prefix}/{key}", who)
    answered = {
        key
        for key in REQUESTS
        if list(session.get(f"{prefix}/{key}", payload=who, timeout=PATIENCE_S))
    }
    assert answered <= MAY_ASK[who], who
    return answered == MAY_ASK[who]


def heard_by(session: zenoh.Session, prefix: str, least: set[str]) -> set[str]:
    """Return the keys with messages, once each of `least` has had enough."""
    rings = {
        key: session.declare_subscriber(
            f"{prefix}/{key}", zenoh.handlers.RingChannel(8), allowed_origin=zenoh.Locality.REMOTE
        )
        for key in EVERY
    }
    counts = dict.fromkeys(EVERY, 0)

    def hear() -> bool:
        for key, ring in rings.items():
            while ring.try_recv() is not None:
                counts[key] += 1
        return all(counts[key] >= 5 for key in least)

    eventually(hear, "it does not hear what it may")
    return {key for key, n in counts.items() if n}


def test_strangers_are_refused_with_a_reason(etc, elsewhere, tmp_path):
    port = free_port()
    of = settings_of(etc, "certificates", port)
    bare = tmp_path / "bare.json5"
    ca = etc / "tls/ca.crt"
    bare.write_text(f'{{transport: {{link: {{tls: {{root_ca_certificate: "{ca}"}}}}}}}}')
    mixed = tmp_path / "mixed.json5"
    mixed.write_text(
        (elsewhere / "operator.json5").read_text().replace(str(elsewhere / "tls/ca.crt"), str(ca))
    )
    in_place = tmp_path / "in_place.json5"
    encoded = base64.b64encode(ca.read_bytes()).decode()
    in_place.write_text(
        f'{{transport: {{link: {{tls: {{root_ca_certificate_base64: "{encoded}"}}}}}}}}'
    )
    gone = tmp_path / "gone.json5"
    gone.write_text((etc / "operator.json5").read_text().replace("operator.key", "gone.key"))
    at = f"tls/127.0.0.1:{port}"
    old = out_of_date(etc, "operator.json5", "operator", "clientAuth")
    known = of("operator")
    strangers = {
        "our certificate is out of date": known.model_copy(update={"client_file": str(old)}),
        "the server requires a client certificate": known.model_copy(
            update={"client_file": str(bare)}
        ),
        "the server does not trust the issuer of our certificate": known.model_copy(
            update={"client_file": str(mixed)}
        ),
        "the server's certificate is not trusted": ZenohConfig(
            endpoint=at, client_file=str(elsewhere / "operator.json5")
        ),
        "a server is there but refuses the session": ZenohConfig(endpoint=f"tcp/127.0.0.1:{port}"),
        "inline certificates are not checked here": known.model_copy(
            update={"client_file": str(in_place)}
        ),
        "gone.key: no such file": known.model_copy(update={"client_file": str(gone)}),
    }
    with service(known) as running:
        for told, stranger in strangers.items():
            assert f"mission: refused at {stranger.address}: " in refusal(stranger, told)
        with open_session(known, "connect") as session:
            assert (
                client.send_request(session, "edge/mission/request", {}, PATIENCE_S, "mission")
                == {}
            )
        assert running.end() == {("query", "edge/mission/request", "{}")}


def test_a_client_certificate_cannot_identify_a_service(etc, tmp_path):
    port = free_port()
    known = settings_of(etc, "certificates", port)("operator")
    posing = tmp_path / "posing.json5"
    text = (etc / "service.json5").read_text()
    for kind in ("crt", "key"):
        text = text.replace(f"service.{kind}", f"recorder.{kind}")
    posing.write_text(text)
    with service(known.model_copy(update={"file": str(posing)})):
        assert refusal(known, "the server's certificate is not trusted")


def test_an_outdated_certificate_of_a_service_has_its_own_reason(etc):
    known = settings_of(etc, "certificates", free_port())("operator")
    old = out_of_date(etc, "service.json5", "service", "serverAuth")
    with service(known.model_copy(update={"file": str(old)})):
        assert refusal(known, "the server's certificate is out of date, or the clock here is wrong")


def test_a_wrong_password_is_refused_and_not_shown(etc, tmp_path):
    of = settings_of(etc, "passwords", free_port())
    wrong = tmp_path / "wrong.json5"
    wrong.write_text((etc / "password-operator.json5").read_text().replace("pw-of", "SENTINEL"))
    none = of("operator").model_copy(update={"client_file": None, "file": None})
    with service(of("robot")):
        for settings in (of("operator").model_copy(update={"client_file": str(wrong)}), none):
            assert "SENTINEL" not in refusal(settings, "asks for a user and a password")


def test_a_client_without_permission_gets_no_answer(etc):
    of = settings_of(etc, "certificates", free_port())
    with (
        service(of("robot")),
        open_session(of("robot"), "connect") as session,
        pytest.raises(client.RequestError, match="access rules"),
    ):
        client.send_request(
            session, "edge/mission/request", {"do": "status"}, PATIENCE_S, "mission"
        )


@pytest.mark.parametrize("kind", ["certificates", "passwords"])
def test_idle_connections_do_not_lock_out_others(etc, kind):
    port = free_port()
    settings = settings_of(etc, kind, port)("operator")
    with service(settings), ExitStack() as idle:
        for _ in range(IDLE):
            idle.enter_context(socket.create_connection(("127.0.0.1", port)))
        with open_session(settings, "connect") as session:
            assert (
                client.send_request(session, "edge/mission/request", {}, PATIENCE_S, "mission")
                == {}
            )


@pytest.mark.slow
def test_a_robot_is_driven_as_the_documentation_says(etc, edge, tmp_path):
    """Each process has its own certificate; a stranger with false messages changes nothing."""
    port = free_port()
    section = page_section("0.0.0.0:7447", etc).replace("7447", str(port))
    config = write_config(tmp_path, **parse_yaml(section))
    reached = {**LOCKSTEP, "EDGE__ZENOH__ENDPOINT": f"tls/localhost:{port}"}
    service = edge("run", config, "--once", **LOCKSTEP).says("ready:")
    robot = {**reached, "EDGE__ZENOH__CLIENT_FILE": str(etc / "robot.json5")}
    controller = {**reached, "EDGE__ZENOH__CLIENT_FILE": str(etc / "controller.json5")}
    status = edge("mission", "status", config, **reached)
    assert status.wait() == 0, status.output
    assert "television" in status.output
    refused = edge("mission", "cancel", config, **robot)
    assert refused.wait() == os.EX_UNAVAILABLE
    assert "access rules" in refused.output
    stranger = edge(
        "mission", "cancel", config, EDGE__ZENOH__ENDPOINT=f"tcp/localhost:{port}",
        EDGE__ZENOH__CLIENT_FILE="null", EDGE__ZENOH__FILE="null",
    )  # fmt: skip
    assert stranger.wait() == os.EX_UNAVAILABLE
    assert "refuses the session" in stranger.output
    edge("sim", config, "--no-motion", **robot)
    edge("sim", config, "--motion-only", **controller)
    assert service.wait() == 0, service.output
    assert "is open" not in service.output


@pytest.mark.parametrize("page", ["security", "fleet"])
def test_the_page_links_only_to_existing_files(page):
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    named = re.findall(r"\]\(\.\./([\w./]+)\)", text)
    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []
