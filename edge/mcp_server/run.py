"""The command `edge mcp`."""

from __future__ import annotations

import argparse
import os

from edge.cli.service_request import ANSWER_S
from edge.config import load
from edge.errors import ConfigError, UnavailableError
from edge.host.stop_latch import stop_file
from edge.mcp_server.audit import AuditLog, CallLimit


def run(args: argparse.Namespace) -> int:
    """Handle `edge mcp`: serve one agent on standard input and output until it closes them.

    Raises:
        ConfigError: the configuration cannot be read, or has no section `mcp`.
        UnavailableError: the package `mcp` is missing, or there is no folder for the log.
        RequestError: no service is there.
        FileError: the log cannot be written.
    """
    config = load(args.config)
    if config.mcp is None:
        raise ConfigError(
            f"{config.locate('mcp')}: agents have no rights: add `mcp: {{motion: ask}}` to the "
            "configuration of the service, and start it again"
        )
    try:
        from edge.mcp_server.server import AgentServer
    except ImportError as error:
        raise UnavailableError(
            f"mcp: {error}: install it with `pip install 'edge-vln[mcp]'`"
        ) from None
    from edge.bus import client

    if args.audit is not None:
        path = args.audit
    elif (state := stop_file(config.zenoh.prefix)) is not None:
        path = state.with_name(state.name.replace("stop-", "mcp-", 1)).with_suffix(".jsonl")
    else:
        raise UnavailableError("mcp: no folder for the log of calls: give a file by --audit")
    audit = AuditLog(path, f"uid {os.getuid()}")
    with client.connect(config.zenoh, ANSWER_S, "mcp") as session:

        def ask(key: str, request: dict) -> dict:
            name = config.zenoh.key(key)  # type: ignore[arg-type]
            return client.send_request(session, name, request, args.timeout, "mcp")

        AgentServer(ask, audit, CallLimit(config.mcp.calls_per_minute)).run("stdio")
    audit.close()
    return 0
