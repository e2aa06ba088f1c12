"""The command `edge mcp`."""

from __future__ import annotations

import argparse
import os

from edge.cli.service_request import ANSWER_S
from edge.config import load
from edge.errors import ConfigError, UnavailableError
from edge.host.credentials import read_token
from edge.host.signals import stop_on_signals
from edge.host.stop_latch import stop_file
from edge.mcp_server.audit import AuditLog, CallLimit
from edge.types import CAMERAS


def run(args: argparse.Namespace) -> int:
    """Handle `edge mcp`: serve agents on standard input and output, or over HTTP.

    On standard input and output it ends when the agent closes them.

    Raises:
        ConfigError: the configuration cannot be read, or has no section `mcp`; or `--http` has no
            usable token.
        UnavailableError: the package `mcp` is missing, there is no folder for the log, or the port
            is in use.
        RequestError: no service is there.
        FileError: the log cannot be written.
    """
    config = load(args.config)
    if config.mcp is None:
        raise ConfigError(
            f"{config.locate('mcp')}: agents have no rights: add `mcp: {{motion: ask}}` to the "
            "configuration of the service, and start it again"
        )
    token = None
    if args.http is None and (args.host is not None or args.token_file is not None):
        raise ConfigError("mcp: --host and --token-file are of --http PORT: give that, too")
    if args.http is not None:
        if args.token_file is None:
            raise ConfigError(
                "mcp: --http needs --token-file FILE: make one with `openssl rand -hex 32 > FILE`"
            )
        token = read_token("--token-file", str(args.token_file))
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
    audit = AuditLog(path, f"uid {os.getuid()}" if token is None else "http")
    with client.connect(config.zenoh, ANSWER_S, "mcp") as session:

        def ask(key: str, request: dict) -> dict:
            name = config.zenoh.key(key)  # type: ignore[arg-type]
            return client.send_request(session, name, request, args.timeout, "mcp")

        cameras = CAMERAS[: len(config.sensors.cameras)]
        server = AgentServer(ask, audit, CallLimit(config.mcp.calls_per_minute), cameras)
        if token is None:
            server.run("stdio")
        else:
            from edge.mcp_server.http import serve

            serve(server, args.host or "127.0.0.1", args.http, token, stop_on_signals())
    audit.close()
    return 0
