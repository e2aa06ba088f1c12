"""Free ports outside the range of outgoing connections, and loopback addresses."""

from __future__ import annotations

import socket

import pytest

from edge.host import ports
from edge.host.ports import free_port, is_loopback


@pytest.mark.parametrize("text", ["20000 20000", "1024 65535", None, "nonsense", ""])
def test_a_free_port_is_found_without_a_known_range(monkeypatch, tmp_path, text):
    monkeypatch.setattr(ports, "EPHEMERAL", tmp_path / "range")
    if text is not None:
        ports.EPHEMERAL.write_text(text)
    with socket.socket() as taker:
        taker.bind(("127.0.0.1", free_port()))


def test_a_port_that_is_taken_is_not_given(monkeypatch, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        monkeypatch.setattr(ports, "FIRST", port)
        monkeypatch.setattr(ports, "EPHEMERAL", tmp_path / "range")
        ports.EPHEMERAL.write_text(f"{port + 1} 65535")
        assert free_port() != port


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("127.9.9.9", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.2", False),
        ("robot.local", False),
        ("", False),
    ],
)
def test_loopback_addresses_are_recognised(host, own):
    assert is_loopback(host) is own
