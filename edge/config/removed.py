"""Old names of keys, and keys that became constants; files that have them are still read."""

from __future__ import annotations

import logging
from typing import Any

from edge.config.environment import KeyOrigins
from edge.errors import ConfigError
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

RENAMED = {
    "perception.choice.rest_s": "pause_s",
    "perception.governor": "load_shedding",
    "perception.load_shedding.ladder": "levels",
    "perception.load_shedding.levels[].rest": "pause",
    "perception.lift": "back_projection",
    "perception.lift_max_range_m": "back_projection_max_range_m",
    "perception.lift_min_points": "back_projection_min_points",
    "perception.refute_radius_m": "reject_radius_m",
    "policy.look_round": "spin",
    "tasks.chain": "pipeline",
    "tasks.planner.rounds": "max_attempts",
}
"""Old key → new name of its last part. The parts above have their new names; `[]` is an item of a
list. For one release, a file with such a key is read with a warning."""


def drop_removed_keys(
    section: dict[str, Any], path: str, origins: KeyOrigins, above: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return a section with the present names, without removed keys; log a warning for each, once.

    Args:
        section: content of the section.
        path: path of the file.
        origins: variables and options that set keys; their keys are renamed as well.
        above: names of the sections around this one.

    Raises:
        ConfigError: a key is set by its old and by its new name.
    """
    kept: dict[str, Any] = {}
    for name, value in section.items():
        key = (*above, str(name))
        dotted = ".".join(key)
        if dotted in REMOVED:
            if first_time((path, key)):
                where = origins.describe(path, key)
                log.warning(
                    "%s: %s: this key was removed, its value is ignored: delete it", where, dotted
                )
            continue
        if new := RENAMED.get(dotted.replace(".[]", "[]")):
            _warn_of_old_name(path, origins, key, new)
            if new in section:
                raise ConfigError(
                    f"{origins.describe(path, key)}: {dotted} is the old name of {new}, and both "
                    f"are set: remove {name}"
                )
            origins.rename(key, new)
            name, key = new, (*above, new)
        if isinstance(value, list):
            items = (*key, "[]")
            value = [
                drop_removed_keys(item, path, origins, items) if isinstance(item, dict) else item
                for item in value
            ]
        kept[name] = (
            drop_removed_keys(value, path, origins, key) if isinstance(value, dict) else value
        )
    return kept


def _warn_of_old_name(path: str, origins: KeyOrigins, key: tuple[str, ...], new: str) -> None:
    if first_time((path, key)):
        old = ".".join(key)
        log.warning("%s: %s is now called %s: rename it", origins.describe(path, key), old, new)
