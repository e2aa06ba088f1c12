"""The minimal automaton of a language, by partition refinement (Moore)."""

from __future__ import annotations

import numpy as np

from edge.mission.logic.limits import Limits

# Below this many transitions plain Python is faster than NumPy.
_SMALL = 256
# As many cells take as long as calling NumPy for one column does.
_CALL = 500


def minimal(
    delta: np.ndarray, accepting: np.ndarray, limits: Limits
) -> tuple[np.ndarray, np.ndarray]:
    """Merge equivalent states, number them breadth-first, letters in their order.

    Args:
        delta: (n, k) int32, next states of a complete automaton; state 0 is initial, every
            state can be reached from it.
        accepting: (n,) bool.

    Returns:
        delta (m, k) int32 and accepting (m,) bool of the minimal automaton.
    """
    refine = _refine_small if delta.size <= _SMALL else _refine
    block = refine(delta, accepting, limits)
    _, first = np.unique(block, return_index=True)
    return _numbered(block[delta[first]], accepting[first], int(block[0]))


def _refine(delta: np.ndarray, accepting: np.ndarray, limits: Limits) -> np.ndarray:
    """(n,) int64, which states are equivalent, as numbers without gaps."""
    n = len(delta)
    block, count = accepting.astype(np.int64), int(accepting.max()) + int(not accepting.all())
    while count < n:
        limits.spend_cells((n + _CALL) * delta.shape[1])
        # As many columns as fit are packed into one int64, which sorts fast.
        key, size = block, count
        for column in delta.T:
            if size * count >= 2**62:
                key, size = _dense(key)
            key, size = key * count + block[column], size * count
        finer, new_count = _dense(key)
        if new_count == count:
            break
        block, count = finer, new_count
    return _dense(block)[0]


def _dense(key: np.ndarray) -> tuple[np.ndarray, int]:
    values, dense = np.unique(key, return_inverse=True)
    return dense.reshape(-1), len(values)


def _refine_small(delta: np.ndarray, accepting: np.ndarray, limits: Limits) -> np.ndarray:
    """What `_refine` does, for few states."""
    rows, block, count = delta.tolist(), accepting.tolist(), 0
    while count < len(rows):
        limits.spend(delta.size)
        ids: dict[tuple, int] = {}
        block = [
            ids.setdefault((own, *[block[t] for t in row]), len(ids))
            for own, row in zip(block, rows, strict=True)
        ]
        if len(ids) == count:
            break
        count = len(ids)
    return np.array(block, np.int64)


def _numbered(
    delta: np.ndarray, accepting: np.ndarray, start: int
) -> tuple[np.ndarray, np.ndarray]:
    rows = delta.tolist()
    order = {start: 0}
    queue = [start]
    for state in queue:
        for target in rows[state]:
            if target not in order:
                order[target] = len(order)
                queue.append(target)
    number = np.empty(len(rows), np.int32)
    number[queue] = np.arange(len(queue), dtype=np.int32)
    return number[delta[queue]], accepting[queue]
