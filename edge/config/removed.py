"""Keys that became constants, which old files still have."""

from __future__ import annotations

import logging
from typing import Any

from edge.config.environment import Origins
from edge.logs import once

log = logging.getLogger("edge.config")

REMOVED = {
    "mapping.clear_after",
    "mapping.frontier_large_cells",
    "mapping.frontier_min_cells",
    "mapping.frontier_spacing_m",
    "mapping.ground_slope",
    "mapping.max_frontiers",
    "mapping.reach_cells_per_tick",
    "mission.planner.replan_margin_m",
    "mission.planner.w_det",
    "mission.planner.w_fail",
    "motion.goal_tolerance_m",
    "motion.near_m",
    "motion.stuck_m",
    "motion.unknown_cost",
    "motion.yaw_tolerance_rad",
    "perception.detector.max_detections",
    "perception.max_instances",
    "report.frames",
}
"""Keys that became constants: for one release a file that has one is read, with a warning."""


def without_removed(
    section: dict[str, Any], path: str, origins: Origins, above: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return a section without keys that were removed; warn of each once."""
    kept = {}
    for name, value in section.items():
        key = (*above, str(name))
        if ".".join(key) not in REMOVED:
            is_section = isinstance(value, dict)
            kept[name] = without_removed(value, path, origins, key) if is_section else value
        elif once((path, key)):
            where = origins.of(path, key)
            log.warning("%s: %s: this key is gone, its value is not used", where, ".".join(key))
    return kept
