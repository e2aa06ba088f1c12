"""Persistent frontiers (VL-Nav III.B): partial detection, clusters, target points.

A frontier cell is free and has an unknown cell among its four neighbours in the window. An update
tests only the words of the bit planes in the changed region. It grows only those clusters again
that gained or lost a cell; all others stay as they were.
"""

from __future__ import annotations

import numpy as np

from edge.host.checkpoint import Arrays
from edge.mapping import cluster_kernels as kernels
from edge.mapping.cluster_kernels import FREE_IDS, FREE_NODE, MAX_CELLS, MAX_CLUSTERS, MAX_SAMPLES
from edge.mapping.layers import Layers, bits_of
from edge.mapping.results import Frontiers
from edge.mapping.window import Window

FRONTIER_MIN_CELLS = 6
"""A cluster with fewer cells is not a frontier."""
FRONTIER_LARGE_CELLS, FRONTIER_SPACING_M = 40, 1.0
"""A cluster with at least so many cells has several target points at this spacing."""
MAX_FRONTIERS = 256
"""Largest number of target points."""
ROWS = {("id", "size", "samples", "sample"): MAX_CLUSTERS, ("cell",): 1 << 18, ("free",): 1 << 13}
"""Groups of arrays in a `state_dict` with equally many rows, and the largest number of rows."""


class FrontierFinder:
    """The frontier cells of a map in clusters, and the target points on them.

    Attributes:
        targets: the target points, refreshed in place.
    """

    def __init__(self, layers: Layers, window: Window) -> None:
        self._layers, self._window = layers, window
        self._n_pending = 0  # frontier cells that wait for a cluster
        self.clusters = kernels.make_clusters(window.n)
        self.targets = Frontiers(
            0,
            np.zeros((MAX_FRONTIERS, 2), np.float32),
            np.zeros(MAX_FRONTIERS, np.int32),
            np.zeros(MAX_FRONTIERS, np.int32),
        )

    def retest(self, x0: int, y0: int, x1: int, y1: int) -> None:
        """Test the frontier cells of a window rectangle again."""
        self._n_pending = kernels.retest(
            self._layers, *self._window.shift, x0, y0, x1, y1, self.clusters, self._n_pending
        )

    def update(self, rolled: bool) -> None:
        """Group the tested cells; list the targets if any cluster changed or the window moved."""
        window, f = self._window, self.targets
        any_change = kernels.regroup(
            self._layers, *window.shift, self.clusters, self._n_pending,
            FRONTIER_LARGE_CELLS, FRONTIER_SPACING_M / window.resolution_m,
        )  # fmt: skip
        self._n_pending = 0
        if any_change or rolled:
            f.n = kernels.list_targets(
                window.n, *window.shift, *window.origin, window.resolution_m, self.clusters,
                FRONTIER_MIN_CELLS, f.xy_m, f.cells, f.cluster,
            )  # fmt: skip

    def state_dict(self) -> Arrays:
        """Return all clusters as plain arrays, for `load_state_dict`.

        Returns:
            `id`, `size` and `samples` (k,) int32; `sample` (k, MAX_SAMPLES) int32; `cell`, the
            members of one cluster after the other, (size.sum(),) int32; `free` (f,) int16.
        """
        clusters = self.clusters
        ids = np.flatnonzero(clusters.size).astype(np.int32)
        cell, size = np.zeros(int(clusters.size.sum()), np.int32), np.zeros(len(ids), np.int32)
        n = kernels.members(clusters, ids, cell, size)
        free = clusters.free_id[: clusters.count[FREE_IDS]]
        free = np.concatenate((free, ids[size == 0]))  # clusters for which there was no node
        free = free.astype(np.int16)  # half the size of the file of a small map
        ids, size = ids[size > 0], size[size > 0]
        samples, sample = clusters.samples[ids], clusters.sample[ids]
        sample[np.arange(MAX_SAMPLES) >= samples[:, None]] = 0  # of earlier clusters
        return {
            "id": ids, "size": size, "samples": samples, "sample": sample, "cell": cell[:n],
            "free": free,
        }  # fmt: skip

    def load_state_dict(self, state: Arrays) -> None:
        """Restore the clusters of a `state_dict` in a map without clusters.

        Raises:
            ValueError: these are not the clusters of such a map.
        """
        clusters, flat = self.clusters, self._layers.label.ravel()
        ids, size, cell, free = (state[name] for name in ("id", "size", "cell", "free"))
        samples, sample = state["samples"], state["sample"]
        every = np.sort(np.concatenate((ids, free)))
        if not (
            np.array_equal(every, np.arange(1, MAX_CLUSTERS))
            and ((size > 0) & (size <= MAX_CELLS)).all()
            and size.sum() == len(cell) == len(np.unique(cell)) <= len(clusters.node_cell)
            and ((cell >= 0) & (cell < len(flat))).all()
            and ((samples >= 0) & (samples <= MAX_SAMPLES)).all()
        ):
            raise ValueError("frontiers: ids, sizes or cells are inconsistent")
        flat[cell] = np.repeat(ids, size)
        for k in range(MAX_SAMPLES):
            has = samples > k
            at = sample[has, k]
            if not ((at >= 0) & (at < len(flat))).all() or not (flat[at] == ids[has]).all():
                raise ValueError("frontiers: a target point is not in its cluster")
        n = len(cell)
        ends = np.cumsum(size)
        clusters.node_cell[:n] = cell
        clusters.node_next[ends - 1] = -1
        clusters.head[ids], clusters.size[ids] = ends - size, size
        clusters.samples[ids], clusters.sample[ids] = samples, sample
        clusters.free_id[: len(free)] = free
        clusters.count[FREE_IDS] = len(free)
        clusters.count[FREE_NODE] = n if n < len(clusters.node_cell) else -1
        self._layers.frontier[:] = bits_of(self._layers.label > 0)
