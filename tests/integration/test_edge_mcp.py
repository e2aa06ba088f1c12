"""`edge mcp` over standard input and output, against a running service."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from edge_processes import write_config
from live_patience import PATIENCE_S, eventually

from edge.bus.client import send_request
from edge.bus.session import open_session
from edge.config import ZenohConfig
from edge.host.ports import free_port

pytest.importorskip("mcp", reason="the extra [mcp] is not installed")

import httpx2
from mcp import Client, StdioServerParameters
from mcp.client.streamable_http import streamable_http_client

pytestmark = pytest.mark.slow


def data(result: Any) -> dict[str, Any]:
    assert not result.is_error, result.content
    return json.loads(result.content[0].text)["data"]


SECRET = "0123456789abcdef"


@asynccontextmanager
async def agent_of(edge: Any, config: Path, transport: str) -> AsyncIterator[Client]:
    """Connect an agent over standard input and output, or over HTTP."""
    if transport == "stdio":
        command = StdioServerParameters(
            command=sys.executable, args=["-m", "edge.cli", "mcp", str(config)],
            cwd=str(config.parent), env={**os.environ, "XDG_STATE_HOME": str(config.parent)},
        )  # fmt: skip
        async with Client(command, read_timeout_seconds=PATIENCE_S) as agent:
            yield agent
        return
    token, port = config.with_name("token"), free_port()
    token.write_text(SECRET)
    edge("mcp", config, "--http", port, "--token-file", token).says("serving agents at")
    headers = {"Authorization": f"Bearer {SECRET}"}
    async with httpx2.AsyncClient(headers=headers) as http:
        url = f"http://127.0.0.1:{port}/mcp"
        streams = streamable_http_client(url, http_client=http)
        async with Client(streams, read_timeout_seconds=PATIENCE_S) as agent:
            yield agent


@pytest.mark.parametrize("transport", ["stdio", "http"])
def test_an_agent_proposes_a_person_allows_and_the_robot_drives(
    edge, endpoint, tmp_path, transport, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    config = write_config(
        tmp_path, zenoh={"endpoint": endpoint}, mission={"on_request": True}, mcp={"motion": "ask"},
        sensors={"second_camera": {"width_px": 160, "height_px": 128, "yaw_deg": 180.0}},
    )  # fmt: skip
    service = edge("run", config).says("ready:")
    edge("sim", config)
    goals: set[bytes] = set()
    with open_session(ZenohConfig(endpoint=endpoint), "connect") as session:
        session.declare_subscriber("edge/goal", lambda sample: goals.add(sample.payload.to_bytes()))

        def pose() -> object:
            status = send_request(
                session, "edge/agent/request", {"do": "status"}, PATIENCE_S, "status"
            )
            return status["pose"]

        eventually(pose)

        async def drive() -> None:
            async with agent_of(edge, config, transport) as agent:
                assert data(await agent.call_tool("status", {}))["phase"] == "idle"
                (picture,) = (await agent.read_resource("edge://camera")).contents
                assert picture.mime_type == "image/jpeg"
                (picture,) = (await agent.read_resource("edge://map")).contents
                assert picture.blob.startswith("iVBOR")  # PNG
                first, second = (await agent.call_tool("snapshot", {})).content[2::2]
                assert first.mime_type == second.mime_type == "image/jpeg"
                assert first.data != second.data
                proposed = data(await agent.call_tool("go", {"to": "toilet"}))
                assert proposed["state"] == "waiting"
                assert len(goals) <= 1  # the goal to stand still of the start
                service.says("asks for: go to the toilet")
                answer = send_request(
                    session, "edge/confirm/request", {"do": "allow", "id": proposed["id"]},
                    PATIENCE_S, "confirm",
                )  # fmt: skip
                assert answer == {"proposals": []}
                eventually(lambda: len(goals) > 1)
                assert data(await agent.call_tool("stop", {"why": "enough"}))["stopped"]
                assert data(await agent.call_tool("status", {}))["stopped"] == "an agent: enough"

        asyncio.run(drive())
    lines = (tmp_path / "edge-vln" / "mcp-edge.jsonl").read_text().splitlines()
    assert [json.loads(line).get("tool") for line in lines[::2]] == [
        "status", "read", "read", "snapshot", "go", "stop", "status",
    ]  # fmt: skip
