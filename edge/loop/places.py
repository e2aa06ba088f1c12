"""What a service keeps of places across a restart, and how it takes it up again.

All that is bound to `map`, of one tick: what each part gives as plain arrays (its `kept`), by the
name `part/array`, and the map's tiles. `TABLE` says what there is; what a file holds is checked by
it before anyone reads it.

What is not kept follows from what is, or passes within seconds: inflation, bit planes and frontier
cells follow from the cells; the reach field, rooms (`prior`) and driving distances (`surveyor`)
from the map, within some ticks; the scorers are asked again; what the controller said, a view that
was being looked at, and who stood in the way are of the moment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import astuple
from functools import partial
from typing import NamedTuple

import numpy as np

from edge import names
from edge.config import Config
from edge.geometry import FARTHEST_M, SE2, wrap_angle
from edge.loop.goal import GoalTracker
from edge.loop.semantic_map import Kept, SemanticMap
from edge.mapping import clusters, gain
from edge.mapping.grid import RollingMap
from edge.perception.tracking.instances import MAX_POINTS
from edge.perception.tracking.sighting_kernels import POINTS
from edge.policies.base import Policy, Remembers

WORD = "U"
"""As a type: words."""
POLICY = "policy/"
"""Under it is whatever the policy remembers, in arrays of numbers."""
_FAR = 1 << 61
_HASTE = 1.5  # robots are faster than they say
_MAX_TURN_RAD = 1.0  # what a pose may be turned at once
_DRIVES_ON_S = 10.0
_SCALES = ("resolution_m", "obstacle_max_m")  # of `mapping`: what a cell's numbers mean


class Column(NamedTuple):
    """What an array has to be: `shape` counts by number, or by a letter that all arrays of a part
    share and that is at most `MOST` of it; numbers lie from `low` to `high`, None: any."""

    dtype: str
    shape: tuple[int | str, ...] = ()
    low: float | None = -_FAR
    high: float = _FAR


def _of(part: str, **columns: Column) -> dict[str, Column]:
    return {f"{part}/{name}": column for name, column in columns.items()}


MOST = {
    "one": 1, "missed": 1, "t": 64, "cluster": clusters.MAX_CLUSTERS, "member": 64 * 4096,
    "free": 8192, "bump": 128, "cell": 1 << 16, "closed": 1 << 16, "word": 1 << 15,
    "sighting": 4096, "instance": 8192, "point": 8192 * MAX_POINTS, "candidate": 1 << 14,
    "left": 64, "tile": 4096,
}  # fmt: skip
_STAMP, _COUNT, _FLAG = Column("i8"), Column("i8", (), 0), Column("b1", (), None)
_FLAGS = Column("b1", ("bump",), None)


def _at(*shape: int | str, dtype: str = "f8") -> Column:
    return Column(dtype, shape, -FARTHEST_M, FARTHEST_M)


TABLE: dict[str, Column] = {
    **_of(
        "about",
        boot=Column(WORD, (1,)), policy=Column(WORD, (1,)), target=Column(WORD, (1,)),
        targets=Column(WORD, ("t",)), pose=_at(3), stamp_ns=_STAMP, now_ns=_STAMP,
        resolution_m=_at(), obstacle_max_m=_at(),
    ),
    **_of(
        "values",
        source=Column(WORD, (1,)), targets=Column(WORD, ("t",)), side=Column("i8", (), 1, 64),
    ),
    **_of(
        "tile", xy=Column("i4", ("tile", 2), -(1 << 26), 1 << 26),
        bytes=Column("i4", ("tile",), 1, 1 << 24),
    ),
    **_of(
        "map",
        origin=Column("i8", (2,), -(1 << 32), 1 << 32), cells=Column("i8", (), 64, 1 << 16),
        floor_m=Column("f8", (2,), None), robot=Column("i8", ("one", 2), -(1 << 32), 1 << 32),
        cluster_id=Column("i4", ("cluster",), 1, clusters.MAX_CLUSTERS - 1),
        cluster_size=Column("i4", ("cluster",)), cluster_samples=Column("i4", ("cluster",)),
        cluster_sample=Column("i4", ("cluster", clusters.MAX_SAMPLES)),
        cluster_cell=Column("i4", ("member",)), cluster_free=Column("i4", ("free",)),
    ),
    **_of(
        "gain",
        at_m=Column("f8", (gain.PLACES, 2), None), looked=Column("u8", (gain.PLACES,), None),
        next=Column("i8", (), 0, gain.PLACES - 1),
    ),
    **_of(
        "bumps",
        place_m=_at("bump", 2), heading_rad=_at("bump"), half_m=_at("bump"),
        until_ns=Column("i8", ("bump",)), opened=_FLAGS, again=_FLAGS,
        cell=Column("i8", ("cell", 4), -(1 << 32), 1 << 32),
        closed=Column("i8", ("closed", 4), -(1 << 32), 1 << 32),
    ),
    **_of(
        "sightings",
        words=Column(WORD, ("word",)), next_id=_COUNT, xyz_m=_at("sighting", 3, dtype="f4"),
        word=Column("i2", ("sighting",), 0), confidence=Column("f4", ("sighting",), 0, 2),
        last_seen_ns=Column("i8", ("sighting",)), id=Column("i8", ("sighting",), 0),
        hits=Column("i4", ("sighting",), 0), near_hits=Column("i4", ("sighting",), 0),
        points_m=_at("sighting", POINTS, 3, dtype="f4"),
        n_points=Column("i4", ("sighting",), 0, POINTS),
        weight=Column("f4", ("sighting",), 0), total=Column("f4", ("sighting",), 0),
        cursor=Column("i4", ("sighting",), 0, POINTS - 1), told=_at("sighting", 4, dtype="f4"),
    ),
    **_of(
        "instances",
        label=Column(WORD, ("instance",)), next_id=_COUNT, id=Column("i8", ("instance",), 0),
        score=Column("f8", ("instance",), 0, 2), hits=Column("i8", ("instance",), 0),
        first_seen_ns=Column("i8", ("instance",)), last_seen_ns=Column("i8", ("instance",)),
        state=Column("i1", ("instance",), 0, 3), evidence_ns=Column("i8", ("instance",)),
        good_hits=Column("i8", ("instance",), 0), views=Column("f8", ("instance",), 0),
        good_ns=Column("i8", ("instance",)), target_sum=Column("f8", ("instance",), 0),
        rival_sum=Column("f8", ("instance",), 0), doubted=Column("b1", ("instance",), None),
        n_points=Column("i4", ("instance",), 1, MAX_POINTS),
        points_m=_at("point", 3, dtype="f4"), support=Column("i4", ("point",), 0),
    ),
    **_of(
        "candidates",
        xy_m=_at("candidate", 2, dtype="f4"), anchor_m=_at("candidate", 2, dtype="f4"),
        id=Column("i8", ("candidate",), 0), first_seen_ns=Column("i8", ("candidate",)),
        gain_m2=_at("candidate", dtype="f4"), next_id=_COUNT,
        measure_next=Column("i8", (), 0, 1 << 16), look_id=Column("i8", ("one",), 0),
        look_rad=_at("one"), discarded_xy_m=_at("left", 2, dtype="f4"),
        discarded_kind=Column("i1", ("left",), 0, 2), discarded_id=Column("i8", ("left",), 0),
        discarded_until_ns=Column("i8", ("left",)),
    ),
    **_of(
        "goals",
        exhausted=_FLAG, second_chance=_FLAG, turns=Column("i8", (), 0, 1000),
        left_m=_at("left", 2), missed=_at("missed", 3), kind=Column("i1", ("one",), 0, 2),
        id=Column("i8", ("one",), 0), at=_at("one", 7),
    ),
}  # fmt: skip


class Parts(NamedTuple):
    """Those parts of a service that know places."""

    map: SemanticMap
    goals: GoalTracker
    policy: Policy


class Now(NamedTuple):
    """Where and when: `pose` at `stamp_ns` of the sensors' clock, `now_ns` of the loop's."""

    pose: SE2
    stamp_ns: int
    now_ns: int


def gather(parts: Parts, now: Now, boot: str, targets: tuple[str, ...], target: str) -> Kept:
    """All but the tiles, as it stands.

    Args:
        boot: see `edge.host.machine.boot_id`.
        targets: of the mission; `target` is the active one.
    """
    config = parts.map.config
    given = {
        "about": {
            "boot": np.array([boot]), "policy": np.array([config.policy.kind]),
            "targets": np.array(targets, np.str_), "target": np.array([target]),
            "pose": np.array(astuple(now.pose)), "stamp_ns": np.array(now.stamp_ns),
            "now_ns": np.array(now.now_ns),
            **{name: np.array(getattr(config.mapping, name)) for name in _SCALES},
        },
        **parts.map.kept(),
        "goals": parts.goals.kept(),
        "policy": parts.policy.kept() if _remembers(parts.policy) else {},
    }  # fmt: skip
    return {f"{part}/{name}": a for part, arrays in given.items() for name, a in arrays.items()}


def part_of(kept: Kept, part: str) -> Kept:
    """The arrays of one part, by their own names."""
    return {name[len(part) + 1 :]: a for name, a in kept.items() if name.startswith(f"{part}/")}


def check(kept: Kept) -> None:
    """See that all arrays of `TABLE` are there, and are what it says and what they say of others.

    Raises:
        ValueError: one line: which is not.
    """
    counts: dict[tuple[str, str], int] = {}
    for name, column in TABLE.items():
        if name not in kept:
            raise ValueError(f"{name} is missing")
        _check_column(name, column, kept[name], counts)
    for name in kept.keys() - TABLE.keys():
        if not name.startswith(POLICY) or kept[name].dtype.kind == WORD:
            raise ValueError(f"{name!r:.60} is not known")
    words, labels = kept["sightings/words"], kept["instances/label"]
    for name in (*words.tolist(), *labels.tolist()):
        names.normalise(name)
    ids, n_points = kept["instances/id"], kept["instances/n_points"]
    bump, raw_top = kept["bumps/cell"], kept["bumps/closed"][:, 2:]
    for what, fits in (
        ("sightings/word", (kept["sightings/word"] < len(words)).all()),
        ("sightings/words", len(set(words.tolist())) == len(words)),
        ("instances/id", len(np.unique(ids)) == len(ids)),
        ("instances/n_points", n_points.sum() == len(kept["instances/points_m"])),
        ("bumps/cell", ((bump[:, 0] >= 0) & (bump[:, 0] < len(kept["bumps/opened"]))).all()),
        ("bumps/cell", ((bump[:, 3] >= 0) & (bump[:, 3] <= 1)).all()),
        ("bumps/closed", ((raw_top >= 0) & (raw_top <= 255)).all()),
    ):
        if not fits:
            raise ValueError(f"{what} does not fit")


def _check_column(
    name: str, column: Column, array: np.ndarray, counts: dict[tuple[str, str], int]
) -> None:
    part = name.partition("/")[0]
    expected = [
        size if isinstance(size, int) else counts.setdefault((part, size), found)
        for size, found in zip(column.shape, array.shape, strict=False)
    ]
    within = all(
        found <= MOST[size]
        for size, found in zip(column.shape, array.shape, strict=False)
        if isinstance(size, str)
    )
    kind = array.dtype.kind if column.dtype == WORD else array.dtype.str[1:]
    if kind != column.dtype or array.ndim != len(column.shape) or not within:
        raise ValueError(f"{name} is no {column.dtype} of {column.shape}")
    if list(array.shape) != expected:
        raise ValueError(f"{name} has {array.shape} entries, not {tuple(expected)}")
    if column.dtype == WORD or column.low is None or array.size == 0:
        return
    if not (array.min() >= column.low and array.max() <= column.high):  # NaN fails it too
        raise ValueError(f"{name} is not from {column.low:g} to {column.high:g}")


def make_map(
    kept: Kept, tiles_of: Callable[[int], Iterator[tuple[tuple[int, int], bytes]]], config: Config
) -> RollingMap:
    """The map again, but for what has a clock; fast, yet not for a tick.

    Args:
        tiles_of: world tiles, each unpacked to so many bytes.

    Raises:
        ValueError: it is of another resolution or scale of heights, or none at all.
    """
    mapping = config.mapping
    for name in _SCALES:
        was, now = float(kept[f"about/{name}"]), getattr(mapping, name)
        if was != now:
            raise ValueError(f"made with mapping.{name} {was:g}, which now is {now:g}")
    grid = RollingMap(mapping, config.robot)
    side, targets = int(kept["values/side"]), kept["values/targets"].tolist()
    source = str(kept["values/source"][0])
    same = source == (config.value_source or "") and side == grid.values.side
    if same and targets:
        grid.values.begin(targets)
    size = grid.tile_bytes + 4 * side * side * len(targets)
    grid.restore(part_of(kept, "map"), tiles_of(size), same)
    grid.gain.restore(part_of(kept, "gain"))
    return grid


def restore(parts: Parts, grid: RollingMap, kept: Kept, now: Now, goes_on: bool) -> None:
    """Have the parts go on with what was gathered.

    What was to last until some time lasts as long as it would have; where a clock was set back, as
    long as it had yet to last.

    Args:
        grid: of `make_map`.
        goes_on: whether the mission does, and with it what was tried, and what the policy
            remembers where it is of the same kind.

    Raises:
        ValueError: the policy takes this for no memory of its own; all else has been restored.
    """
    later_ns = min(now.now_ns - int(kept["about/now_ns"]), 0)
    later_stamp_ns = min(now.stamp_ns - int(kept["about/stamp_ns"]), 0)
    parts.map.take_up(grid, partial(part_of, kept), later_ns, later_stamp_ns)
    if not goes_on:
        return
    parts.goals.restore(part_of(kept, "goals"), str(kept["about/target"][0]), now.now_ns)
    memory, kind = part_of(kept, "policy"), parts.map.config.policy.kind
    if memory and _remembers(parts.policy) and kept["about/policy"][0] == kind:
        try:
            parts.policy.restore(memory)
        except (KeyError, TypeError) as error:
            raise ValueError(str(error)) from None


def _remembers(policy: Policy | Remembers) -> bool:
    return hasattr(policy, "kept") and hasattr(policy, "restore")


def why_elsewhere(kept: Kept, now: Now, boot: str, config: Config) -> str:
    """Why `map` is not believed to be the frame that places were kept in; "" where it is.

    A pose of `source.localised` is always in the same frame. Odometry is, where it went on: the
    computer was not started anew meanwhile, and the robot stands where it was, or as far from there
    as it may have driven: without a service it ends its last goal and goes no farther, so only the
    first seconds count. What began anew at the very place and heading is not told from that.
    """
    if config.source.localised:
        return ""
    passed_s = (now.stamp_ns - int(kept["about/stamp_ns"])) * 1e-9
    if kept["about/boot"][0] != boot:
        return "the computer was started anew, and its odometry with it"
    if passed_s < 0.0:
        return "the sensors' clock began anew"
    x_m, y_m, yaw_rad = kept["about/pose"].tolist()
    driving_s, robot = _HASTE * min(passed_s, _DRIVES_ON_S), config.robot
    moved_m = now.pose.distance_to(x_m, y_m)
    turned_rad = abs(wrap_angle(now.pose.yaw_rad - yaw_rad))
    if moved_m > config.source.max_pose_jump_m + robot.max_speed_mps * driving_s:
        return f"the robot is {moved_m:.1f} m from where it was"
    if turned_rad > _MAX_TURN_RAD + robot.max_turn_radps * driving_s:
        return f"the robot is turned by {turned_rad:.1f} rad from how it stood"
    return ""
