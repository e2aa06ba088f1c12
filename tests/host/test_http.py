"""Cutting a request's connection; the chat client's tests check the error messages."""

from __future__ import annotations

import socket

import httpx
import pytest

from edge.host.http import CuttableConnection, failure_reason


class Stream:
    """Stand-in for the stream that httpx passes to `trace`."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    def get_extra_info(self, name: str) -> socket.socket:
        assert name == "socket"
        return self._sock


CONNECTED = ("connection.connect_tcp.complete", "connection.start_tls.complete")


@pytest.mark.parametrize("event", CONNECTED)
@pytest.mark.parametrize("cut_first", [False, True])
def test_cutting_a_connection_wakes_its_reader(event, cut_first):
    mine, others = socket.socketpair()
    with mine, others:
        connection = CuttableConnection()
        if cut_first:
            connection.cut()
        connection.trace("connection.connect_tcp.started", {})
        connection.trace(event, {"return_value": Stream(mine)})
        if not cut_first:
            connection.cut()
        assert mine.recv(1) == others.recv(1) == b""


def test_a_closed_connection_may_be_cut():
    connection = CuttableConnection()
    with socket.socket() as sock:
        connection.trace(CONNECTED[0], {"return_value": Stream(sock)})
    connection.cut()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (httpx.HTTPError(""), "HTTPError"),
        (httpx.RemoteProtocolError("two\nlines"), "does not speak HTTP (two lines); check the URL"),
    ],
)
def test_a_failure_is_described_in_one_line(error, said):
    assert failure_reason(error) == said
