"""Agents over HTTP: with the token all works as over standard input, without it nothing does."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from patience import PATIENCE_S, eventually

from edge.errors import UserError
from edge.host.credentials import BearerToken
from edge.host.ports import free_port

pytest.importorskip("mcp", reason="the extra [mcp] is not installed")

import httpx2
from mcp import Client
from mcp.client.streamable_http import streamable_http_client

from edge.mcp_server import run as command
from edge.mcp_server.audit import AuditLog, CallLimit
from edge.mcp_server.http import serve
from edge.mcp_server.server import AgentServer

SECRET = "0123456789abcdef"
PING = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "stop"}}


class Served:
    """A server of agents on a port of its own.

    Attributes:
        url: its address.
        asked: requests to the service.
    """

    def __init__(self, folder: Path) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.log, self.stop, port = AuditLog(folder / "log", "http"), threading.Event(), free_port()
        self.url = f"http://127.0.0.1:{port}/mcp"
        server = AgentServer(self._ask, self.log, CallLimit(100))
        arguments = (server, "127.0.0.1", port, BearerToken(SECRET.encode()), self.stop)
        self.thread = threading.Thread(target=serve, args=arguments)
        self.thread.start()
        eventually(lambda: _answers(port))

    def _ask(self, key: str, request: dict[str, Any]) -> dict[str, Any]:
        self.asked.append((key, request))
        return {"phase": "idle"}

    def close(self) -> None:
        self.stop.set()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()
        self.log.close()


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture(scope="module")
def served(tmp_path_factory) -> Iterator[Served]:
    server = Served(tmp_path_factory.mktemp("http"))
    yield server
    server.close()


def test_with_the_token_an_agent_calls_tools(served):
    async def call() -> Any:
        headers = {"Authorization": f"Bearer {SECRET}"}
        async with httpx2.AsyncClient(headers=headers) as http:
            transport = streamable_http_client(served.url, http_client=http)
            async with Client(transport, read_timeout_seconds=PATIENCE_S) as agent:
                return await agent.call_tool("status", {})

    result = asyncio.run(call())
    assert json.loads(result.content[0].text)["data"] == {"phase": "idle"}
    assert served.asked[-1] == ("agent/request", {"do": "status"})
    first, last = map(json.loads, served.log.path.read_text().splitlines()[-2:])
    assert (first["tool"], first["agent"], last["outcome"]) == ("status", "http", "done")


@pytest.mark.parametrize(
    "headers",
    [{}, {"Authorization": "Bearer"}, {"Authorization": f"Bearer {SECRET}x"},
     {"Authorization": SECRET}, {"Authorization": f"Basic {SECRET}"}, {"X-Token": SECRET}],
)  # fmt: skip
@pytest.mark.parametrize("method", ["GET", "POST", "DELETE", "OPTIONS"])
def test_without_the_token_nothing_is_asked_or_answered(served, headers, method):
    before = len(served.asked)
    for path in ("", "/", "/../docs"):
        answer = httpx.request(method, served.url + path, headers=headers, json=PING)
        assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
    assert len(served.asked) == before


@pytest.mark.parametrize("header", ["Host", "Origin"])
def test_another_site_is_refused_even_with_the_token(served, header):
    headers = {"Authorization": f"Bearer {SECRET}", header: "http://evil.example"}
    headers["Host"] = "evil.example" if header == "Host" else httpx.URL(served.url).netloc.decode()
    before = len(served.asked)
    answer = httpx.post(served.url, headers=headers, json=PING)
    assert answer.status_code in (403, 421)
    assert len(served.asked) == before


def arguments(tmp_path: Path, **given: Any) -> Namespace:
    config = tmp_path / "robot.yaml"
    config.write_text("perception: {detector: {kind: sim}}\nmcp: {motion: ask}\n")
    usual = {"config": str(config), "audit": None, "timeout": 1.0, "host": "127.0.0.1",
             "http": 7490, "token_file": None}  # fmt: skip
    return Namespace(**{**usual, **given})


@pytest.mark.parametrize(
    ("content", "why"),
    [(None, "--http needs --token-file"), ("", "expected one word of 16"), ("short", "16")],
)
def test_a_port_needs_a_good_token(tmp_path, content, why):
    path = None if content is None else tmp_path / "token"
    if path is not None:
        path.write_text(content)
    with pytest.raises(UserError, match=why) as caught:
        command.run(arguments(tmp_path, token_file=path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("given", [{"host": "0.0.0.0"}, {"token_file": Path("token")}])
def test_http_options_need_a_port(tmp_path, given):
    with pytest.raises(UserError, match=r"^mcp: --host and --token-file are of --http PORT"):
        command.run(arguments(tmp_path, **{"http": None, "host": None, **given}))


@pytest.mark.parametrize("host", ["127.0.0.1", "no.such.host.invalid"])
def test_an_address_that_cannot_be_used(host, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port, log = other.getsockname()[1], AuditLog(tmp_path / "log", "http")
        server = AgentServer(lambda key, request: {}, log, CallLimit(1))
        with pytest.raises(UserError, match=rf"mcp: {host}:{port}: cannot listen"):
            serve(server, host, port, BearerToken(SECRET.encode()), threading.Event())
        log.close()
