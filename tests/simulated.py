"""Configurations of tests that care for no detector."""

from __future__ import annotations

from typing import Any

from edge.config import Config, parse


def simulated(data: dict[str, Any] | None = None, path: str = "<defaults>") -> Config:
    """See `edge.config.parse`; with the simulator's detector if the data name none."""
    data = data or {}
    perception = {"detector": {"kind": "sim"}, **data.get("perception", {})}
    return parse({**data, "perception": perception}, path)
