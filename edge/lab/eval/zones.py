"""Adds a keep-out zone on the shortest path to episodes of an evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from edge.config import Config
from edge.errors import UserError
from edge.geometry import Grid
from edge.lab.eval import geodesic
from edge.lab.eval.episodes import Episode, WorldSetup, make_episode, world_setups
from edge.lab.eval.missions import MissionCostFields
from edge.lab.eval.zone_entries import distance_m
from edge.lab.sim.base import FloorPlan
from edge.memory import Site, Zone

ALONG = (0.15, 0.85)
"""Share of the shortest path between which a zone's centre is."""
SIZE_M = (0.3, 1.0)
"""Distance of a zone's corners from its centre."""
CORNERS = (3, 7)
"""Fewest and most corners of a zone."""
MARGIN_M = 0.3
"""A path past a zone must leave this much room beyond the robot's radius to count as a detour."""
START_M = 0.4
"""Room between the robot at its start and a zone."""
_DRAWS = 20  # zones to try for an episode


def with_zones(config: Config, episodes: Sequence[Episode], seed: int) -> list[Episode]:
    """Return each episode with a random keep-out zone on its shortest path.

    The zone is a polygon, often not convex. It may leave a detour or none. An episode of a target
    that has no room for a zone is left out.
    """
    found: list[Episode] = []
    worlds = {str(episode.world): episode.world for episode in episodes}
    for setup in world_setups(config, list(worlds.values())):
        for episode in episodes:
            if episode.world == setup.section:
                rng = np.random.default_rng([seed, *episode.id.encode()])
                found += _with_zone(episode, setup, rng)
    return found


def _with_zone(episode: Episode, setup: WorldSetup, rng: np.random.Generator) -> list[Episode]:
    """Return a list with the episode and its zone; [] if no zone fits."""
    if episode.target is None:
        raise UserError("--zones: possible only for episodes with one target; omit --zones")
    plan, radius_m = setup.world.plan, setup.radius_m
    near = MissionCostFields(setup.world, radius_m).near(episode.target)
    distances_m = geodesic.distance_to(plan, near, radius_m)
    path_m = shortest_path(plan, distances_m, *episode.start[:2])  # (n, 2) points
    for _ in range(_DRAWS):
        middle_m = path_m[int(rng.uniform(*ALONG) * len(path_m))]
        corners_m = _polygon(middle_m, rng)
        if distance_m(corners_m, np.array([episode.start[:2]]))[0] < radius_m + START_M:
            continue  # too near to the robot
        zoned = plan_with_zone(plan, corners_m, MARGIN_M)
        left = near & (zoned.clearance_m > radius_m)
        distances_around_m = geodesic.distance_to(zoned, left, radius_m)
        detour_m = geodesic.value_at(plan, distances_around_m, *episode.start[:2])
        ways = "detour" if math.isfinite(detour_m) else "closed"
        shortest_m = round(detour_m, 4) if ways == "detour" else episode.shortest_m
        site = Site((Zone("zone", "keep_out", tuple(map(tuple, corners_m.tolist()))),))
        return [
            make_episode(
                episode.world, setup.world.name, episode.start, shortest_m, episode.sensing,
                episode.target, ways=ways, site=site.geojson(),
            )
        ]  # fmt: skip
    return []


def _polygon(middle_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return (n, 2) corners [m] around a point, at random angles and distances, rounded to mm."""
    angles = np.sort(rng.uniform(0.0, 2 * math.pi, rng.integers(CORNERS[0], CORNERS[1] + 1)))
    away_m = rng.uniform(*SIZE_M, len(angles))
    return np.round(middle_m + away_m[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1), 3)


def shortest_path(plan: FloorPlan, field: np.ndarray, x_m: float, y_m: float) -> np.ndarray:
    """Return the places of the shortest path down a distance field, (n, 2) float64."""
    cells = [plan.grid.cell_of(x_m, y_m)]
    while field[cells[-1]] > 0.0:
        row, col = cells[-1]
        # Go to the lowest of the neighbours: their part of the field, and its index there.
        rows, cols = slice(max(row - 1, 0), row + 2), slice(max(col - 1, 0), col + 2)
        low = np.unravel_index(np.argmin(field[rows, cols]), field[rows, cols].shape)
        cells.append((int(rows.start + low[0]), int(cols.start + low[1])))
    return plan.grid.centres_m(*np.array(cells).T)


def plan_with_zone(plan: FloorPlan, corners_m: np.ndarray, margin_m: float) -> FloorPlan:
    """Return a floor plan in which a zone, grown by a margin, is occupied."""
    grid = plan.grid
    row, col = np.indices(grid.cells.shape).reshape(2, -1)
    near = distance_m(corners_m, grid.centres_m(row, col)) <= margin_m
    cells = np.where(near.reshape(grid.cells.shape), np.uint8(1), grid.cells)
    return FloorPlan(Grid(cells, grid.origin_xy_m, grid.resolution_m))
