"""Things in the map: their boxes, and what many pictures of one come to (OpenNav III-B)."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice

import cv2
import numpy as np

from edge import names

REACH_M, REACH_SHARE = 0.4, 0.012
"""Points of one thing lie no further apart, and this share of their distance from the sensor."""
VOXEL_M = 0.1
NEAR_M = 0.3
"""A point of a thing lies about this near to one that was seen of it before."""
SAME_SHARE, ALIKE_SHARE = 0.25, 0.6
"""Two of one label are one thing where so many of the points of either lie near the other's; two of
different labels, where so many of both do: a detector calls one thing by two names. So do two boxes
of one picture, which tells a row of cars from a car that it shows twice."""
_CLOSE_M = 0.05
"""What a point lies off a side counts about this much at least."""
_FIT_POINTS = 400
MOST_POINTS = 4096
AGREED = 3
"""A place is of a thing that is in many pictures where so many show it there."""
MOST_VOTES = 1 << 16
"""Of more places, those are forgotten that no picture has shown for longest."""
LEAST_POINTS = 5
"""With fewer there is no telling where and how large it is."""


@dataclass(slots=True, eq=False)
class MapObject:
    """A thing in the 3D object map.

    Attributes:
        labels: what it was called in each picture, by the sum of the scores.
        points_m: (n, 3) float32 in `map`, one in a voxel, at most `MOST_POINTS`.
        captions: what was said of it in each picture, counted, by what it was called.
        embedding: (d,) float32, the mean over pictures; None: there are none.
        score: the highest of its boxes.
        hits: boxes that it was found in.
        picture: the newest that it was found in; None: it is not known.
        apart: ids of things that one picture has shown beside it.
    """

    id: int
    labels: dict[str, float]
    points_m: np.ndarray
    captions: dict[str, Counter[str]] = field(default_factory=dict)
    embedding: np.ndarray | None = None
    score: float = 0.0
    hits: int = 1
    picture: int | None = None
    apart: set[int] = field(default_factory=set)

    @property
    def label(self) -> str:
        """What it was called with the highest scores, in sum."""
        return max(self.labels, key=lambda label: self.labels[label])

    @property
    def caption(self) -> str:
        """What was said of it most often, and first, as what it is; the label where nothing was."""
        said = self.captions.get(self.label)
        return said.most_common(1)[0][0] if said else self.label


def box_around(points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The upright box that fits points best, when they lie on its sides (Zhang, Xu, Dong, Dolan:
    search-based L-shape fitting, IV 2017, closeness criterion).

    A LiDAR sees two sides of a thing at most, and the smallest rectangle around an L is askew.

    Args:
        points_m: (n, 3), n > 0.

    Returns:
        Its middle, (3,) float64; its size along its heading, across it, and up, (3,) float64, the
        first not shorter than the second; the heading of its longer side, in [-pi/2, pi/2): which
        end is the front is not seen.
    """
    xy, z = points_m[:, :2].astype(np.float64), points_m[:, 2].astype(np.float64)
    middle = xy.mean(axis=0)
    xy = xy - middle
    some = xy[np.linspace(0, len(xy) - 1, min(len(xy), _FIT_POINTS)).astype(np.intp)]
    turn = _best_turn(some, np.radians(np.arange(0.0, 90.0, 2.0)))
    turn = _best_turn(some, turn + np.radians(np.arange(-2.0, 2.01, 0.1)))
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
    """Of some headings, the one whose box has the points (n, 2) nearest to its sides."""
    c, s = np.cos(turns), np.sin(turns)
    along, across = xy @ np.stack((c, s)), xy @ np.stack((-s, c))  # (n, turns)
    off = np.minimum(*(np.minimum(v - v.min(axis=0), v.max(axis=0) - v) for v in (along, across)))
    return float(turns[np.argmax((1.0 / (off + _CLOSE_M)).sum(axis=0))])


def main_cluster(points_m: np.ndarray, sensor_m: np.ndarray) -> np.ndarray:
    """Indices of the most points that hang together seen from above; strays are left out.

    Args:
        points_m: (n, 3) in `map`; sensor_m: (3,), where they were seen from.
    """
    if not len(points_m):
        return np.zeros(0, np.intp)
    away_m = float(np.median(np.linalg.norm(points_m - sensor_m, axis=1)))
    part = _parts(points_m[:, :2], REACH_M + REACH_SHARE * away_m)
    return np.flatnonzero(part == np.argmax(np.bincount(part)))


def clusters(points_m: np.ndarray, reach_m: float) -> list[np.ndarray]:
    """Points that hang together seen from above, as indices, the most first."""
    if not len(points_m):
        return []
    part = _parts(points_m[:, :2], reach_m)
    order = np.argsort(part, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(part[order])) + 1)
    return sorted(groups, key=lambda group: -len(group))


def _parts(xy_m: np.ndarray, reach_m: float) -> np.ndarray:
    """Which connected piece each point belongs to: (n,) integers."""
    cells = np.floor((xy_m - xy_m.min(axis=0)) / reach_m).astype(np.int64)
    picture = np.zeros(cells.max(axis=0)[::-1] + 1, np.uint8)
    picture[cells[:, 1], cells[:, 0]] = 1
    _, part = cv2.connectedComponents(picture, connectivity=8)
    return part[cells[:, 1], cells[:, 0]]


def thin(points_m: np.ndarray, voxel_m: float = VOXEL_M, most: int = MOST_POINTS) -> np.ndarray:
    """One point in a voxel, the first; of more than `most`, evenly many: (n, 3) float32."""
    first = first_in_voxels(points_m, np.full(3, voxel_m))
    if len(first) > most:
        first = first[np.linspace(0, len(first) - 1, most).astype(np.intp)]
    return np.ascontiguousarray(points_m[first], np.float32)


def first_in_voxels(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Indices of the first of the points (n, 3) in each voxel of sides `size`, (3,); ascending."""
    if not len(points):
        return np.zeros(0, np.intp)
    voxels = np.floor(points / size).astype(np.int64)
    voxels -= voxels.min(axis=0)
    sides = voxels.max(axis=0) + 1
    flat = (voxels[:, 0] * sides[1] + voxels[:, 1]) * sides[2] + voxels[:, 2]
    return np.sort(np.unique(flat, return_index=True)[1])


def share_near(a_m: np.ndarray, b_m: np.ndarray, near_m: float = NEAR_M) -> float:
    """Share of the points (n, 3) that have one of others (m, 3) in their own cube of side `near_m`
    or in one beside it; 0 for none."""
    corner = np.minimum(a_m.min(axis=0), b_m.min(axis=0)) if len(a_m) and len(b_m) else None
    if corner is None:
        return 0.0
    a, b = (np.floor((points - corner) / near_m).astype(np.int64) + 1 for points in (a_m, b_m))
    sides = np.maximum(a.max(axis=0), b.max(axis=0)) + 2
    steps = np.array([sides[1] * sides[2], sides[2], 1])
    around = np.arange(-1, 2)
    beside = (around[:, None, None] * steps[0] + around[:, None] * steps[1] + around).ravel()
    near = np.unique((np.unique(b @ steps)[:, None] + beside).ravel())
    return float(np.isin(a @ steps, near).mean())


class ObjectMap:
    """The 3D object map: what is found joins the thing that it is of, or is a thing of its own.

    Attributes:
        objects: by id, from 1, in the order in which they were found; an id is never given twice.
    """

    def __init__(self) -> None:
        self.objects: dict[int, MapObject] = {}
        self._newest = 0
        self._votes: Counter[tuple[str, int, int, int]] = Counter()  # the newest last

    def add(
        self,
        label: str,
        points_m: np.ndarray,
        caption: str = "",
        score: float = 1.0,
        embedding: np.ndarray | None = None,
        picture: int | None = None,
    ) -> MapObject | None:
        """Bring in what one picture shows of a thing.

        Args:
            points_m: (n, 3) float32 in `map`.
            embedding: (d,) of the picture's part.
            picture: its number, such as `Observation.seq`; None: nothing else was in it.

        Returns:
            The thing; None: too few points.
        """
        points = thin(points_m)
        if len(points) < LEAST_POINTS:
            return None
        label = names.canonical(label)
        said = {label: Counter([caption])} if caption else {}
        new = MapObject(
            self._newest + 1, {label: score}, points, said, embedding, score, picture=picture
        )
        likeness = {old.id: _likeness(old, new) for old in self.objects.values()}
        best = max(likeness, key=lambda id: likeness[id], default=0)
        one = self.objects[best] if likeness.get(best) else None
        if one is None:
            self._newest += 1
            one = self.objects[new.id] = new
        else:
            _absorb(one, new)
        for other in self.objects.values():
            if picture is not None and other.picture == picture and other is not one:
                one.apart.add(other.id)
                other.apart.add(one.id)
        return self._united(one)

    def vote(self, label: str, points_m: np.ndarray, by: int) -> None:
        """One picture says that a thing of that label is there (1), or something else (-1)."""
        label = names.canonical(label)
        for voxel in np.unique(_voxels(points_m), axis=0).tolist():
            self._votes[(label, *voxel)] = self._votes.pop((label, *voxel), 0) + by
        for place in list(islice(self._votes, max(0, len(self._votes) - MOST_VOTES))):
            del self._votes[place]

    def doubt(self, thing: MapObject, points_m: np.ndarray) -> None:
        """One picture says that points (n, 3) which it shows beside a thing are not the thing's."""
        held, shown = _voxels(thing.points_m), _voxels(points_m)
        # A picture shows thousands of points, and few of them where the thing is.
        shown = shown[((shown >= held.min(0)) & (shown <= held.max(0))).all(axis=1)]
        for voxel in {*map(tuple, shown.tolist())} & {*map(tuple, held.tolist())}:
            if (thing.label, *voxel) in self._votes:
                self._votes[(thing.label, *voxel)] -= 1

    def agreed_m(self, thing: MapObject) -> np.ndarray:
        """(n, 3) float32, the points of a thing for which `AGREED` more pictures speak than against
        them, or a third of all that there are; all, where that leaves too few."""
        voxels = _voxels(thing.points_m).tolist()
        votes = np.array([self._votes[(thing.label, *voxel)] for voxel in voxels])
        agreed = (votes > 0) & (votes >= min(AGREED, thing.hits / 3))
        enough = agreed.sum() >= LEAST_POINTS
        return thing.points_m[agreed] if enough else thing.points_m

    def _united(self, one: MapObject) -> MapObject:
        """What has grown may touch what was apart from it before; the oldest of them stays."""
        alike = [o for o in self.objects.values() if o is one or _likeness(one, o)]
        first = min(alike, key=lambda thing: thing.id)
        for other in alike:
            if other is not first:
                _absorb(first, other)
                del self.objects[other.id]
        return first


def _voxels(points_m: np.ndarray) -> np.ndarray:
    """(n, 3) int64."""
    return np.floor(points_m / VOXEL_M).astype(np.int64)


def _likeness(a: MapObject, b: MapObject) -> float:
    """The share of points by which two are one thing; 0 where they are not."""
    apart = np.maximum(a.points_m.min(0) - b.points_m.max(0), b.points_m.min(0) - a.points_m.max(0))
    if apart.max() > NEAR_M:
        return 0.0
    shares = share_near(a.points_m, b.points_m), share_near(b.points_m, a.points_m)
    together = b.id in a.apart or (a.picture is not None and a.picture == b.picture)
    if a.label == b.label and not together:
        return max(shares) if max(shares) >= SAME_SHARE else 0.0
    return max(shares) if min(shares) >= ALIKE_SHARE else 0.0


def _absorb(one: MapObject, other: MapObject) -> None:
    hits = one.hits + other.hits
    if one.embedding is None:
        one.embedding = other.embedding
    elif other.embedding is not None:
        one.embedding = (one.hits * one.embedding + other.hits * other.embedding) / hits
    one.points_m = thin(np.concatenate((one.points_m, other.points_m)))
    for label, score in other.labels.items():
        one.labels[label] = one.labels.get(label, 0.0) + score
    for label, said in other.captions.items():
        one.captions.setdefault(label, Counter()).update(said)
    one.score, one.hits = max(one.score, other.score), hits
    one.picture, one.apart = other.picture, one.apart | other.apart
