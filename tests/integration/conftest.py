"""An address of a test's own, and `edge` commands that end with the test."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest
from edge_processes import Edge


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def edge(tmp_path) -> Iterator[Callable[..., Edge]]:
    """Starts `edge` commands; all are killed at the end."""
    started = []

    def start(*arguments: object, **environ: str) -> Edge:
        started.append(Edge(*arguments, cwd=tmp_path, **environ))
        return started[-1]

    yield start
    for process in started:
        process.kill()
