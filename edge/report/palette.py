"""Colours that the picture and the page share."""

from __future__ import annotations

UNKNOWN = "#dde2ea"
FREE = "#ffffff"
OCCUPIED = "#39424f"
INFLATED = "#a9b2bf"
INK = "#1c2430"
MUTED = "#66707f"
TARGET = "#d6225b"
INSTANCE = "#2b6cb0"
FRONTIER = "#f08c00"
START = "#2f9e44"

OUTCOME = {"reached": "#2b8a3e", "failed": "#c92a2a"}
UNFINISHED = "#5c6b7f"


def outcome_colour(phase: str) -> str:
    """The colour of a mission's phase; phases that are not final share one."""
    return OUTCOME.get(phase, UNFINISHED)
