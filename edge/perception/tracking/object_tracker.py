"""The object map: all objects that the detector found, merged by word and place over time.

A word is a canonical class name. It names a target, or it belongs to the context: the other classes
that the detector looks for. Each object is one row of parallel arrays. `ObjectTracker` updates them
with each image. The memory, the prior, rooms and policies read them as `TrackedObjects`. The
targets among the objects are tracked in more detail, in `instances`. Names such as `tau_det` and
`merge_m` are keys of `perception` in the configuration.

Use it for what is where: thousands of objects with a few points each. Use `instances` for the
targets, and `edge.tasks.scene.objects` for the extent of an object that a trajectory passes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from edge import config, names
from edge.geometry import FARTHEST_M, invert
from edge.host.checkpoint import Arrays, check_arrays
from edge.perception.tracking import object_kernels as kernels
from edge.perception.tracking import place_index
from edge.perception.tracking.back_projection import BackProjectedBoxes
from edge.perception.tracking.look_kernels import NO_DEPTH, view_of
from edge.perception.tracking.moved_objects import VANISHED, MovedObjects, VanishedObject
from edge.perception.tracking.object_words import ObjectWords
from edge.perception.tracking.track import VOXEL_M
from edge.perception.tracking.tracked_objects import TrackedObjects
from edge.types import Observation

MAX_TRACKED = 5000
"""Largest number of objects in the map."""
_DROP_SHARE = 0.1
"""An object is dropped if its confidence is below this share of `tau_det`.

It was a false detection, or it is gone."""
_CONFIDENCE_CHANGE = 0.1
"""Change of a confidence that raises the generation."""
_SHIFT_M = 0.2
"""Shift of an object along one axis that raises the generation."""
_MOST_VIEWS = 20
"""Views in the running mean of a centre: later views still move it, each by 1/20 of the error."""


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


class ObservedObject(NamedTuple):
    """An object in the newest image.

    Attributes:
        id: id of the object's row.
        xyxy_px: (4,) float32, box of the object in the image.
    """

    id: int
    xyxy_px: np.ndarray
    score: float


class _Evidence(NamedTuple):
    """More columns of the objects.

    Attributes:
        now: (capacity,) float32, score in the present image; 0: not detected.
        weight: (capacity,) float32, sum of the weights of all views.
        total: (capacity,) float32, sum of weights times scores.
        peak: (capacity,) float32, highest confidence so far. A row that was never certain was a
            mistake, and cannot move.
        cursor: (capacity,) int32, position of the next surface point.
        counted: (capacity, 4) float32: confidence, x, y, z, at the last time when the row raised
            the generation.
    """

    now: np.ndarray
    weight: np.ndarray
    total: np.ndarray
    peak: np.ndarray
    cursor: np.ndarray
    counted: np.ndarray


class ObjectTracker:
    """Fuses the boxes of targets and context into objects, by word and place.

    A strong box (score above `tau_det`) starts an object; a weak one (any other box) only counts at
    a known place. Each view that should show an object but has no box for it lowers the object's
    confidence. The arrays are allocated once: over `MAX_TRACKED` the least confident object is
    dropped.

    Attributes:
        read_only: read-only view, for policies.
        observed: objects that the newest image showed with a strong box.
        moved: objects that are missing at their place, or were found elsewhere.
        words: words of the objects.
    """

    def __init__(self, perception: config.PerceptionConfig) -> None:
        cap = MAX_TRACKED
        self.config = perception
        self._objects = TrackedObjects(cap)
        self._evidence = _Evidence(
            *(np.zeros(cap, np.float32) for _ in range(4)), np.zeros(cap, np.int32),
            np.zeros((cap, 4), np.float32),
        )  # fmt: skip
        self.words = ObjectWords(self._objects.words)
        self.moved = MovedObjects(self._objects)
        self._next_id = 1
        self._index = place_index.make_index(cap)
        self._rows = np.zeros(cap, np.int32)  # scratch for rows found in the index
        self._farthest_m = 0.0  # no smaller than the largest reach
        self.observed: list[ObservedObject] = []
        self.read_only = self._objects.read_only()

    def update(self, targets: BackProjectedBoxes, context: BackProjectedBoxes | None) -> None:
        """Update the objects with all detections of one image, and with what it did not show.

        Args:
            targets: boxes of targets, with positions.
            context: boxes of context words, with positions; None: not looked for.
        """
        observation = targets.detections.observation
        self.words.look_for(
            targets.detections.prompts, () if context is None else context.detections.prompts
        )
        self.observed.clear()
        self.moved.renamed.clear()
        self._farthest_m = float(self._objects.reach_m[: self._objects.n].max(initial=0.0))
        for boxes, word_of_class in zip((targets, context), self.words.of_class, strict=True):
            if boxes is not None:
                self._merge_boxes(boxes, word_of_class, observation)
        self._merge_duplicates()
        if observation.camera is not None:
            self._fuse(observation)
        self._drop_missed()
        self._rename_observed()
        self._note_changes()

    def named(self, label: str) -> Iterator[MappedObject]:
        """Yield all objects that a label names, or that are a kind of it, most confident first.

        The arrays are copies.
        """
        s, e = self._objects, self._evidence
        kinds = [names.is_kind_of(word, label) for word in s.words]
        matching = [at for at in range(s.n) if kinds[s.word[at]] and s.n_points[at] > 0]
        for at in sorted(matching, key=lambda at: -s.confidence[at]):
            yield MappedObject(
                s.xyz_m[at].copy(), s.points_m[at, : s.n_points[at]].copy(),
                float(s.confidence[at]), float(e.weight[at]), float(e.total[at]),
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
        s, within_m = self._objects, self.config.merge_m + radius_m
        x_m, y_m, _ = surface_m.mean(axis=0).tolist()
        own, word = 0.0, self.words.index.get(name, -1)
        at = self._match(word, x_m, y_m, within_m)
        if at >= 0:
            own = float(s.confidence[at])
        k = place_index.rows_near(self._index, s.n, x_m, y_m, within_m, self._rows)
        against = kernels.competing_confidence(
            surface_m, s.xyz_m, s.points_m, s.n_points, s.word, s.confidence,
            self._rows[:k], self.words.weights_against(name), within_m,
        )  # fmt: skip
        return against > surer * own

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

    def clear(self) -> None:
        """Forget every object; ids and words continue."""
        self._objects.generation += self._objects.n > 0
        self._objects.n = 0
        self.moved.vanished.clear()
        place_index.rebuild(self._index, self._objects.xyz_m, 0)
        self._update_view()

    def state_dict(self) -> Arrays:
        """Return all rows as plain arrays, with `words`, `next_id` and the vanished objects."""
        columns = {name: array[: self._objects.n].copy() for name, array in self._saved()}
        return {
            **columns, "words": np.array(self._objects.words, np.str_),
            "next_id": np.array(self._next_id), **self.moved.state_dict(),
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
            VANISHED: 1 << 8,
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
        new_index = self.words.indices(words.tolist())
        s.word[: s.n] = new_index[state["word"][: s.n]]
        s.first_seen_ns[: s.n] += later_ns
        s.last_seen_ns[: s.n] += later_ns
        self.moved.load_state_dict(state, new_index, later_ns)
        place_index.rebuild(self._index, s.xyz_m, s.n)
        for at in range(s.n):
            self._place(at)
        self._next_id = max(self._next_id, int(state["next_id"]))
        self.words.look_for_nothing()
        s.generation += 1
        self._update_view()

    def _saved(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the arrays of a `state_dict`, by their names in it."""
        s, e = self._objects, self._evidence
        yield from (
            ("xyz_m", s.xyz_m), ("word", s.word), ("confidence", s.confidence),
            ("last_seen_ns", s.last_seen_ns), ("id", s.id), ("hits", s.hits),
            ("near_hits", s.near_hits), ("points_m", s.points_m), ("n_points", s.n_points),
            ("weight", e.weight), ("total", e.total), ("cursor", e.cursor),
            # "told" and "peak": names that older checkpoints have.
            ("told", e.counted), ("peak", e.peak), ("moves", s.moves),
            ("first_seen_ns", s.first_seen_ns), ("came_from_m", s.came_from_m),
        )  # fmt: skip

    def _merge_boxes(
        self, boxes: BackProjectedBoxes, word_of_class: np.ndarray, observation: Observation
    ) -> None:
        """Merge the boxes of one image; they come strongest first."""
        detections, s, e, c = boxes.detections, self._objects, self._evidence, self.config
        pose = observation.pose
        for i in np.flatnonzero(boxes.valid).tolist():
            score, word = float(detections.score[i]), int(word_of_class[detections.class_id[i]])
            x_m, y_m, z_m = boxes.center_m[i].tolist()
            at = self._match(word, x_m, y_m, c.merge_m)
            strong = score > c.tau_det
            if at < 0:
                if not strong:
                    continue
                at = self._create(word, (x_m, y_m, z_m), observation.stamp_ns)
            if e.now[at] > 0.0:  # a stronger box of this image matched before
                continue
            e.now[at] = score
            s.last_seen_ns[at] = observation.stamp_ns
            if not strong:
                continue
            s.hits[at] += 1
            near = math.hypot(x_m - pose.x_m, y_m - pose.y_m) <= c.confirm_range_m
            s.near_hits[at] += near and score >= c.confirm_score_of(s.words[word])
            reach_m = kernels.add_view(
                self._index, s.xyz_m, s.points_m, s.n_points, e.cursor, s.reach_m, at,
                boxes.center_m, boxes.points_m, boxes.n_points, i,
                min(int(s.hits[at]), _MOST_VIEWS), VOXEL_M,
            )  # fmt: skip
            self._farthest_m = max(self._farthest_m, reach_m)
            self.observed.append(ObservedObject(int(s.id[at]), detections.xyxy_px[i], score))
            if s.hits[at] == c.min_hits:
                self.moved.appear(at)

    def _place(self, at: int) -> None:
        """Update the index and the reach after a change of a row's centre or surface."""
        s = self._objects
        place_index.move(self._index, at, *s.xyz_m[at, :2].tolist())
        s.reach_m[at] = kernels.reach_of(s.xyz_m, s.points_m, s.n_points, at)
        self._farthest_m = max(self._farthest_m, float(s.reach_m[at]))

    def _vanish(self, at: int) -> None:
        """Drop a row; if it was certain, another row may be the same object, moved.

        A row is certain with `min_hits` images and if its confidence once was `tau_det` or more.
        """
        s, c = self._objects, self.config
        gone = VanishedObject(
            int(s.id[at]), int(s.word[at]), int(s.first_seen_ns[at]), int(s.last_seen_ns[at]),
            tuple(s.xyz_m[at].tolist()), int(s.moves[at]),
        )  # fmt: skip
        certain = s.hits[at] >= c.min_hits and self._evidence.peak[at] >= c.tau_det
        self._drop(at)
        if certain:
            self.moved.vanish(gone, c.min_hits)

    def _merge_duplicates(self) -> None:
        """Merge pairs of rows that are one object."""
        s, e, near_m = self._objects, self._evidence, 0.5 * self.config.merge_m
        while True:
            kept, gone = kernels.find_duplicate(
                self._index, s.xyz_m, s.word, s.n, e.now, near_m, self._rows
            )
            if kept < 0:
                return
            share = s.hits[gone] / max(s.hits[kept] + s.hits[gone], 1)
            s.xyz_m[kept] += share * (s.xyz_m[gone] - s.xyz_m[kept])
            for array in (e.weight, e.total, s.hits, s.near_hits):
                array[kept] += array[gone]
            for array in (e.now, s.confidence, s.last_seen_ns, e.peak):
                array[kept] = max(array[kept], array[gone])
            s.first_seen_ns[kept] = min(s.first_seen_ns[kept], s.first_seen_ns[gone])
            self.moved.unite(kept, gone)
            kernels.add_points(
                s.points_m, s.n_points, e.cursor, kept, s.points_m[gone].copy(),
                s.n_points[gone], VOXEL_M,
            )  # fmt: skip
            self._place(kept)
            self._drop(gone)

    def _rename_observed(self) -> None:
        """Give `observed` the ids that the rows have now."""
        if not self.moved.renamed:
            return
        by_id: dict[int, ObservedObject] = {}
        for obj in self.observed:
            now = obj.id
            for new, old in self.moved.renamed.items():
                now = old if now == new else now
            by_id.setdefault(now, obj._replace(id=now))  # a stronger box comes first
        self.observed[:] = by_id.values()

    def _create(self, word: int, xyz_m: tuple[float, float, float], stamp_ns: int) -> int:
        """Add a row and return its index; if all are in use, drop the least confident first."""
        s, e = self._objects, self._evidence
        if s.n == len(s.word):
            self._drop(int(np.argmin(s.confidence[: s.n] + e.now[: s.n])))
        at, s.n = s.n, s.n + 1
        s.xyz_m[at], s.word[at], s.id[at] = xyz_m, word, self._next_id
        s.points_m[at] = 0.0  # clear the old row: a checkpoint saves all of it
        s.confidence[at] = s.hits[at] = s.near_hits[at] = s.n_points[at] = 0
        e.weight[at] = e.total[at] = e.cursor[at] = e.now[at] = 0
        s.reach_m[at] = s.moves[at] = s.came_from_m[at] = e.peak[at] = 0
        s.first_seen_ns[at] = stamp_ns
        e.counted[at] = -1.0
        self._next_id += 1
        place_index.insert(self._index, at, xyz_m[0], xyz_m[1])
        return at

    def _fuse(self, observation: Observation) -> None:
        """Update the confidence of all rows: detected, in view but not detected, or not in view."""
        s, e, c, camera = self._objects, self._evidence, self.config, observation.camera
        far_m = min(2.0 * c.confirm_range_m, c.back_projection_max_range_m)
        depth = NO_DEPTH if observation.depth_m is None else observation.depth_m
        kernels.fuse(
            s.xyz_m, s.points_m, s.n_points, s.word, s.n, e.now, self.words.looked_for,
            invert(observation.T_map_base @ observation.T_base_camera), view_of(camera), depth,
            c.confirm_range_m, far_m, e.weight, e.total, s.confidence,
        )  # fmt: skip

    def _drop_missed(self) -> None:
        """Drop the rows that were in view and not detected too often."""
        s = self._objects
        # One view alone (weight 1) drops nothing.
        least = _DROP_SHARE * self.config.tau_det
        weak = (s.confidence[: s.n] < least) & (self._evidence.weight[: s.n] > 1.0)
        for at in np.flatnonzero(weak)[::-1].tolist():
            self._vanish(at)

    def _drop(self, at: int) -> None:
        """Drop a row; the last one takes its place."""
        s = self._objects
        last = s.n - 1
        place_index.remove(self._index, at)
        for array in (
            s.xyz_m, s.word, s.confidence, s.last_seen_ns, s.id, s.hits, s.near_hits, s.points_m,
            s.n_points, s.reach_m, s.moves, s.came_from_m, s.first_seen_ns, *self._evidence,
        ):  # fmt: skip
            array[at] = array[last]
        if at != last:
            place_index.remove(self._index, last)
            place_index.insert(self._index, at, *s.xyz_m[at, :2].tolist())
        s.n = last
        s.generation += 1

    def _note_changes(self) -> None:
        """Update the peak confidences; raise the generation if any row has changed enough."""
        s, counted, peak = self._objects, self._evidence.counted, self._evidence.peak
        np.maximum(peak[: s.n], s.confidence[: s.n], out=peak[: s.n])
        moved = np.abs(s.confidence[: s.n] - counted[: s.n, 0]) > _CONFIDENCE_CHANGE
        moved |= np.abs(s.xyz_m[: s.n] - counted[: s.n, 1:]).max(axis=1, initial=0) > _SHIFT_M
        if moved.any():
            at = np.flatnonzero(moved)
            counted[at, 0], counted[at, 1:] = s.confidence[at], s.xyz_m[at]
            s.generation += 1
        self._update_view()

    def _update_view(self) -> None:
        self.read_only.n, self.read_only.generation = self._objects.n, self._objects.generation
