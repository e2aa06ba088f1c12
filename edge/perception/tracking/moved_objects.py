"""Objects that were moved: missing at their place, and seen at another one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from edge.host.checkpoint import Arrays
from edge.perception.tracking.tracked_objects import TrackedObjects

MAX_VANISHED = 64
"""Number of vanished objects that are kept until they are seen elsewhere; the oldest go first."""
VANISHED = tuple(
    f"vanished_{name}" for name in ("id", "word", "first_ns", "last_ns", "xyz_m", "moves")
)
"""Arrays of a `state_dict` with the attributes of `VanishedObject`, in their order."""


class VanishedObject(NamedTuple):
    """An object that was certain (see `ObjectTracker`), and then missing at its place.

    Attributes:
        id: id of the object's row.
        word: index into `TrackedObjects.words`.
        first_seen_ns, last_seen_ns, moves: see `TrackedObjects`.
        xyz_m: last place of the object in `map`.
    """

    id: int
    word: int
    first_seen_ns: int
    last_seen_ns: int
    xyz_m: tuple[float, float, float]
    moves: int


class MovedObjects:
    """The objects that were moved: one seen at another place gets the id that it had before.

    Attributes:
        vanished: certain objects that are missing at their place and were not found elsewhere,
            oldest first.
        renamed: new id → old id of the objects that the newest image showed to be a known one:
            it had moved, or two rows were one object. In order: an old id may be renamed later.
    """

    def __init__(self, objects: TrackedObjects) -> None:
        self._objects = objects
        self.vanished: list[VanishedObject] = []
        self.renamed: dict[int, int] = {}

    def appear(self, at: int) -> None:
        """Give a new row the identity of the nearest vanished object of its word, if there is one.

        An object that was seen after the row was first seen is a different one: both existed.
        """
        s = self._objects
        same = [
            v for v in self.vanished
            if v.word == s.word[at] and v.last_seen_ns < s.first_seen_ns[at]
        ]  # fmt: skip
        if same:
            nearest = min(same, key=lambda v: float(np.hypot(*(s.xyz_m[at, :2] - v.xyz_m[:2]))))
            self.vanished.remove(nearest)
            self._take_identity(at, nearest)

    def vanish(self, gone: VanishedObject, min_hits: int) -> None:
        """Find the row that a certain object has become; if there is none, wait until it appears.

        That row is certain (`min_hits`), was first seen after the object was last seen, and has an
        identity of its own (`moves` is 0).
        """
        s = self._objects
        later = (s.word[: s.n] == gone.word) & (s.first_seen_ns[: s.n] > gone.last_seen_ns)
        later &= (s.hits[: s.n] >= min_hits) & (s.moves[: s.n] == 0)
        rows = np.flatnonzero(later)
        if len(rows):
            apart_m = np.hypot(*(s.xyz_m[rows, :2] - gone.xyz_m[:2]).T)
            self._take_identity(int(rows[apart_m.argmin()]), gone)
            return
        self.vanished = [*self.vanished, gone][-MAX_VANISHED:]

    def unite(self, kept: int, gone: int) -> None:
        """Give a row the older identity, that with the smaller id, of two rows of one object."""
        s = self._objects
        older, newer = (kept, gone) if s.id[kept] < s.id[gone] else (gone, kept)
        self.renamed[int(s.id[newer])] = int(s.id[older])
        for array in (s.id, s.moves, s.came_from_m):
            array[kept] = array[older]

    def _take_identity(self, at: int, before: VanishedObject) -> None:
        """Make a row the same object as a vanished one, which has moved to the row's place."""
        s = self._objects
        self.renamed[int(s.id[at])] = before.id
        s.id[at], s.first_seen_ns[at] = before.id, before.first_seen_ns
        s.came_from_m[at], s.moves[at] = before.xyz_m[:2], before.moves + 1
        s.generation += 1

    def state_dict(self) -> Arrays:
        """Return the vanished objects."""
        gone = self.vanished
        return {
            "vanished_id": np.array([v.id for v in gone], np.int64),
            "vanished_word": np.array([v.word for v in gone], np.int16),
            "vanished_first_ns": np.array([v.first_seen_ns for v in gone], np.int64),
            "vanished_last_ns": np.array([v.last_seen_ns for v in gone], np.int64),
            "vanished_xyz_m": np.array([v.xyz_m for v in gone], np.float64).reshape(-1, 3),
            "vanished_moves": np.array([v.moves for v in gone], np.int32),
        }

    def load_state_dict(self, state: Arrays, new_index: np.ndarray, later_ns: int) -> None:
        """Load a `state_dict`; `new_index` is the index of each word of the state."""
        self.vanished = [
            VanishedObject(
                i, int(new_index[word]), first + later_ns, last + later_ns, (x, y, z), moves
            )
            for i, word, first, last, (x, y, z), moves in zip(
                *(state[name].tolist() for name in VANISHED), strict=True
            )
        ][-MAX_VANISHED:]
