"""Votes of pictures and labels for the kind of ground at places in `map`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge.geometry import SE2, Grid
from edge.tasks.scene import terrain
from edge.tasks.scene.objects import first_in_voxels

VOXEL_M = 0.2
"""Side of the cells in which ground points of one kind count once in a picture."""
MOST_VOTES = 1 << 18
"""Largest number of votes; the oldest ones are dropped."""


class GroundVotes:
    """Votes for the kind of ground, and the kind that they give each cell of a map.

    Attributes:
        kinds: as above.
    """

    def __init__(self, kinds: Sequence[str]) -> None:
        self.kinds = tuple(kinds)
        self._votes = np.zeros((0, 3), np.float32)  # x [m], y [m] and kind

    def add(self, xy_m: np.ndarray, kind: np.ndarray) -> None:
        """Add the points of one picture. Points of other objects vote, too.

        So a cell at a kerb does not count as half a road.

        Args:
            xy_m: (n, 2) float32 in `map`.
            kind: (n,) uint8, index into `kinds` plus 1; 0: no ground.
        """
        is_plausible = np.isfinite(xy_m).all(axis=1)
        new = np.column_stack((xy_m[is_plausible], kind[is_plausible])).astype(np.float32)
        # One vote for each kind and place, so that near ground has no greater weight.
        first = first_in_voxels(new, np.array([VOXEL_M, VOXEL_M, 1.0]))
        self._votes = np.concatenate((self._votes, new[first]))[-MOST_VOTES:]

    def classify(self, occupancy: Grid, pose: SE2) -> np.ndarray:
        """Return the kind of each cell, (h, w) uint8; see `terrain.classify_ground`."""
        xy_m, kind = self._votes[:, :2], self._votes[:, 2].astype(np.int64)
        return terrain.classify_ground(occupancy, pose, xy_m, kind, len(self.kinds))
