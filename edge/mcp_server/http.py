"""Agents over HTTP (MCP's streamable HTTP): the same server, behind a bearer token."""

from __future__ import annotations

import logging
import socket
import threading
from typing import TYPE_CHECKING, Any

import uvicorn

from edge.errors import UnavailableError
from edge.host.credentials import BearerToken
from edge.host.ports import is_loopback
from edge.text import one_line

if TYPE_CHECKING:
    from edge.mcp_server.server import AgentServer

log = logging.getLogger("edge.mcp")

PATH = "/mcp"
_REFUSAL = b"401: send the token as `Authorization: Bearer TOKEN`\n"
_CHECK_S = 0.5  # time between two checks if the server has ended by itself
_CLOSE_S = 2  # longest time that open requests may take at the end


class TokenGate:
    """An ASGI application that answers 401 to every request without the token."""

    def __init__(self, app: Any, token: BearerToken) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Handle one request, or start and end of the server (`lifespan`)."""
        if scope["type"] != "lifespan":
            given = dict(scope["headers"]).get(b"authorization", b"").decode("latin-1")
            if scope["type"] != "http" or not self._token.matches(given):
                headers = [(b"content-type", b"text/plain"), (b"www-authenticate", b"Bearer")]
                await send({"type": "http.response.start", "status": 401, "headers": headers})
                await send({"type": "http.response.body", "body": _REFUSAL})
                return
        await self._app(scope, receive, send)


def serve(
    server: AgentServer, host: str, port: int, token: BearerToken, stop: threading.Event
) -> None:
    """Serve agents over HTTP until `stop` is set.

    Args:
        server: answers the calls.
        host: address to listen on.
        port: TCP port; 0: any free one.
        token: must be in each request.
        stop: ends the server.

    Raises:
        UnavailableError: the address cannot be used.
    """
    where = f"{one_line(host, 100)}:{port}"
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or one_line(error)
        raise UnavailableError(f"mcp: {where}: cannot listen: {why}; choose another") from None
    app = TokenGate(server.streamable_http_app(streamable_http_path=PATH, host=host), token)
    settings = uvicorn.Config(
        app, log_config=None, access_log=False, ws="none", timeout_graceful_shutdown=_CLOSE_S
    )
    # On a thread of its own, because uvicorn in the main thread takes over the signals.
    web = uvicorn.Server(settings)
    thread = threading.Thread(target=web.run, args=([listening],), name="mcp", daemon=True)
    thread.start()
    shown = f"[{host}]" if ":" in host else host
    log.info("serving agents at http://%s:%d%s", shown, listening.getsockname()[1], PATH)
    if not is_loopback(host):
        log.warning("%s: the token crosses the network in clear: use a tunnel (docs/mcp.md)", where)
    while thread.is_alive() and not stop.wait(_CHECK_S):
        pass
    web.should_exit = True
    thread.join(2 * _CLOSE_S)
    listening.close()
    if not stop.is_set():
        raise UnavailableError(f"mcp: {where}: the server has ended; see the log above")
