"""3-D object map: boxes of objects, merged from many pictures (OpenNav III-B).

Use it for the extent of the few objects of a task, with up to `MOST_POINTS` points each: it
compares a detection with all of them. For each image of a mission, `edge.perception.tracking` has
`instances` (the targets) and `object_tracker` (everything else).
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice

import cv2
import numpy as np

from edge import names

GAP_M, GAP_SHARE = 0.4, 0.012
"""Largest gap between points of one object: `GAP_M` plus `GAP_SHARE` of the sensor's distance.
"""
PART_SHARE = 0.1
"""A cluster of points belongs to an object if it has this share of the largest one's points."""
VOXEL_M = 0.1
"""Side of a voxel; an object has at most one point in each."""
NEAR_M = 0.3
"""Distance within which a point belongs to an object that was seen before."""
SAME_SHARE, ALIKE_SHARE = 0.25, 0.6
"""Shares of near points from which two objects are one.

Objects with the same label are one if the share of either reaches `SAME_SHARE`. Objects with
different labels are one if both shares reach `ALIKE_SHARE`, because a detector may give one object
two names. The same holds for two boxes of one picture: it separates a row of cars from a car that
was detected twice.
"""
_CLOSE_M = 0.05
"""Smallest distance from a side that counts, so that points on a side have a finite score."""
_FIT_POINTS = 400  # points from which a box's heading is estimated
MOST_POINTS = 4096
"""Most points of an object."""
MIN_VOTES = 3
"""A voxel belongs to an object if votes for minus votes against it reach this number; less is
enough for an object in few pictures."""
MOST_VOTES = 1 << 16
"""Largest number of voxels with votes; the least recently seen ones are dropped."""
LEAST_POINTS = 5
"""Smallest number of points from which an object's place and size can be estimated."""


@dataclass(slots=True, eq=False)
class MapObject:
    """An object of the 3-D object map.

    Attributes:
        id: unique in the map, from 1.
        labels: sum of the scores of each label that it was given.
        points_m: (n, 3) float32 in `map`, one per voxel, at most `MOST_POINTS`.
        captions: counts of its captions, by label.
        score: highest score of its boxes.
        hits: number of its boxes.
        picture: number of the newest picture that shows it; None if unknown.
        seen_with: ids of objects that were in one picture together with it, so they are different.
    """

    id: int
    labels: dict[str, float]
    points_m: np.ndarray
    captions: dict[str, Counter[str]] = field(default_factory=dict)
    score: float = 0.0
    hits: int = 1
    picture: int | None = None
    seen_with: set[int] = field(default_factory=set)

    @property
    def label(self) -> str:
        """The label with the highest sum of scores."""
        return max(self.labels, key=lambda label: self.labels[label])

    @property
    def caption(self) -> str:
        """The most frequent caption under its label, or the label if there is no caption."""
        counts = self.captions.get(self.label)
        return counts.most_common(1)[0][0] if counts else self.label


def box_around(points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Fit the upright box whose sides the points fit best.

    This is the L-shape fit by search of Zhang, Xu, Dong and Dolan (IV 2017), with the closeness
    criterion. A LiDAR sees at most two sides of an object, and the smallest rectangle around such
    an L is rotated.

    Args:
        points_m: (n, 3), n > 0.

    Returns:
        Centre, (3,) float64; size along the heading, across it, and up, (3,) float64, the first not
        shorter than the second; heading of the longer side in [-pi/2, pi/2), because front and back
        cannot be distinguished.
    """
    xy, z = points_m[:, :2].astype(np.float64), points_m[:, 2].astype(np.float64)
    middle = xy.mean(axis=0)
    xy = xy - middle
    sample = xy[np.linspace(0, len(xy) - 1, min(len(xy), _FIT_POINTS)).astype(np.intp)]
    turn = _best_turn(sample, np.radians(np.arange(0.0, 90.0, 2.0)))
    turn = _best_turn(sample, turn + np.radians(np.arange(-2.0, 2.01, 0.1)))
    c, s = math.cos(turn), math.sin(turn)
    turned = xy @ np.array([[c, -s], [s, c]])
    low, high = turned.min(axis=0), turned.max(axis=0)
    (x, y), (along, across) = 0.5 * (low + high), high - low
    x, y = c * x - s * y + middle[0], s * x + c * y + middle[1]
    if across > along:
        along, across, turn = across, along, turn + 0.5 * math.pi
    heading = (turn + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    bottom, top = float(z.min()), float(z.max())
    position = np.array([x, y, 0.5 * (bottom + top)])
    return position, np.array([along, across, top - bottom]), heading


def _best_turn(xy: np.ndarray, turns: np.ndarray) -> float:
    """Return the heading whose box has the points (n, 2) nearest to its sides."""
    c, s = np.cos(turns), np.sin(turns)
    along, across = xy @ np.stack((c, s)), xy @ np.stack((-s, c))  # (n, turns)
    # Distance of each point from the nearest of the four sides, for each heading.
    off = np.minimum(*(np.minimum(v - v.min(axis=0), v.max(axis=0) - v) for v in (along, across)))
    return float(turns[np.argmax((1.0 / (off + _CLOSE_M)).sum(axis=0))])


def main_clusters(points_m: np.ndarray, sensor_m: np.ndarray, by_mask: bool) -> np.ndarray:
    """Return the indices of the largest clusters of points, as seen from above.

    A house behind trees has several. Small ones are errors of the mask (`PART_SHARE`). A box also
    shows what stands behind the object, so of its points only the largest cluster counts.

    Args:
        points_m: (n, 3) in `map`.
        sensor_m: (3,) position of the sensor.
        by_mask: True if a mask of the object chose the points; False if only its box did.
    """
    if not len(points_m):
        return np.zeros(0, np.intp)
    away_m = float(np.median(np.linalg.norm(points_m - sensor_m, axis=1)))
    part = _parts(points_m[:, :2], GAP_M + GAP_SHARE * away_m)
    count = np.bincount(part)
    if not by_mask:
        return np.flatnonzero(part == np.argmax(count))
    return np.flatnonzero(count[part] >= PART_SHARE * count.max())


def clusters(points_m: np.ndarray, reach_m: float) -> list[np.ndarray]:
    """Return the clusters of points as seen from above, as indices, the largest first."""
    if not len(points_m):
        return []
    part = _parts(points_m[:, :2], reach_m)
    order = np.argsort(part, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(part[order])) + 1)
    return sorted(groups, key=lambda group: -len(group))


def _parts(xy_m: np.ndarray, reach_m: float) -> np.ndarray:
    """Return the connected component of each point, (n,) integers."""
    cells = np.floor((xy_m - xy_m.min(axis=0)) / reach_m).astype(np.int64)
    picture = np.zeros(cells.max(axis=0)[::-1] + 1, np.uint8)
    picture[cells[:, 1], cells[:, 0]] = 1
    _, part = cv2.connectedComponents(picture, connectivity=8)
    return part[cells[:, 1], cells[:, 0]]


def downsample(
    points_m: np.ndarray, voxel_m: float = VOXEL_M, most: int = MOST_POINTS
) -> np.ndarray:
    """Keep the first point of each voxel, then at most `most` of them, evenly: (n, 3) float32."""
    first = first_in_voxels(points_m, np.full(3, voxel_m))
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(np.intp)]
    return np.ascontiguousarray(points_m[first], np.float32)


def first_in_voxels(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the indices of the first point (n, 3) in each voxel of sides `size` (3,).

    The indices ascend.
    """
    if not len(points):
        return np.zeros(0, np.intp)
    voxels = np.floor(points / size).astype(np.int64)
    voxels -= voxels.min(axis=0)
    sides = voxels.max(axis=0) + 1
    flat = (voxels[:, 0] * sides[1] + voxels[:, 1]) * sides[2] + voxels[:, 2]
    return np.sort(np.unique(flat, return_index=True)[1])


def overlap_share(a_m: np.ndarray, b_m: np.ndarray) -> float:
    """Return the share of points (n, 3) that are near one of the others (m, 3); 0 without points.

    Near means in the same cube of side `NEAR_M`, or in an adjacent one.
    """
    corner = np.minimum(a_m.min(axis=0), b_m.min(axis=0)) if len(a_m) and len(b_m) else None
    if corner is None:
        return 0.0
    # Cubes as flat indices: a point is near if its cube is one of `b` or next to one of `b`.
    a, b = (np.floor((points - corner) / NEAR_M).astype(np.int64) + 1 for points in (a_m, b_m))
    sides = np.maximum(a.max(axis=0), b.max(axis=0)) + 2
    steps = np.array([sides[1] * sides[2], sides[2], 1])
    offsets = np.arange(-1, 2)
    neighbours = (offsets[:, None, None] * steps[0] + offsets[:, None] * steps[1] + offsets).ravel()
    near = np.unique((np.unique(b @ steps)[:, None] + neighbours).ravel())
    return float(np.isin(a @ steps, near).mean())


class ObjectMap:
    """The 3-D object map. A detection joins the object that it fits, or becomes a new object.

    Attributes:
        objects: objects by id, from 1, in the order of their first detection; ids are never reused.
    """

    def __init__(self) -> None:
        self.objects: dict[int, MapObject] = {}
        self._newest = 0
        # Votes by label and voxel (x, y, z), the newest last.
        self._votes: Counter[tuple[str, int, int, int]] = Counter()

    def add(
        self,
        label: str,
        points_m: np.ndarray,
        caption: str = "",
        score: float = 1.0,
        picture: int | None = None,
    ) -> MapObject | None:
        """Add the part of an object that one picture shows.

        Args:
            label: name of the object.
            points_m: (n, 3) float32 in `map`.
            caption: description of the object; "" without one.
            score: score of the box, in [0, 1].
            picture: number of the picture, such as `Observation.seq`; None: nothing else was in it.

        Returns:
            The object, or None if there are too few points.

        Example:
            >>> found = ObjectMap()
            >>> corner = np.random.default_rng(0).uniform(0.0, 1.0, (200, 3)).astype(np.float32)
            >>> found.add("car", corner).id, found.add("car", corner + 0.05).id, len(found.objects)
            (1, 1, 1)
        """
        points = downsample(points_m)
        if len(points) < LEAST_POINTS:
            return None
        label = names.canonical(label)
        captions = {label: Counter([caption])} if caption else {}
        new = MapObject(self._newest + 1, {label: score}, points, captions, score, picture=picture)
        likeness = {old.id: _likeness(old, new) for old in self.objects.values()}
        best = max(likeness, key=lambda id: likeness[id], default=0)
        obj = self.objects[best] if likeness.get(best) else None
        if obj is None:
            self._newest += 1
            obj = self.objects[new.id] = new
        else:
            _absorb(obj, new)
        for other in self.objects.values():
            if picture is not None and other.picture == picture and other is not obj:
                obj.seen_with.add(other.id)
                other.seen_with.add(obj.id)
        return self._unite(obj)

    def vote(self, label: str, points_m: np.ndarray, by: int) -> None:
        """Count one picture's vote about an object with this label at some points.

        Args:
            label: name of the object.
            points_m: (n, 3) float32 in `map`.
            by: 1: the picture shows such an object there; -1: it shows something else.
        """
        label = names.canonical(label)
        for voxel in np.unique(_voxels(points_m), axis=0).tolist():
            self._votes[(label, *voxel)] = self._votes.pop((label, *voxel), 0) + by
        for oldest in list(islice(self._votes, max(0, len(self._votes) - MOST_VOTES))):
            del self._votes[oldest]

    def vote_against(self, obj: MapObject, points_m: np.ndarray) -> None:
        """Count one picture's vote against the points (n, 3) that it shows outside a box."""
        own, shown = _voxels(obj.points_m), _voxels(points_m)
        # A picture has thousands of points, but few of them near the object.
        shown = shown[((shown >= own.min(0)) & (shown <= own.max(0))).all(axis=1)]
        for voxel in {*map(tuple, shown.tolist())} & {*map(tuple, own.tolist())}:
            if (obj.label, *voxel) in self._votes:
                self._votes[(obj.label, *voxel)] -= 1

    def confirmed_points_m(self, obj: MapObject) -> np.ndarray:
        """Return the points of an object that enough pictures confirm, (n, 3) float32.

        Votes for minus votes against must reach `MIN_VOTES`, or a third of the object's detections
        if that is less. If this leaves too few points, return all of them.
        """
        voxels = _voxels(obj.points_m).tolist()
        votes = np.array([self._votes[(obj.label, *voxel)] for voxel in voxels])
        agreed = (votes > 0) & (votes >= min(MIN_VOTES, obj.hits / 3))
        enough = agreed.sum() >= LEAST_POINTS
        return obj.points_m[agreed] if enough else obj.points_m

    def _unite(self, changed: MapObject) -> MapObject:
        """Merge an object that has grown with those that it touches now; the oldest one stays.

        The most alike comes first: what it was seen with is then seen with the merged object.
        """
        while True:
            others = [o for o in self.objects.values() if o is not changed]
            likeness = [_likeness(changed, o) for o in others]
            if not any(likeness):
                return changed
            pair = changed, others[int(np.argmax(likeness))]
            changed, other = sorted(pair, key=lambda obj: obj.id)
            _absorb(changed, other)
            del self.objects[other.id]
            for obj in self.objects.values():
                if other.id in obj.seen_with:
                    obj.seen_with = obj.seen_with - {other.id} | {changed.id}
            changed.seen_with.discard(changed.id)


def _voxels(points_m: np.ndarray) -> np.ndarray:
    """Return the voxel of each point, (n, 3) int64."""
    return np.floor(points_m / VOXEL_M).astype(np.int64)


def _likeness(a: MapObject, b: MapObject) -> float:
    """Return the share of near points that makes two objects one; 0 if they are different."""
    apart = np.maximum(a.points_m.min(0) - b.points_m.max(0), b.points_m.min(0) - a.points_m.max(0))
    if apart.max() > NEAR_M:
        return 0.0
    shares = overlap_share(a.points_m, b.points_m), overlap_share(b.points_m, a.points_m)
    together = b.id in a.seen_with or a.id in b.seen_with
    together = together or (a.picture is not None and a.picture == b.picture)
    if a.label == b.label and not together:
        return max(shares) if max(shares) >= SAME_SHARE else 0.0
    return max(shares) if min(shares) >= ALIKE_SHARE else 0.0


def _absorb(target: MapObject, other: MapObject) -> None:
    """Merge `other` into `target`."""
    hits = target.hits + other.hits
    target.points_m = downsample(np.concatenate((target.points_m, other.points_m)))
    for label, score in other.labels.items():
        target.labels[label] = target.labels.get(label, 0.0) + score
    for label, counts in other.captions.items():
        target.captions.setdefault(label, Counter()).update(counts)
    target.score, target.hits = max(target.score, other.score), hits
    target.seen_with = target.seen_with | other.seen_with
    if other.picture is not None and (target.picture is None or other.picture > target.picture):
        target.picture = other.picture
