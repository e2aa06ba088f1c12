"""A secret that is put wherever one may be is in nothing that `edge` says, writes or shows."""

from __future__ import annotations

import base64
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest
from edge_processes import write_config
from live_patience import PATIENCE_S

from edge.host.ports import free_port
from edge.host.resources import data_dir

pytestmark = pytest.mark.slow

SECRET = "s3nt1nel"
SHAPES = (SECRET, base64.b64encode(SECRET.encode()).decode().rstrip("="), SECRET.encode().hex())
SINK = """
class Sink:
    def __init__(self, password, urls):
        self.password = password

    def tick(self, result): ...

    def close(self): ...
"""
SERVICE = """{transport: {auth: {usrpwd: {user: "edge", password: "%s", dictionary_file: "%s"}}}}"""


@pytest.fixture
def config(endpoint, tmp_path) -> Path:
    """Return a service with a password, and secrets in every key that may hold one."""
    (tmp_path / "own_sink.py").write_text(SINK)
    users, service = tmp_path / "users.txt", tmp_path / "service.json5"
    users.write_text(f"operator:{SECRET}\n")
    service.write_text(SERVICE % (SECRET, users))
    client = (data_dir("config") / "secure" / "password-client.json5").read_text()
    for name, password in (("client", SECRET), ("wrong", f"not {SECRET}")):
        (tmp_path / f"{name}.json5").write_text(client.replace("of the operator", password))
    broken = client.replace('"of the operator"', f'{{"{SECRET}": "{SECRET}"}}')
    (tmp_path / "broken.json5").write_text(broken)
    (tmp_path / "token").write_text(2 * SECRET)
    server = f"http://127.0.0.1:{free_port()}/v1?key={SECRET}"
    options = {"password": SECRET, "urls": [f"https://me:{SECRET}@example.org/a"]}
    return write_config(
        tmp_path,
        zenoh={
            "endpoint": endpoint,
            "file": str(service),
            "client_file": str(tmp_path / "client.json5"),
            "shared_memory": False,
        },
        http={"port": free_port(), "token_file": str(tmp_path / "token")},
        mission={"target": "bed", "translator": {"kind": "llm", "url": server}},
        sinks=["zenoh", {"kind": "own_sink:Sink", "options": options}],
    )


@pytest.fixture
def environ(tmp_path) -> dict[str, str]:
    path = os.pathsep.join([str(tmp_path), *sys.path])
    return {"OPENAI_API_KEY": SECRET, "PYTHONPATH": path, "RUST_LOG": "trace"}


@pytest.fixture
def say(tmp_path, environ) -> Callable[..., str]:
    """Run an `edge` command to its end; return its whole output."""

    def run(*words: object, **more: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "edge.cli", "--log-level", "debug", *map(str, words)],
            cwd=tmp_path, env={**os.environ, **environ, **more}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=240,
        )  # fmt: skip
        return done.stdout

    return run


def asked(port: int) -> str:
    """Return the service's HTTP answers to a client with the token."""
    connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.request("GET", "/readyz", headers={"Authorization": f"Bearer {2 * SECRET}"})
    body = connection.getresponse().read()
    connection.close()
    return body.decode()


def lines_with_secret(text: str) -> list[str]:
    """Return the lines that contain the secret in any encoding."""
    return [line for line in text.splitlines() if any(shape in line for shape in SHAPES)]


def files_of(folder: Path) -> Iterator[str]:
    for path in folder.rglob("*"):
        if path.is_file():
            yield path.read_bytes().decode("utf-8", "replace")


def test_no_secret_is_shown(edge, config, tmp_path, environ, say):
    report = tmp_path / "report"
    service = edge("--log-level", "debug", "run", config, "--report", report, **environ)
    service.says("ready:")
    said = {
        "page": asked(json.loads(config.read_text())["http"]["port"]),
        "status": say("mission", "status", config, "--json"),
        "new": say("mission", "new", config, "go to the bed"),
        "swap": say("models", "use", config, "no-such-model"),
        "wrong password": say(
            "mission", "status", config, "--timeout", "0.1",
            EDGE__ZENOH__CLIENT_FILE=str(tmp_path / "wrong.json5"),
        ),
        "broken file": say(
            "mission", "status", config, EDGE__ZENOH__CLIENT_FILE=str(tmp_path / "broken.json5")
        ),
        "second service": say("run", config, EDGE__HTTP__PORT="null"),
        "doctor": say("doctor", config),
        "doctor --json": say("doctor", config, "--json"),
        "config": say("config", config),
        "fault": say("config", config, EDGE__ZENOH__PREFIX=f"tls/h:1#key={SECRET}"),
        "another fault": say("config", config, EDGE__SINKS=f"{{a: 'http://x?{SECRET}'"),
        "key in endpoint": say(
            "config", config, EDGE__ZENOH__ENDPOINT=f"tls/h:1#listen_private_key_base64={SECRET}"
        ),
    }  # fmt: skip
    arguments = [process.cmdline() for process in (*service.children(),)]
    assert service.stop(signal.SIGTERM) == 0, service.output
    said["service"] = service.output
    said["arguments"] = json.dumps(arguments)
    # Each came as far as its secret.
    for name, words in {
        "page": '"state": "running"',
        "status": '"phase"',
        "new": "refused: ",
        "swap": "no-such-model",
        "wrong password": "asks for a user and a password",
        "broken file": "broken.json5: line ",
        "second service": "is in use",
        "doctor": "the service cannot listen",
        "doctor --json": '"findings"',
        "config": '"password": "***"',
        "fault": "zenoh.prefix",
        "another fault": "cannot be read as YAML",
        "key in endpoint": "path of that file into zenoh.file",
        "service": "zenoh",
    }.items():
        assert words in said[name], f"{name}: {said[name]}"
    assert (report / "report.html").exists()
    for name, text in said.items():
        assert lines_with_secret(text) == [], name
    for text in files_of(report):
        assert lines_with_secret(text) == []
