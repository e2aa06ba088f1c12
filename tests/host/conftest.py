"""Python programs that end with the test."""

from __future__ import annotations

from edge_processes import script  # noqa: F401, a fixture
