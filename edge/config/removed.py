"""Keys that became constants, but that old files may still have."""

from __future__ import annotations

import logging
from typing import Any

from edge.config.environment import KeyOrigins
from edge.logs import first_time

log = logging.getLogger("edge.config")

REMOVED = {
    "loop.detect_every",
    *(f"mapping.{k}" for k in ("clear_after", "ground_slope", "reach_cells_per_tick")),
    *(f"mapping.frontier_{k}" for k in ("large_cells", "min_cells", "spacing_m")),
    "mapping.max_frontiers",
    *(f"mission.planner.{k}" for k in ("replan_margin_m", "w_det", "w_fail")),
    *(f"motion.{k}" for k in ("goal_tolerance_m", "yaw_tolerance_rad", "stuck_m", "near_m")),
    *("motion.unknown_cost", "perception.max_instances", "perception.detector.max_detections"),
    "report.frames",
}
"""For one release, a file with such a key is read with a warning."""


def drop_removed_keys(
    section: dict[str, Any], path: str, origins: KeyOrigins, above: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return a section without the keys that were removed; log a warning for each, once.

    Args:
        section: content of the section.
        path: path of the file.
        origins: variables and options that set keys.
        above: names of the sections around this one.
    """
    kept = {}
    for name, value in section.items():
        key = (*above, str(name))
        if ".".join(key) not in REMOVED:
            is_section = isinstance(value, dict)
            kept[name] = drop_removed_keys(value, path, origins, key) if is_section else value
        elif first_time((path, key)):
            where = origins.describe(path, key)
            log.warning(
                "%s: %s: this key was removed, its value is ignored: delete it",
                where,
                ".".join(key),
            )
    return kept
