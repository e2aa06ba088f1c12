"""An address of a test's own, `edge` commands that end with the test, and time for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from edge_processes import Edge

from edge.ports import free_port

HERE = Path(__file__).parent
LIMIT_S = 900  # longer than a test waits for any one thing, so that it can say what did not happen


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LIMIT_S))


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


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
