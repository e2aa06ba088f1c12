"""An address of a test's own, and `edge` commands that end with the test."""

from __future__ import annotations

from edge_processes import command, edge, endpoint, script  # noqa: F401, fixtures
