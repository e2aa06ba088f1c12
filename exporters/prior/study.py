"""What the prior is worth to a searcher, in houses that it was not learned from.

python -m exporters.prior.study HOUSES.jsonl.gz

Learns from three quarters of the houses and searches the others. On the plan of
`exporters.prior.explorer`: √area/(path + 1 m) × lift^w, a look around at the start and every 2 m,
always the same episodes; starts at least 4 m of path away from the target.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edge.perception.prior import cooccurrence, rooms
from edge.perception.prior.table import Table, parse
from exporters.files import tells_errors
from exporters.prior import learn
from exporters.prior.__main__ import counted, learned, read
from exporters.prior.explorer import Explorer, paths_m
from exporters.prior.house import CELL_M, Plan
from exporters.prior.samples import Views, gather, standing

LEAST_M, MOST_M, _STEP_M = 4.0, 60.0, 1.0
_STOP_M = 1.0
"""How near to a thing's side the search ends."""
LEAST, MOST = 0.25, 4.0
"""As `edge.loop.prior` clips the lift."""
TARGETS = (
    "bed", "chair", "houseplant", "sofa", "television", "toilet", "refrigerator", "dining table",
    "chest of drawers", "armchair", "desk", "sink", "shelf", "tv stand", "trash can", "side table",
)  # fmt: skip


def lift(table: Table, by: str, target: int, views: Views) -> np.ndarray:
    """As `edge.loop.prior.Prior.lift`, of a searcher's frontiers."""
    out = np.ones(len(views.near), np.float32)
    if by != "rooms":
        cooccurrence.lift(table, target, views.near.astype(np.float32), out)
    if by != "cooccurrence":
        chance, prior = rooms.chances(table), rooms.average(table)
        held, beside = (part.astype(np.float32) for part in (views.held, views.beside))
        kind = rooms.at_places(table, chance, held, beside)
        out *= rooms.lift(chance, prior, target, kind) ** table.room_power[by == "both"]
    return np.clip(out, LEAST, MOST)


def search(
    plan: Plan,
    start: tuple[int, int],
    target: int,
    table: Table | None,
    by: str,
    power: float,
    seed: tuple[int, ...],
) -> float:
    """Metres driven until the target, or another like it, is reached; inf beyond `MOST_M`.

    Args:
        target: index into `plan.words`.
        table: None: without a prior.
    """
    explorer = Explorer(plan, start, np.random.default_rng(seed))
    things = table.things if table is not None else ()
    row_of = {name: i for i, name in enumerate(things)}
    row = np.array([row_of.get(plan.words[w], -1) for w in plan.word], np.int64)
    wanted = plan.word == target
    while explorer.driven_m < MOST_M:
        if (explorer.seen & wanted).any():
            return explorer.driven_m + _rest_m(explorer, wanted)
        frontiers = explorer.frontiers()
        if not len(frontiers.cell):
            return np.inf
        worth = np.sqrt(frontiers.area_m2) / (frontiers.path_m + 1.0)
        if table is not None:
            views = Views(explorer, frontiers, row, len(things))
            worth = worth * lift(table, by, row_of.get(plan.words[target], -1), views) ** power
        explorer.drive(frontiers.cell[worth.argmax()], _STEP_M)
    return np.inf


def _rest_m(explorer: Explorer, wanted: np.ndarray) -> float:
    """From where the robot is to the nearest of the things it has seen and wanted."""
    there = paths_m(explorer.plan, explorer._cell)
    return min(reach_m(explorer.plan, there, i) for i in np.flatnonzero(explorer.seen & wanted))


def reach_m(plan: Plan, path_m: np.ndarray, thing: int) -> float:
    """The shortest of some paths that ends beside a thing."""
    h, w = path_m.shape
    x, y = (plan.xy_m[thing] - plan.origin_xy_m) / CELL_M
    rows, cols = np.ogrid[:h, :w]
    beside = np.hypot(rows + 0.5 - y, cols + 0.5 - x) * CELL_M
    return float(path_m[beside <= plan.half_m[thing] + _STOP_M].min(initial=np.inf))


def episodes(
    plans: Sequence[Plan], each: int, seed: int = 1
) -> Iterator[tuple[int, tuple[int, int], int, float]]:
    """House, start, target (index into the plan's words) and the shortest way."""
    for number, plan in enumerate(plans):
        random = np.random.default_rng((seed, number))
        starts = standing(plan)
        there = [plan.words.index(name) for name in TARGETS if name in plan.words]
        random.shuffle(there)
        for target in there[:each]:
            for _ in range(5):
                y, x = starts[random.integers(len(starts))].tolist()
                path = paths_m(plan, (y, x))
                things = np.flatnonzero(plan.word == target)
                shortest = min(reach_m(plan, path, i) for i in things)
                if LEAST_M <= shortest < np.inf:
                    yield number, (y, x), target, shortest
                    break


def learned_without(
    houses: Sequence[dict[str, Any]], plans: Sequence[Plan], fold: int
) -> tuple[Table, list[int]]:
    """A table from all houses but those of a fold, and these."""
    held_out = learn.folds(len(plans)) == fold
    others = np.flatnonzero(~held_out)
    data = counted([houses[i] for i in others], some := [plans[i] for i in others])
    samples = gather(some, data["things"], data["kinds"]["names"])
    return parse(learned(data, samples)[0]), np.flatnonzero(held_out).tolist()


def ratio(house: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Mean of a over mean of b, with its interval by a bootstrap of houses."""
    sums = np.stack([np.bincount(house, v, house.max() + 1) for v in (a, b)])
    draws = np.random.default_rng(0).integers(house.max() + 1, size=(2000, house.max() + 1))
    drawn = np.maximum(sums[:, draws].sum(2), 1e-9)
    low, high = np.quantile(drawn[0] / drawn[1], (0.025, 0.975))
    return float(a.sum() / b.sum()), float(low), float(high)


@tells_errors
def main(argv: list[str] | None) -> None:
    """Search with and without the prior."""
    parser = argparse.ArgumentParser(
        prog="python -m exporters.prior.study", description=main.__doc__
    )
    parser.add_argument("file", type=Path, help="houses, .jsonl or .jsonl.gz")
    parser.add_argument("--folds", type=int, default=1, choices=range(1, learn.FOLDS + 1),
                        help="how many quarters of the houses are held out, in turn")  # fmt: skip
    parser.add_argument("--each", type=int, default=8, help="targets a house")
    parser.add_argument("--powers", type=float, nargs="+", default=[0.5, 1.0])
    args = parser.parse_args(argv)
    houses, plans = read(args.file)
    ways = [("none", 0.0)] + [
        (by, p) for by in ("cooccurrence", "rooms", "both") for p in args.powers
    ]
    spl: list[list[float]] = []
    names: list[str] = []
    for fold in range(args.folds):
        table, held_out = learned_without(houses, plans, fold)
        for i, start, target, shortest in episodes([plans[i] for i in held_out], args.each, fold):
            number = held_out[i]
            driven = [
                search(plans[number], start, target, table if p else None, by, p, (number, target))
                for by, p in ways
            ]
            spl.append([number, *(shortest / max(d, shortest) for d in driven)])
            names.append(plans[number].words[target])
    tell(np.array(spl), np.array(names), ways)


def tell(rows: np.ndarray, names: np.ndarray, ways: Sequence[tuple[str, float]]) -> None:
    """Print each way against the first, and the last by target.

    Args:
        rows: (n, 1 + ways), house and SPL of each episode.
        names: (n,) of the targets.
    """
    house, plain = rows[:, 0].astype(int), rows[:, 1]
    print(f"{len(rows)} episodes")
    for (by, power), spl in zip(ways, rows[:, 1:].T, strict=True):
        value, low, high = ratio(house, spl, plain)
        print(f"{by:13} w {power:3.1f}  SPL {spl.mean():.3f}  to none {value:.3f} "
              f"({low:.3f}–{high:.3f})  worse by over 0.1: {(spl < plain - 0.1).mean():.1%}, "
              f"better: {(spl > plain + 0.1).mean():.1%}")  # fmt: skip
    print(f"{ways[-1][0]}, w {ways[-1][1]}, by target:")
    for name in np.unique(names):
        at = names == name
        value, low, high = ratio(house[at], rows[at, -1], plain[at])
        print(f"  {name:18} {at.sum():4}  SPL {rows[at, -1].mean():.3f}  to none {value:.3f} "
              f"({low:.3f}–{high:.3f})")  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
