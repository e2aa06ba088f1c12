"""Messages to systemd, read from real sockets."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import pytest

from edge.host.service_manager import SystemdNotifier

NOBODY = "/nowhere/notify"


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path) -> Iterator[tuple[socket.socket, str]]:
    """Open a socket as systemd does; return it and its address."""
    name = str(tmp_path / "notify")
    if request.param == "abstract":
        name = f"@edge-test-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(name.replace("@", "\0", 1) if name[0] == "@" else name)
        listening.settimeout(10.0)
        yield listening, name


def test_every_message(manager):
    listening, name = manager
    told = SystemdNotifier({"NOTIFY_SOCKET": name})
    cases = {
        told.ready: "READY=1",
        told.stopping: "STOPPING=1",
        told.alive: "WATCHDOG=1",
        lambda: told.status("searching: bed"): "STATUS=searching: bed",
        lambda: told.starting("kernels", 2.5): "EXTEND_TIMEOUT_USEC=2500000\nSTATUS=kernels",
    }
    for tell, expected in cases.items():
        tell()
        assert listening.recv(4096).decode() == expected
    told.reloading()
    reloading, at = listening.recv(4096).decode().split("\n")
    assert reloading == "RELOADING=1"
    assert int(at.removeprefix("MONOTONIC_USEC=")) > 0


def test_a_status_text_cannot_inject_other_messages(manager):
    listening, name = manager
    SystemdNotifier({"NOTIFY_SOCKET": name}).status("bed\nSTOPPING=1\nMAINPID=1" + "é" * 9000)
    said = listening.recv(65536).decode()
    assert said.count("\n") == 0
    assert len(said) < 500


@pytest.mark.parametrize(
    ("environ", "ping_s"),
    [
        ({"WATCHDOG_USEC": "20000000"}, 5.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": str(os.getpid())}, 5.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_PID": "1"}, None),
    ],
)
def test_the_ping_period_follows_the_watchdog_variables(environ, ping_s):
    environ = {**environ, "NOTIFY_SOCKET": NOBODY, "HOME": "/"}
    assert SystemdNotifier(environ).ping_s == ping_s
    assert environ == {"HOME": "/"}, "a child would speak in our name"


@pytest.mark.parametrize("name", [NOBODY, "vsock:2:9"])
def test_a_manager_that_cannot_be_reached_is_logged_once(name, caplog):
    told = SystemdNotifier({"NOTIFY_SOCKET": name})
    told.ready()
    told.alive()
    assert len(caplog.records) == 1
    assert "NOTIFY_SOCKET" in caplog.text


def test_a_manager_that_does_not_read_is_not_waited_for(manager, caplog):
    _, name = manager
    told = SystemdNotifier({"NOTIFY_SOCKET": name})
    for _ in range(5000):  # more than any queue of datagrams holds
        told.alive()
    assert len(caplog.records) == 1
