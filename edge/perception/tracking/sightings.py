"""The object map: all objects that the detector found, merged by word and place over time.

A word is a canonical class name. It names a target, or it belongs to the context: the other classes
that the detector looks for. Each object is one row of parallel arrays. `ObjectTracker` updates them
with each image. The memory, the prior, rooms and policies read them as `TrackedObjects`. The
targets among the objects are tracked in more detail, in `instances`. Names such as `tau_det` and
`merge_m` are keys of `perception` in the configuration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from edge import config, names
from edge.geometry import FARTHEST_M, invert
from edge.host.checkpoint import Arrays, check_arrays
from edge.perception.tracking import place_index
from edge.perception.tracking import sighting_kernels as kernels
from edge.perception.tracking.lift import BackProjectedBoxes
from edge.perception.tracking.look_kernels import NO_DEPTH, view_of
from edge.types import Observation

MAX_SIGHTINGS = 5000
"""Largest number of objects in the map."""
_DROP_SHARE = 0.1
"""An object is dropped if its confidence is below this share of `tau_det`.

It was a false detection, or it is gone."""
_CONFIDENCE_CHANGE = 0.1
"""Change of a confidence that raises the generation."""
_SHIFT_M = 0.2
"""Shift of an object along one axis that raises the generation."""
_BROADER_WEIGHT = 0.75
"""Weight of a broader word against a narrower one.

An armchair is a chair. But an object that is clearly a chair and hardly an armchair is no armchair.
"""
_MOST_VIEWS = 20
"""Views in the running mean of a centre: later views still move it, each by 1/20 of the error."""
_NO_WEIGHTS = np.zeros(0, np.float32)
MAX_VANISHED = 64
"""Number of vanished objects that are kept until they are seen elsewhere; the oldest go first."""


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


class MappedObject(NamedTuple):
    """One row of `TrackedObjects` with its evidence.

    Attributes:
        center_m: (3,) float32 in `map`.
        points_m: (k, 3) float32 in `map`, surface points.
        confidence: see `TrackedObjects`.
        weight: sum of the weights of all views.
        total: sum of weights times scores.
        hits, near_hits, last_seen_ns: see `TrackedObjects`.
    """

    center_m: np.ndarray
    points_m: np.ndarray
    confidence: float
    weight: float
    total: float
    hits: int
    near_hits: int
    last_seen_ns: int


class VanishedObject(NamedTuple):
    """An object that was certain (see `ObjectTracker._vanish`), and then missing at its place.

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


class ObservedObject(NamedTuple):
    """An object in the newest image.

    Attributes:
        id: id of the object's row.
        xyxy_px: (4,) float32, box of the object in the image.
    """

    id: int
    xyxy_px: np.ndarray
    score: float


class ObjectTracker:
    """Fuses the boxes of targets and context into objects, by word and place.

    A strong box (score above `tau_det`) starts an object; a weak one (any other box) only counts at
    a known place. Each view that should show an object but has no box for it lowers the object's
    confidence. The arrays are allocated once: over `MAX_SIGHTINGS` the least confident object is
    dropped.

    Attributes:
        read_only: read-only view, for policies.
        observed: objects that the newest image showed with a strong box.
        vanished: certain objects that are missing at their place and were not found elsewhere,
            oldest first.
        renamed: new id → old id of the objects that the newest image showed to have moved.
    """

    def __init__(self, perception: config.PerceptionConfig) -> None:
        cap = MAX_SIGHTINGS
        self.config = perception
        self._objects = TrackedObjects(cap)
        # More columns of the objects. Score in the present image, 0: not detected.
        self._now = np.zeros(cap, np.float32)
        # Sums of the views' weights, and of weights times scores; position of the next point.
        self._weight = np.zeros(cap, np.float32)
        self._total = np.zeros(cap, np.float32)
        self._cursor = np.zeros(cap, np.int32)
        # Columns: confidence, x, y, z, at the last time when the row raised the generation.
        self._counted = np.zeros((cap, 4), np.float32)
        # Highest confidence so far. A row that was never certain was a mistake, and cannot move.
        self._peak_confidence = np.zeros(cap, np.float32)
        # Index of each word in `TrackedObjects.words`; weights of all words against an object.
        self._word_index: dict[str, int] = {}
        self._competing: dict[str, np.ndarray] = {}
        # The detector's words in the newest image: a flag for each word of `TrackedObjects.words`,
        # the prompts and context words, and the word of each of their class ids.
        self._looked_for = np.zeros(0, np.bool_)
        self._prompts_and_words: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._word_of_class: tuple[np.ndarray, np.ndarray] = (np.zeros(0, np.int16),) * 2
        self._next_id = 1
        self._index = place_index.make_index(cap)
        self._rows = np.zeros(cap, np.int32)  # scratch for rows found in the index
        self._farthest_m = 0.0  # no smaller than the largest reach
        self.observed: list[ObservedObject] = []
        self.vanished: list[VanishedObject] = []
        self.renamed: dict[int, int] = {}
        self.read_only = self._objects.read_only()

    def update(self, targets: BackProjectedBoxes, context: BackProjectedBoxes | None) -> None:
        """Update the objects with all detections of one image, and with what it did not show.

        Args:
            targets: boxes of targets, with positions.
            context: boxes of context words, with positions; None: not looked for.
        """
        observation = targets.detections.observation
        self._set_words(
            targets.detections.prompts, () if context is None else context.detections.prompts
        )
        self.observed.clear()
        self.renamed.clear()
        self._farthest_m = float(self._objects.reach_m[: self._objects.n].max(initial=0.0))
        for boxes, word_of_class in zip((targets, context), self._word_of_class, strict=True):
            if boxes is not None:
                self._merge_boxes(boxes, word_of_class, observation)
        self._merge_duplicates()
        if observation.camera is not None:
            self._fuse(observation)
        self._drop_missed()
        self._note_changes()

    def named(self, label: str) -> Iterator[MappedObject]:
        """Yield all objects that a label names, or that are a kind of it, most confident first.

        The arrays are copies.
        """
        s = self._objects
        kinds = [names.is_kind_of(word, label) for word in s.words]
        matching = [at for at in range(s.n) if kinds[s.word[at]] and s.n_points[at] > 0]
        for at in sorted(matching, key=lambda at: -s.confidence[at]):
            yield MappedObject(
                s.xyz_m[at].copy(), s.points_m[at, : s.n_points[at]].copy(),
                float(s.confidence[at]), float(self._weight[at]), float(self._total[at]),
                int(s.hits[at]), int(s.near_hits[at]), int(s.last_seen_ns[at]),
            )  # fmt: skip

    def has_competing_object(
        self, name: str, surface_m: np.ndarray, radius_m: float, surer: float = 1.0
    ) -> bool:
        """Return True if an object of another word is more likely to stand at an object's place.

        Only words that the detector looks for now count. For others, no view could lower the
        confidence.

        Args:
            name: canonical name of the object.
            surface_m: (k, 3) float32 in `map`, surface points of the object; k > 0.
            radius_m: reach of the object from its centre.
            surer: factor by which the other object must be more confident.
        """
        s, merge_m = self._objects, self.config.merge_m
        x_m, y_m, _ = surface_m.mean(axis=0).tolist()
        own, word = 0.0, self._word_index.get(name, -1)
        at = self._match(word, x_m, y_m, merge_m + radius_m)
        if at >= 0:
            own = float(s.confidence[at])
        against = kernels.competing_confidence(
            surface_m, s.xyz_m, s.points_m, s.n_points, s.word, s.confidence,
            self._rows_near(x_m, y_m, merge_m + radius_m),
            self._competing_with(name) * self._looked_for, merge_m + radius_m,
        )  # fmt: skip
        return against > surer * own

    def _rows_near(self, x_m: float, y_m: float, within_m: float) -> np.ndarray:
        """Return all rows with a centre within a distance of a place, and some farther ones.

        The array is valid until the next call.
        """
        k = place_index.rows_near(self._index, self._objects.n, x_m, y_m, within_m, self._rows)
        return self._rows[:k]

    def _match(self, word: int, x_m: float, y_m: float, within_m: float) -> int:
        """Return the row of a word whose centre or surface is nearest to a place.

        Return -1 if none is within `within_m`.
        """
        # The index has centres; a surface reaches up to `_farthest_m` from its centre.
        s = self._objects
        return kernels.match_near(
            self._index, s.n, within_m + self._farthest_m, self._rows, s.xyz_m, s.points_m,
            s.n_points, s.reach_m, s.word, word, x_m, y_m, within_m,
        )  # fmt: skip

    def _competing_with(self, name: str) -> np.ndarray:
        """Return the weight of each word's confidence against an object, (words,) float32."""
        known = self._competing.get(name, _NO_WEIGHTS)
        if len(known) < len(self._objects.words):
            more = [_weight_against(word, name) for word in self._objects.words[len(known) :]]
            known = self._competing[name] = np.append(known, np.array(more, np.float32))
        return known

    def clear(self) -> None:
        """Forget every object; ids and words continue."""
        self._objects.generation += self._objects.n > 0
        self._objects.n = 0
        self.vanished.clear()
        place_index.rebuild(self._index, self._objects.xyz_m, 0)
        self._update_view()

    def state_dict(self) -> Arrays:
        """Return all rows as plain arrays, with `words`, `next_id` and the vanished objects."""
        columns = {name: array[: self._objects.n].copy() for name, array in self._saved()}
        gone = self.vanished
        return {
            **columns, "words": np.array(self._objects.words, np.str_),
            "next_id": np.array(self._next_id),
            "vanished_id": np.array([v.id for v in gone], np.int64),
            "vanished_word": np.array([v.word for v in gone], np.int16),
            "vanished_first_ns": np.array([v.first_seen_ns for v in gone], np.int64),
            "vanished_last_ns": np.array([v.last_seen_ns for v in gone], np.int64),
            "vanished_xyz_m": np.array([v.xyz_m for v in gone], np.float64).reshape(-1, 3),
            "vanished_moves": np.array([v.moves for v in gone], np.int32),
        }  # fmt: skip

    def load_state_dict(self, state: Arrays, later_ns: int) -> None:
        """Load a `state_dict` into an empty tracker; rows beyond the capacity are left out.

        Args:
            state: from `state_dict`.
            later_ns: added to all stamps, since the sensors' clock may have started again.

        Raises:
            ValueError: the state is invalid.
        """
        s, words = self._objects, state.get("words", np.zeros(0))
        # Most rows of each group of arrays, and largest values: a file may be damaged.
        rows = {
            tuple(name for name, _ in self._saved()): 1 << 13,
            ("words",): 1 << 15,
            _VANISHED: 1 << 8,
        }
        most = {
            "word": words.size - 1, "vanished_word": words.size - 1, "peak": 2,
            "confidence": 2, "n_points": kernels.POINTS,
            "cursor": kernels.POINTS - 1, "weight": FARTHEST_M, "total": FARTHEST_M,
        }  # fmt: skip
        check_arrays(state, self.state_dict(), rows, most, ("id", "words", "vanished_id"))
        s.n = min(len(state["word"]), len(s.word))
        for name, array in self._saved():
            array[: s.n] = state[name][: s.n]
        # Words of this tracker may have other indices than those of the state.
        new_index = self._word_indices(words.tolist())
        s.word[: s.n] = new_index[state["word"][: s.n]]
        s.first_seen_ns[: s.n] += later_ns
        s.last_seen_ns[: s.n] += later_ns
        self.vanished = [
            VanishedObject(
                i, int(new_index[word]), first + later_ns, last + later_ns, (x, y, z), moves
            )
            for i, word, first, last, (x, y, z), moves in zip(
                *(state[name].tolist() for name in _VANISHED), strict=True
            )
        ][-MAX_VANISHED:]
        place_index.rebuild(self._index, s.xyz_m, s.n)
        for at in range(s.n):
            self._place(at)
        self._next_id = max(self._next_id, int(state["next_id"]))
        # This run has not looked for anything yet.
        self._looked_for, self._prompts_and_words = np.zeros(len(s.words), np.bool_), ((), ())
        s.generation += 1
        self._update_view()

    def _saved(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the arrays of a `state_dict`, by their names in it."""
        s = self._objects
        yield from (
            ("xyz_m", s.xyz_m), ("word", s.word), ("confidence", s.confidence),
            ("last_seen_ns", s.last_seen_ns), ("id", s.id), ("hits", s.hits),
            ("near_hits", s.near_hits), ("points_m", s.points_m), ("n_points", s.n_points),
            ("weight", self._weight), ("total", self._total), ("cursor", self._cursor),
            # "told" and "peak": names that older checkpoints have.
            ("told", self._counted), ("peak", self._peak_confidence), ("moves", s.moves),
            ("first_seen_ns", s.first_seen_ns), ("came_from_m", s.came_from_m),
        )  # fmt: skip

    def _set_words(self, prompts: tuple[str, ...], context: tuple[str, ...]) -> None:
        """Set the prompts and context words that the detector looked for in this image."""
        if (prompts, context) == self._prompts_and_words:
            return
        self._prompts_and_words = prompts, context
        self._word_of_class = (
            self._word_indices([names.canonical(names.head_phrase(prompt)) for prompt in prompts]),
            self._word_indices(context),
        )  # fmt: skip
        self._looked_for = np.zeros(len(self._objects.words), np.bool_)
        for indices in self._word_of_class:
            self._looked_for[indices] = True

    def _word_indices(self, words: Sequence[str]) -> np.ndarray:
        """Return the indices of words in `TrackedObjects.words`; new words are appended to it."""
        for word in words:
            if word not in self._word_index:
                self._word_index[word] = len(self._objects.words)
                self._objects.words.append(word)
        return np.array([self._word_index[word] for word in words], np.int16)

    def _merge_boxes(
        self, boxes: BackProjectedBoxes, word_of_class: np.ndarray, observation: Observation
    ) -> None:
        """Merge the boxes of one image; they come strongest first."""
        seen, s, c = boxes.detections, self._objects, self.config
        pose = observation.pose
        for i in np.flatnonzero(boxes.valid).tolist():
            score, word = float(seen.score[i]), int(word_of_class[seen.class_id[i]])
            x_m, y_m, z_m = boxes.center_m[i].tolist()
            at = self._match(word, x_m, y_m, c.merge_m)
            strong = score > c.tau_det
            if at < 0:
                if not strong:
                    continue
                at = self._create(word, (x_m, y_m, z_m), observation.stamp_ns)
            if self._now[at] > 0.0:  # a stronger box of this image matched before
                continue
            self._now[at] = score
            s.last_seen_ns[at] = observation.stamp_ns
            if not strong:
                continue
            s.hits[at] += 1
            near = math.hypot(x_m - pose.x_m, y_m - pose.y_m) <= c.confirm_range_m
            s.near_hits[at] += near and score >= c.confirm_score_of(s.words[word])
            reach_m = kernels.add_view(
                self._index, s.xyz_m, s.points_m, s.n_points, self._cursor, s.reach_m, at,
                boxes.center_m, boxes.points_m, boxes.n_points, i,
                min(int(s.hits[at]), _MOST_VIEWS), c.voxel_m,
            )  # fmt: skip
            self._farthest_m = max(self._farthest_m, reach_m)
            self.observed.append(ObservedObject(int(s.id[at]), seen.xyxy_px[i], score))
            if s.hits[at] == c.min_hits:
                self._reappear(at)

    def _place(self, at: int) -> None:
        """Update the index and the reach after a change of a row's centre or surface."""
        s = self._objects
        place_index.move(self._index, at, *s.xyz_m[at, :2].tolist())
        s.reach_m[at] = kernels.reach_of(s.xyz_m, s.points_m, s.n_points, at)
        self._farthest_m = max(self._farthest_m, float(s.reach_m[at]))

    def _reappear(self, at: int) -> None:
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

    def _take_identity(self, at: int, before: VanishedObject) -> None:
        """Make a row the same object as a vanished one, which has moved to the row's place."""
        s = self._objects
        self.renamed[int(s.id[at])] = before.id
        s.id[at], s.first_seen_ns[at] = before.id, before.first_seen_ns
        s.came_from_m[at], s.moves[at] = before.xyz_m[:2], before.moves + 1
        s.generation += 1

    def _vanish(self, at: int) -> None:
        """Drop a row; if it was certain, another row may be the same object, moved.

        A row is certain with `min_hits` images and if its confidence once was `tau_det` or more.
        """
        s, c = self._objects, self.config
        gone = VanishedObject(
            int(s.id[at]), int(s.word[at]), int(s.first_seen_ns[at]), int(s.last_seen_ns[at]),
            tuple(s.xyz_m[at].tolist()), int(s.moves[at]),
        )  # fmt: skip
        certain = s.hits[at] >= c.min_hits and self._peak_confidence[at] >= c.tau_det
        self._drop(at)
        if not certain:
            return
        # Rows that may be this object: certain, first seen after it was last seen, and with an
        # identity of their own (`moves` is 0).
        later = (s.word[: s.n] == gone.word) & (s.first_seen_ns[: s.n] > gone.last_seen_ns)
        later &= (s.hits[: s.n] >= c.min_hits) & (s.moves[: s.n] == 0)
        rows = np.flatnonzero(later)
        if len(rows):
            apart_m = np.hypot(*(s.xyz_m[rows, :2] - gone.xyz_m[:2]).T)
            self._take_identity(int(rows[apart_m.argmin()]), gone)
            return
        self.vanished = [*self.vanished, gone][-MAX_VANISHED:]

    def _merge_duplicates(self) -> None:
        """Merge pairs of rows that are one object."""
        s, near_m = self._objects, 0.5 * self.config.merge_m
        while True:
            kept, gone = kernels.find_duplicate(
                self._index, s.xyz_m, s.word, s.n, self._now, near_m, self._rows
            )
            if kept < 0:
                return
            share = s.hits[gone] / max(s.hits[kept] + s.hits[gone], 1)
            s.xyz_m[kept] += share * (s.xyz_m[gone] - s.xyz_m[kept])
            for array in (self._weight, self._total, s.hits, s.near_hits):
                array[kept] += array[gone]
            for array in (self._now, s.confidence, s.last_seen_ns, self._peak_confidence):
                array[kept] = max(array[kept], array[gone])
            s.first_seen_ns[kept] = min(s.first_seen_ns[kept], s.first_seen_ns[gone])
            kernels.add_points(
                s.points_m, s.n_points, self._cursor, kept, s.points_m[gone].copy(),
                s.n_points[gone], self.config.voxel_m,
            )  # fmt: skip
            self._place(kept)
            self._drop(gone)

    def _create(self, word: int, xyz_m: tuple[float, float, float], stamp_ns: int) -> int:
        """Add a row and return its index; if all are in use, drop the least confident first."""
        s = self._objects
        if s.n == len(s.word):
            self._drop(int(np.argmin(s.confidence[: s.n] + self._now[: s.n])))
        at, s.n = s.n, s.n + 1
        s.xyz_m[at], s.word[at], s.id[at] = xyz_m, word, self._next_id
        s.points_m[at] = 0.0  # clear the old row: a checkpoint saves all of it
        s.confidence[at] = s.hits[at] = s.near_hits[at] = s.n_points[at] = 0
        self._weight[at] = self._total[at] = self._cursor[at] = self._now[at] = 0
        s.reach_m[at] = s.moves[at] = s.came_from_m[at] = self._peak_confidence[at] = 0
        s.first_seen_ns[at] = stamp_ns
        self._counted[at] = -1.0
        self._next_id += 1
        place_index.insert(self._index, at, xyz_m[0], xyz_m[1])
        return at

    def _fuse(self, observation: Observation) -> None:
        """Update the confidence of all rows: detected, in view but not detected, or not in view."""
        s, c, camera = self._objects, self.config, observation.camera
        far_m = min(2.0 * c.confirm_range_m, c.back_projection_max_range_m)
        depth = NO_DEPTH if observation.depth_m is None else observation.depth_m
        kernels.fuse(
            s.xyz_m, s.points_m, s.n_points, s.word, s.n, self._now, self._looked_for,
            invert(observation.T_map_base @ observation.T_base_camera), view_of(camera), depth,
            c.confirm_range_m, far_m, self._weight, self._total, s.confidence,
        )  # fmt: skip

    def _drop_missed(self) -> None:
        """Drop the rows that were in view and not detected too often."""
        s = self._objects
        # One view alone (weight 1) drops nothing.
        least = _DROP_SHARE * self.config.tau_det
        weak = (s.confidence[: s.n] < least) & (self._weight[: s.n] > 1.0)
        for at in np.flatnonzero(weak)[::-1].tolist():
            self._vanish(at)

    def _drop(self, at: int) -> None:
        """Drop a row; the last one takes its place."""
        s = self._objects
        last = s.n - 1
        place_index.remove(self._index, at)
        for array in (
            s.xyz_m, s.word, s.confidence, s.last_seen_ns, s.id, s.hits, s.near_hits, s.points_m,
            s.n_points, s.reach_m, s.moves, s.came_from_m, s.first_seen_ns, self._peak_confidence,
            self._now, self._weight, self._total, self._cursor, self._counted,
        ):  # fmt: skip
            array[at] = array[last]
        if at != last:
            place_index.remove(self._index, last)
            place_index.insert(self._index, at, *s.xyz_m[at, :2].tolist())
        s.n = last
        s.generation += 1

    def _note_changes(self) -> None:
        """Update the peak confidences; raise the generation if any row has changed enough."""
        s, counted = self._objects, self._counted
        np.maximum(
            self._peak_confidence[: s.n], s.confidence[: s.n], out=self._peak_confidence[: s.n]
        )
        moved = np.abs(s.confidence[: s.n] - counted[: s.n, 0]) > _CONFIDENCE_CHANGE
        moved |= np.abs(s.xyz_m[: s.n] - counted[: s.n, 1:]).max(axis=1, initial=0) > _SHIFT_M
        if moved.any():
            at = np.flatnonzero(moved)
            counted[at, 0], counted[at, 1:] = s.confidence[at], s.xyz_m[at]
            s.generation += 1
        self._update_view()

    def _update_view(self) -> None:
        self.read_only.n, self.read_only.generation = self._objects.n, self._objects.generation


# Arrays of a `state_dict` with the attributes of `VanishedObject`, in their order.
_VANISHED = tuple(
    f"vanished_{name}" for name in ("id", "word", "first_ns", "last_ns", "xyz_m", "moves")
)


def _weight_against(word: str, name: str) -> float:
    """Return the weight of a word's confidence against an object of this name.

    The weight is 0 if the word names the same object, or a kind of it.
    """
    if names.is_kind_of(word, name):
        return 0.0
    return _BROADER_WEIGHT if names.is_kind_of(name, word) else 1.0
