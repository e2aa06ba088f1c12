"""Numba kernels for the clusters of frontier cells, and their arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edge.jit import jit

MAX_CELLS = 512
"""Largest number of cells of a cluster (25 m at 0.05 m), which bounds the work of growing it."""
MAX_SAMPLES = 32
"""Largest number of target points of a cluster."""
MAX_CLUSTERS = 8192
MAX_KEPT = 1024
"""Largest number of target points that are kept while their clusters are grown again."""
_CELLS_PER_SIDE = 64  # room for this many frontier cells per row of the map
# Indices of the entries of `Clusters.count`.
FREE_NODE, FREE_IDS, OVERFLOW, KEPT = 0, 1, 2, 3


class Clusters(NamedTuple):
    """Members of all clusters, as linked lists in one pool of nodes.

    Attributes:
        node_cell: (m,) int32, flat storage cell of a node.
        node_next: (m,) int32, next node of the list, -1 at its end.
        head: (MAX_CLUSTERS,) int32, first node of a cluster (id 0 is never used).
        size: (MAX_CLUSTERS,) int32, number of cells; 0 = the id is free.
        dirty: (MAX_CLUSTERS,) bool, True if the cluster must be grown again.
        sample: (MAX_CLUSTERS, MAX_SAMPLES) int32, flat storage cells of the target points.
        samples: (MAX_CLUSTERS,) int32, number of target points.
        free_id: (MAX_CLUSTERS,) int32, stack of free ids.
        count: (4,) int64: first free node, height of the stack, number of cells without room,
            length of `kept`.
        pending: (m,) int32, cells that wait for a cluster.
        queue: (MAX_CELLS,) int32, scratch of the search.
        kept: (MAX_KEPT,) int32, target points of the clusters that are grown again.
    """

    node_cell: np.ndarray
    node_next: np.ndarray
    head: np.ndarray
    size: np.ndarray
    dirty: np.ndarray
    sample: np.ndarray
    samples: np.ndarray
    free_id: np.ndarray
    count: np.ndarray  # type: ignore[assignment]  # hides tuple.count
    pending: np.ndarray
    queue: np.ndarray
    kept: np.ndarray


def make_clusters(n: int) -> Clusters:
    """Make an empty set of clusters, with room for 64 frontier cells per row of the map."""
    nodes = _CELLS_PER_SIDE * n
    node_next = np.arange(1, nodes + 1, dtype=np.int32)
    node_next[-1] = -1
    return Clusters(
        node_cell=np.zeros(nodes, np.int32),
        node_next=node_next,
        head=np.full(MAX_CLUSTERS, -1, np.int32),
        size=np.zeros(MAX_CLUSTERS, np.int32),
        dirty=np.zeros(MAX_CLUSTERS, np.bool_),
        sample=np.zeros((MAX_CLUSTERS, MAX_SAMPLES), np.int32),
        samples=np.zeros(MAX_CLUSTERS, np.int32),
        free_id=np.arange(MAX_CLUSTERS - 1, 0, -1, dtype=np.int32),
        count=np.array([0, MAX_CLUSTERS - 1, 0, 0], np.int64),
        pending=np.zeros(nodes, np.int32),
        queue=np.zeros(MAX_CELLS, np.int32),
        kept=np.zeros(MAX_KEPT, np.int32),
    )


@jit(inline="always")
def _unknown(layers, sy, word):
    """Return the unknown cells of a word that are not blocked, as bits."""
    return ~(layers.known[sy, word] | layers.blocked[sy, word])


@jit
def retest(layers, shift_x, shift_y, x0, y0, x1, y1, clusters, n_pending):
    """Test the frontier cells of a window rectangle again; return the new number of pending cells.

    New frontier cells get label -1 and wait in `pending`. Clusters that lost a cell become dirty.
    """
    n = layers.raw.shape[0]
    words = n >> 6
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, n), min(y1, n)
    zero, one, top = np.uint64(0), np.uint64(1), np.uint64(63)
    for y in range(y0, y1):
        sy = (y + shift_y) % n
        for w in range(x0 >> 6, (x1 + 63) >> 6):
            sw = (w + (shift_x >> 6)) % words
            free = layers.known[sy, sw] & ~layers.blocked[sy, sw]
            unknown = _unknown(layers, sy, sw)
            # Bit b is cell b of the word: shifts look at the neighbours to the left and right, also
            # across the ends of the word. The words above and below need no shift.
            next_to_unknown = (unknown << one) | (unknown >> one)
            if w > 0:
                next_to_unknown |= _unknown(layers, sy, (sw + words - 1) % words) >> top
            if w < words - 1:
                next_to_unknown |= _unknown(layers, sy, (sw + 1) % words) << top
            if y > 0:
                next_to_unknown |= _unknown(layers, (sy + n - 1) % n, sw)
            if y < n - 1:
                next_to_unknown |= _unknown(layers, (sy + 1) % n, sw)
            now = free & next_to_unknown
            flips = now ^ layers.frontier[sy, sw]
            if flips == zero:
                continue
            layers.frontier[sy, sw] = now
            for b in range(64):
                if (flips >> np.uint64(b)) & one == zero:
                    continue
                sx = (sw << 6) + b
                if (now >> np.uint64(b)) & one != zero:
                    if n_pending < len(clusters.pending):
                        layers.label[sy, sx] = -1
                        clusters.pending[n_pending] = sy * n + sx
                        n_pending += 1
                    else:
                        clusters.count[OVERFLOW] += 1
                else:
                    label = layers.label[sy, sx]
                    if label > 0:
                        clusters.dirty[label] = True
                    layers.label[sy, sx] = 0
    return n_pending


@jit
def regroup(layers, shift_x, shift_y, clusters, n_pending, large_cells, spacing_cells):
    """Grow changed clusters again (breadth-first, 8-connected) and choose their target points.

    - `n_pending`: number of cells in `clusters.pending`.
    - `large_cells`, `spacing_cells`: see `_sample`.

    Returns:
        True if any cluster changed.
    """
    n = layers.raw.shape[0]
    flat = layers.label.ravel()  # by flat storage cell
    # Clusters next to a new frontier cell are grown again.
    for i in range(n_pending):
        sy, sx = clusters.pending[i] // n, clusters.pending[i] % n
        y, x = (sy - shift_y) % n, (sx - shift_x) % n
        for ny in range(max(y - 1, 0), min(y + 2, n)):
            for nx in range(max(x - 1, 0), min(x + 2, n)):
                label = layers.label[(ny + shift_y) % n, (nx + shift_x) % n]
                if label > 0:
                    clusters.dirty[label] = True
    any_change = n_pending > 0
    clusters.count[KEPT] = 0
    for k in range(1, MAX_CLUSTERS):
        if clusters.dirty[k]:
            any_change = True
            n_pending = _dissolve(flat, clusters, k, n_pending)
    for i in range(n_pending):
        if flat[clusters.pending[i]] == -1:
            _grow(layers, flat, shift_x, shift_y, clusters, clusters.pending[i])
    # Sample after growing all: a later cluster never takes cells of an earlier one.
    for i in range(n_pending):
        k = flat[clusters.pending[i]]
        if k > 0 and clusters.samples[k] == 0:
            _sample(n, flat, shift_x, shift_y, clusters, k, large_cells, spacing_cells)
    return any_change


@jit
def _dissolve(flat, clusters, k, n_pending):
    """Free a cluster's nodes; its cells wait for a new cluster."""
    clusters.dirty[k] = False
    if clusters.size[k] == 0:
        return n_pending
    node = clusters.head[k]
    while node >= 0:
        next_node = clusters.node_next[node]
        cell = clusters.node_cell[node]
        if flat[cell] == k:
            flat[cell] = -1
            if n_pending < len(clusters.pending):
                clusters.pending[n_pending] = cell
                n_pending += 1
        clusters.node_next[node] = clusters.count[FREE_NODE]
        clusters.count[FREE_NODE] = node
        node = next_node
    for i in range(clusters.samples[k]):
        if clusters.count[KEPT] < len(clusters.kept):
            clusters.kept[clusters.count[KEPT]] = clusters.sample[k, i]
            clusters.count[KEPT] += 1
    clusters.head[k] = -1
    clusters.size[k] = 0
    clusters.samples[k] = 0
    clusters.free_id[clusters.count[FREE_IDS]] = k
    clusters.count[FREE_IDS] += 1
    return n_pending


@jit
def _grow(layers, flat, shift_x, shift_y, clusters, seed):
    """Make a cluster of at most MAX_CELLS waiting cells connected to `seed`."""
    n = layers.raw.shape[0]
    if clusters.count[FREE_IDS] == 0:
        clusters.count[OVERFLOW] += 1
        return
    clusters.count[FREE_IDS] -= 1
    k = clusters.free_id[clusters.count[FREE_IDS]]
    clusters.head[k] = -1
    clusters.samples[k] = 0
    queue = clusters.queue
    queue[0] = seed
    flat[seed] = k
    n_done, n_queued = 0, 1
    while n_done < n_queued:
        cell = queue[n_done]
        n_done += 1
        node = clusters.count[FREE_NODE]
        if node < 0:
            clusters.count[OVERFLOW] += 1
            break
        clusters.count[FREE_NODE] = clusters.node_next[node]
        clusters.node_cell[node] = cell
        clusters.node_next[node] = clusters.head[k]
        clusters.head[k] = node
        y, x = (cell // n - shift_y) % n, (cell % n - shift_x) % n
        for ny in range(max(y - 1, 0), min(y + 2, n)):
            for nx in range(max(x - 1, 0), min(x + 2, n)):
                near = ((ny + shift_y) % n) * n + (nx + shift_x) % n
                if flat[near] == -1 and n_queued < MAX_CELLS:
                    flat[near] = k
                    queue[n_queued] = near
                    n_queued += 1
    clusters.size[k] = n_done


@jit
def _sample(n, flat, shift_x, shift_y, clusters, k, large_cells, spacing_cells):
    """Choose the target points of a cluster.

    A small cluster has one, the member nearest to the centroid. A large cluster has members at
    least `spacing_cells` apart. Earlier target points that are still members come first, so that a
    large cluster that grows at one end keeps its other targets.
    """
    if clusters.size[k] < large_cells:
        _add_apart(
            n, shift_x, shift_y, clusters, k, _central(n, shift_x, shift_y, clusters, k), 0.0
        )
        return
    for i in range(clusters.count[KEPT]):
        if flat[clusters.kept[i]] == k:
            _add_apart(n, shift_x, shift_y, clusters, k, clusters.kept[i], spacing_cells)
    central = _central(n, shift_x, shift_y, clusters, k)
    _add_apart(n, shift_x, shift_y, clusters, k, central, spacing_cells)
    node = clusters.head[k]
    while node >= 0:
        _add_apart(n, shift_x, shift_y, clusters, k, clusters.node_cell[node], spacing_cells)
        node = clusters.node_next[node]


@jit
def _central(n, shift_x, shift_y, clusters, k):
    """Return the member nearest to the centroid of a cluster."""
    sum_x, sum_y = 0.0, 0.0
    node = clusters.head[k]
    while node >= 0:
        cell = clusters.node_cell[node]
        sum_x += (cell % n - shift_x) % n
        sum_y += (cell // n - shift_y) % n
        node = clusters.node_next[node]
    mean_x, mean_y = sum_x / clusters.size[k], sum_y / clusters.size[k]
    best, nearest = np.inf, np.int32(-1)
    node = clusters.head[k]
    while node >= 0:
        cell = clusters.node_cell[node]
        dx, dy = (cell % n - shift_x) % n - mean_x, (cell // n - shift_y) % n - mean_y
        if dx * dx + dy * dy < best:
            best, nearest = dx * dx + dy * dy, cell
        node = clusters.node_next[node]
    return nearest


@jit
def _add_apart(n, shift_x, shift_y, clusters, k, cell, spacing_cells):
    """Make a cell a target point of its cluster unless one is nearer than `spacing_cells`."""
    n_samples = clusters.samples[k]
    if n_samples == MAX_SAMPLES:
        return
    x, y = (cell % n - shift_x) % n, (cell // n - shift_y) % n
    for i in range(n_samples):
        other = clusters.sample[k, i]
        dx = x - (other % n - shift_x) % n
        dy = y - (other // n - shift_y) % n
        if dx * dx + dy * dy < spacing_cells * spacing_cells:
            return
    clusters.sample[k, n_samples] = cell
    clusters.samples[k] = n_samples + 1


@jit
def _targets_of(clusters, min_cells):
    """Return the number of target points of clusters with `min_cells` or more."""
    total = 0
    for k in range(1, MAX_CLUSTERS):
        if clusters.size[k] >= min_cells:
            total += clusters.samples[k]
    return total


@jit
def list_targets(n, shift_x, shift_y, origin_x, origin_y, res, clusters, min_cells, xy, cells, ids):
    """Write the target points of all clusters with `min_cells` or more.

    If there is no room for all, the smallest clusters are left out, by doubling the least size. If
    even the largest clusters have too many, the rest is dropped.

    - `xy`: (cap, 2) float32 output, points in `map`, in metres (`res` is metres per cell).
    - `cells`: (cap,) int32 output, number of cells of the point's cluster.
    - `ids`: (cap,) int32 output, id of the cluster.

    Returns:
        The number of target points.
    """
    capacity = len(ids)
    while _targets_of(clusters, min_cells) > capacity and _targets_of(clusters, 2 * min_cells) > 0:
        min_cells *= 2
    out = 0
    for k in range(1, MAX_CLUSTERS):
        if clusters.size[k] < min_cells:
            continue
        for i in range(clusters.samples[k]):
            if out == capacity:
                return out
            cell = clusters.sample[k, i]
            xy[out, 0] = (origin_x + (cell % n - shift_x) % n + 0.5) * res
            xy[out, 1] = (origin_y + (cell // n - shift_y) % n + 0.5) * res
            cells[out] = clusters.size[k]
            ids[out] = k
            out += 1
    return out


@jit
def members(clusters, ids, cell, size):
    """Write the members of clusters in the order of their lists; return their number."""
    n = 0
    for i in range(len(ids)):
        node = clusters.head[ids[i]]
        while node >= 0:
            cell[n] = clusters.node_cell[node]
            size[i] += 1
            n += 1
            node = clusters.node_next[node]
    return n
