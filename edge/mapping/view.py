"""Read-only view of the rolling map, for policies."""

from __future__ import annotations

from edge.mapping.grid import RollingMap
from edge.mapping.layers import read_only
from edge.mapping.results import Frontiers
from edge.mapping.values import ValueMap


class ValuesView:
    """Read-only view of the value maps.

    Attributes:
        best: writes the highest value near each point; see `edge.mapping.values.ValueMap`.
    """

    def __init__(self, values: ValueMap) -> None:
        self.best = values.best


class MapView:
    """Read-only view of a map that always shows its current state; made once per map.

    Attributes:
        resolution_m: side of a cell.
        layers: read-only, by storage cell (see `edge.mapping.layers`).
        window: part of the world that the layers hold; only the map moves it.
        state_at: state of the cell of a point: unknown, free or occupied.
        snapshot: copy of the entire map; these two are methods of `edge.mapping.grid.RollingMap`.
        unknown_ratio: share of unknown cells around a point, see `unknown.UnknownArea.ratio`.
        distance_m: driving distance to a point.
        nearest: nearest free cell that the robot can reach, near a point.
        stopping_point: free cell from which an object is in sight; these three are methods of
            `edge.mapping.travel_cost.TravelCostField`.
        values: one channel per target of the mission, if the policy's scorer feeds them.
    """

    def __init__(self, grid: RollingMap) -> None:
        self.resolution_m = grid.resolution_m
        self.layers, self.window = grid.layers, grid.window
        self.state_at, self.snapshot = grid.state_at, grid.snapshot
        self.unknown_ratio = grid.unknown.ratio
        self.distance_m, self.nearest = grid.travel_cost.distance_m, grid.travel_cost.nearest
        self.stopping_point = grid.travel_cost.stopping_point
        self.values = ValuesView(grid.values)
        self._grid = grid
        shown = grid.frontiers
        self._frontiers = Frontiers(0, *map(read_only, (shown.xy_m, shown.cells, shown.cluster)))

    @property
    def frontiers(self) -> Frontiers:
        """Frontiers of the map: the points to drive to. The arrays are read-only."""
        self._frontiers.n = self._grid.frontiers.n
        return self._frontiers

    @property
    def known_m2(self) -> float:
        """Known area of the map in m²."""
        return self._grid.known_m2
