"""Publisher of the zones for Nav2's KeepoutFilter: a mask and the message that announces it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from edge.bus.wire import messages
from edge.geometry import SE2, Grid
from edge.mapping.zones import ZonePolygons, keepout_mask


class KeepoutPublisher:
    """Publishes the zones as a mask, when it changes; for one thread.

    While the robot is inside a zone, the mask is open (all cells unknown), as the published map is.
    Otherwise the controller could not drive out.
    """

    def __init__(
        self, put: Callable[[bytes], None], frame_id: str, resolution_m: float, inflation_m: float
    ) -> None:
        self._put, self._frame = put, frame_id
        self._resolution_m, self._inflation_m = resolution_m, inflation_m
        self._zones: ZonePolygons | None = None
        self._mask = Grid(np.zeros((0, 0), np.int8), (0.0, 0.0), resolution_m)
        self._is_open = False

    def update(self, stamp_ns: int, zones: ZonePolygons, pose: SE2 | None) -> None:
        """Publish the mask if the zones changed, or if the robot entered or left them."""
        changed = zones is not self._zones
        if changed:
            self._zones = zones
            self._mask = keepout_mask(zones, self._resolution_m, self._inflation_m)
        is_open = pose is not None and _is_closed_at(self._mask, pose)
        if changed or is_open != self._is_open:
            self._is_open = is_open
            mask = self._mask
            shown = replace(mask, cells=np.full_like(mask.cells, -1)) if is_open else mask
            self._put(messages.encode_occupancy_grid(stamp_ns, shown, self._frame))


def _is_closed_at(mask: Grid, pose: SE2) -> bool:
    """Return True if the mask closes the cell of a pose."""
    cell = mask.cell_of(pose.x_m, pose.y_m)
    return cell is not None and bool(mask.cells[cell] > 0)
