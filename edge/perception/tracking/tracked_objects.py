"""All objects seen, as parallel arrays; `object_tracker` updates them."""

from __future__ import annotations

from copy import copy

import numpy as np

from edge.perception.tracking import object_kernels as kernels


class TrackedObjects:
    """The objects seen, as parallel arrays in no order; the first `n` rows count.

    An object that is seen elsewhere, while its old place is seen empty, keeps its id.

    Attributes:
        generation: raised by each relevant change: a row is new, gone or moved, or its confidence
            changed.
        words: canonical names; only grows at its end.
        xyz_m: (capacity, 3) float32 in `map`, centre of the object.
        word: (capacity,) int16, index into `words`.
        confidence: (capacity,) float32 in [0, 1], mean score over all views of the place, weighted
            by the quality of each view; a view without a detection has score 0 (as in ApexNav).
        first_seen_ns: (capacity,) int64, stamp of the first detection.
        last_seen_ns: (capacity,) int64, stamp of the newest detection.
        id: (capacity,) int64, never reused.
        hits: (capacity,) int32, number of images with a detection.
        near_hits: (capacity,) int32, number of these images that were taken at most
            `confirm_range_m` away and gave a score of at least `confirm_score_of` the word.
        points_m: (capacity, POINTS, 3) float32 in `map`, surface points of the newest voxels; the
            first `n_points[i]` of row i count.
        n_points: (capacity,) int32, number of surface points.
        reach_m: (capacity,) float32, largest planar distance of a surface point from the centre.
        moves: (capacity,) int32, number of times that the object was found at another place.
        came_from_m: (capacity, 2) float32 in `map`, place of the object before its last move.
    """

    def __init__(self, capacity: int) -> None:
        self.n = self.generation = 0
        self.words: list[str] = []
        self.xyz_m = np.zeros((capacity, 3), np.float32)
        self.word = np.zeros(capacity, np.int16)
        self.confidence = np.zeros(capacity, np.float32)
        self.first_seen_ns = np.zeros(capacity, np.int64)
        self.last_seen_ns = np.zeros(capacity, np.int64)
        self.id = np.zeros(capacity, np.int64)
        self.hits = np.zeros(capacity, np.int32)
        self.near_hits = np.zeros(capacity, np.int32)
        self.points_m = np.zeros((capacity, kernels.POINTS, 3), np.float32)
        self.n_points = np.zeros(capacity, np.int32)
        self.reach_m = np.zeros(capacity, np.float32)
        self.moves = np.zeros(capacity, np.int32)
        self.came_from_m = np.zeros((capacity, 2), np.float32)

    def read_only(self) -> TrackedObjects:
        """Return a read-only view of the same arrays; the writer must copy `n` and `generation`."""
        shown = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                view = value.view()
                view.flags.writeable = False
                setattr(shown, name, view)
        return shown

    def of(self, name: str) -> np.ndarray:
        """Return the indices of all rows with this canonical name, (k,) int64."""
        if name not in self.words:
            return np.zeros(0, np.int64)
        return np.flatnonzero(self.word[: self.n] == self.words.index(name))
