"""Why an endpoint took no session, of servers that are none of ours."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest
from patience import PATIENCE_S

from edge.bus import refusal
from edge.bus.refusal import diagnose_refusal
from edge.bus.session import session_config
from edge.config import ZenohConfig
from edge.host.ports import free_port


@pytest.fixture
def port() -> Iterator[int]:
    """Serve HTTP on a free port that accepts every connection."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            while True:
                try:
                    taken, _ = listening.accept()
                except OSError:
                    return
                with taken:
                    taken.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield listening.getsockname()[1]
        listening.shutdown(socket.SHUT_RDWR)
        thread.join()


def why(endpoint: str) -> str | None:
    settings = ZenohConfig(endpoint=endpoint)
    return diagnose_refusal(endpoint, session_config(settings, "connect"), "zenoh.client_file")


@pytest.mark.parametrize("place", ["tcp/127.0.0.1:{}", "tls/127.0.0.1:{}", "quic/127.0.0.1:{}"])
def test_a_port_without_a_server_gives_no_refusal(place):
    assert why(place.format(free_port())) is None


def test_a_server_that_does_not_speak_zenoh_is_reported(port, monkeypatch):
    for limit in ("PROBE_S", "_NAME_S"):
        monkeypatch.setattr(refusal, limit, PATIENCE_S)
    assert "refuses the session" in why(f"tcp/127.0.0.1:{port}")
    assert why(f"tls/127.0.0.1:{port}").startswith("the server does not speak TLS")
