"""Colours of a report; the map and the page share them."""

from __future__ import annotations

from collections.abc import Mapping

from edge import names

# Cells of the map.
UNKNOWN = "#dde2ea"
FREE = "#ffffff"
OCCUPIED = "#39424f"
INFLATED = "#a9b2bf"  # too close to an obstacle
# Text, and less important text.
INK = "#1c2430"
MUTED = "#66707f"
# Marks.
TARGET = "#d6225b"
OBJECT = "#2b6cb0"  # that is no target
FRONTIER = "#f08c00"
START = "#2f9e44"
WARNING = "#e8590c"
PLACE = "#0b7285"
ROOM = "#5f3dc4"
ZONES = {"keep_out": "#c92a2a", "stay_inside": "#2b8a3e"}  # by the kind of zone
# One for each target of a mission, in order.
TARGETS = (
    TARGET, "#1c7ed6", "#9c36b5", "#0b7285", "#8d5524", "#5c940d", "#6741d9", "#5c6b7f",
)  # fmt: skip

# By the phase of a mission, if it is final.
OUTCOME = {"reached": "#2b8a3e", "failed": "#c92a2a"}
UNFINISHED = "#5c6b7f"


def outcome_colour(phase: str) -> str:
    """Return the colour of a mission's phase; all phases that are not final share one."""
    return OUTCOME.get(phase, UNFINISHED)


def target_colour(name: str, targets: Mapping[str, str]) -> str:
    """Return the colour of a target, or of an object's label: one for all that is no target."""
    for k, both in enumerate(targets.items()):
        if names.same_as_any(name, both):
            return TARGETS[k % len(TARGETS)]
    return OBJECT
