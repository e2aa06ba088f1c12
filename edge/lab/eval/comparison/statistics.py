"""Computes the figures of a comparison: means, paired differences, failures, lost SPL.

An arm is one of the compared configurations. SR is the success rate. SPL, success weighted by path
length, is the shortest path over the driven one, and 0 for a failure; lost SPL is 1 minus SPL.
Arrays are (A, E): A arms by E episodes.

Every interval is a bootstrap over worlds (`edge.lab.eval.intervals.clusters`), except those of
shares, which are Wilson's: the bootstrap interval of a share of 0 has no width.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.lab.eval.comparison.outcomes import Outcomes, baseline_of, natural_key
from edge.lab.eval.intervals import RESAMPLES, Interval, bootstrap, clusters, wilson
from edge.lab.eval.metrics import episode_soft_spl, episode_spl
from edge.lab.eval.outcome import FAILURES

NAN = Interval(math.nan, math.nan, math.nan)


class ComparisonMetric(NamedTuple):
    """A metric that a comparison reports for each arm.

    Attributes:
        title: head of its column in a table.
        digits: number of decimals.
        values: returns (A, E) float64 of outcomes, NaN if an episode does not count; None: the
            number of `NUMBERS` with the metric's key, as it is.
        scale: factor for display.
        how: "mean"; "share" of yes and no; or "median", without an interval, for times, which have
            outliers on a busy computer.
    """

    title: str
    digits: int
    words: str
    values: Callable[[Outcomes], np.ndarray] | None = None
    scale: float = 1.0
    how: str = "mean"


def _in_successes(name: str) -> Callable[[Outcomes], np.ndarray]:
    """Return a function that reads a number of successful episodes; NaN for the others."""
    return lambda outcomes: np.where(outcomes.success, outcomes[name], np.nan)


def spl_of(outcomes: Outcomes) -> np.ndarray:
    """Return (A, E) SPL of each episode, NaN without an outcome."""
    each = episode_spl(outcomes.success, outcomes["shortest_m"], outcomes["path_m"])
    return np.where(outcomes.ran, each, np.nan)


def _soft_spl(outcomes: Outcomes) -> np.ndarray:
    """Return (A, E) soft SPL of each episode.

    It is NaN for a mission with several targets. A crash, or an end without a path to the target,
    counts as no progress.
    """
    unknown = np.isnan(outcomes["left_m"]) & outcomes.ran & (outcomes.target != "")
    left_m = np.where(unknown, np.inf, outcomes["left_m"])
    return episode_soft_spl(outcomes.success, outcomes["shortest_m"], outcomes["path_m"], left_m)


def _above_0(name: str) -> Callable[[Outcomes], np.ndarray]:
    """Return a function that gives 1.0 if a number is above 0, else 0.0; NaN without a number."""
    return lambda outcomes: np.where(np.isnan(outcomes[name]), np.nan, outcomes[name] > 0)


def _was_seen(outcomes: Outcomes) -> np.ndarray:
    """Return (A, E) 1.0 if the target was seen, else 0.0; NaN for a mission."""
    known = outcomes.ran & (outcomes.target != "")
    return np.where(known, ~np.isnan(outcomes["first_sight_s"]), np.nan)


METRICS: dict[str, ComparisonMetric] = {
    "sr": ComparisonMetric(
        "SR, %", 1, "episodes that succeeded", lambda outcomes: outcomes["success"], 100.0, "share"
    ),
    "spl": ComparisonMetric("SPL", 3, "success weighted by path length", spl_of),
    "soft_spl": ComparisonMetric("soft SPL", 3, "progress in place of success", _soft_spl),
    "path_m": ComparisonMetric("path, m", 1, "driven, all episodes"),
    "success_path_m": ComparisonMetric(
        "in success", 1, "driven, successes", _in_successes("path_m")
    ),
    "elapsed_s": ComparisonMetric("time, s", 1, "simulated, all episodes"),
    "collisions": ComparisonMetric("collisions", 2, "per episode"),
    "seen": ComparisonMetric("seen, %", 1, "target seen at all", _was_seen, 100.0, "share"),
    "first_sight_s": ComparisonMetric("first sight, s", 1, "if it was seen"),
    "wrong_stops": ComparisonMetric(
        "wrong stops, %", 1, "episodes", _above_0("wrong_stops"), 100.0, "share"
    ),
    "false_confirmations": ComparisonMetric(
        "false conf.", 2, "confirmed objects that are not the target, per episode"
    ),
    "zone_entries": ComparisonMetric(
        "zone entries", 3, "of the footprint into keep-out zones, per episode"
    ),
    "person_contacts": ComparisonMetric(
        "person contacts", 3, "collisions with people, the robot's fault, per episode"
    ),
    "ghost_s": ComparisonMetric(
        "ghosts, s", 2, "longest time that a cell stays occupied in view after a person left it, "
        "mean of the episodes"
    ),
    "answers_right": ComparisonMetric(
        "answers, %", 1, "right answers to \"where is …?\", mean of the worlds", scale=100.0
    ),
    "tick_p95_ms": ComparisonMetric(
        "tick p95, ms", 2, "per episode, the median of all", how="median"
    ),
    "score_p95_ms": ComparisonMetric(
        "score p95, ms", 2, "likewise, the stage `score` alone", how="median"
    ),
}  # fmt: skip


def _values(key: str, outcomes: Outcomes) -> np.ndarray:
    """Return the values of a metric, (A, E) float64, NaN if an episode does not count."""
    read = METRICS[key].values
    return outcomes[key] if read is None else read(outcomes)


class Estimate(NamedTuple):
    """A metric's value for an arm; `n` is the number of episodes that count."""

    n: int
    interval: Interval


class PairedDifference(NamedTuple):
    """An arm against the baseline, on the episodes that both ran.

    Attributes:
        n: number of these episodes.
        missing: number of episodes that only one of the two ran; they are left out.
        sr: mean difference of success, arm minus baseline.
        spl_ratio: mean SPL of the arm over that of the baseline.
        both: number of episodes in which both succeeded.
        path_ratio: sum of paths of the arm over that of the baseline, of `both`.
        time_ratio: sum of times of the arm over that of the baseline, of `both`.
        won: number of episodes with higher SPL than the baseline.
        lost: number of episodes with lower SPL.
    """

    arm: str
    n: int
    missing: int
    sr: Interval
    spl: Interval
    soft_spl: Interval
    spl_ratio: Interval
    both: int
    path_ratio: Interval
    time_ratio: Interval
    won: int
    lost: int


class SplLoss(NamedTuple):
    """Decomposition of an arm's lost SPL: 1 = spl + failures + search + approach, on `n` episodes.

    Attributes:
        failures: share of failed episodes.
        search: lost because the path until the target was first seen was not the shortest.
        approach: lost because the path from there was not the shortest.
        search_m: mean excess path of the search, over the successes.
        approach_m: mean excess path of the approach, over the successes.
    """

    n: int
    spl: float
    failures: float
    search: float
    approach: float
    search_m: Interval
    approach_m: Interval


@dataclass(frozen=True)
class Comparison:
    """All figures of a set of outcomes.

    Attributes:
        baseline: index of the arm that the others are compared with.
        unit: the resampled unit, "world" or "episode".
        figures: by arm, by metric.
        pairs: of every arm but the baseline.
        groups: by criterion (target, kind of world, ways), by group, by arm: SR and SPL. A
            criterion with only one group is left out.
        failures: by arm, by kind of failure, the number of episodes.
        losses: by arm; empty if the distances at first sight are unknown.
    """

    outcomes: Outcomes
    baseline: int
    unit: str
    figures: dict[str, dict[str, Estimate]]
    pairs: tuple[PairedDifference, ...]
    groups: dict[str, dict[str, dict[str, dict[str, Estimate]]]]
    failures: dict[str, dict[str, int]]
    losses: dict[str, SplLoss]


def compare(
    outcomes: Outcomes,
    baseline: str | None = None,
    left_m: np.ndarray | None = None,
    resamples: int = RESAMPLES,
) -> Comparison:
    """Compute all figures. The same outcomes always give the same figures.

    The baseline is the first arm if none is named. `left_m` is (A, E): metres left to drive when
    the target was first seen, NaN if unknown or never (`worlds.fill_left_at_sight_m`).
    `outcomes["left_m"]` are those left at the end.
    """
    base = baseline_of(outcomes, baseline)
    cluster, by_world = clusters(outcomes.world)
    others = [a for a in range(len(outcomes.arms)) if a != base]
    return Comparison(
        outcomes,
        base,
        "world" if by_world else "episode",
        _figures(outcomes, cluster, resamples),
        tuple(pair(outcomes, a, base, resamples) for a in others),
        _groups(outcomes, resamples),
        {name: _failures(outcomes, a) for a, name in enumerate(outcomes.arms)},
        {} if left_m is None else _losses(outcomes, left_m, cluster, resamples),
    )


def _figures(
    outcomes: Outcomes, cluster: np.ndarray, resamples: int
) -> dict[str, dict[str, Estimate]]:
    """Return all metrics, by arm, by metric."""
    values = {key: _values(key, outcomes) for key in METRICS}
    means = [key for key in METRICS if METRICS[key].how == "mean"]
    intervals = arm_means([values[key] for key in means], cluster, resamples)
    figures: dict[str, dict[str, Estimate]] = {name: {} for name in outcomes.arms}
    for a, name in enumerate(outcomes.arms):
        for key in METRICS:
            counted = values[key][a][~np.isnan(values[key][a])]
            if METRICS[key].how == "median":
                interval = (
                    Interval(float(np.median(counted)), math.nan, math.nan) if len(counted) else NAN
                )
            elif METRICS[key].how == "share":
                interval = wilson(int(counted.sum()), len(counted))
            else:
                interval = intervals[means.index(key)][a]
            figures[name][key] = Estimate(len(counted), interval)
    return figures


def arm_means(
    values: Sequence[np.ndarray], cluster: np.ndarray, resamples: int = RESAMPLES
) -> list[list[Interval]]:
    """Return means of (A, E) arrays over the entries that are not NaN: by array, by arm."""
    if not values:
        return []
    stacked = np.concatenate(values)
    counted = ~np.isnan(stacked)
    # A row of the result is one arm of one array.
    flat = bootstrap(np.where(counted, stacked, 0.0), counted.astype(float), cluster, resamples)
    n_arms = len(values[0])
    return [flat[k * n_arms : (k + 1) * n_arms] for k in range(len(values))]


def pair(
    outcomes: Outcomes, arm: int, baseline: int, resamples: int = RESAMPLES
) -> PairedDifference:
    """Compare an arm with the baseline on the same episodes: their difficulty cancels out."""
    both_ran = outcomes.ran[arm] & outcomes.ran[baseline]
    missing = int((outcomes.ran[arm] ^ outcomes.ran[baseline]).sum())
    cluster = clusters(outcomes.world)[0][both_ran]
    rows = np.array([arm, baseline])

    def on_same_episodes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values of the arm and of the baseline, on the episodes that both ran."""
        return tuple(values[rows][:, both_ran])  # type: ignore[return-value]

    ones = np.ones(int(both_ran.sum()))
    spl, base_spl = on_same_episodes(spl_of(outcomes))
    success, base_success = on_same_episodes(outcomes.success.astype(float))
    soft, base_soft = on_same_episodes(_soft_spl(outcomes))
    soft_known = ~np.isnan(soft) & ~np.isnan(base_soft)
    path, base_path = on_same_episodes(outcomes["path_m"])
    time, base_time = on_same_episodes(outcomes["elapsed_s"])
    both = (success * base_success).astype(bool)  # both succeeded
    # Each figure is the sum of its numerators over the sum of its denominators.
    numerators = (
        success - base_success, spl - base_spl, np.where(soft_known, soft - base_soft, 0.0), spl,
        np.where(both, path, 0.0), np.where(both, time, 0.0),
    )  # fmt: skip
    denominators = (
        ones, ones, soft_known.astype(float), base_spl,
        np.where(both, base_path, 0.0), np.where(both, base_time, 0.0),
    )  # fmt: skip
    sr, spl_difference, soft_difference, spl_ratio, path_ratio, time_ratio = bootstrap(
        np.stack(numerators), np.stack(denominators), cluster, resamples
    )
    return PairedDifference(
        outcomes.arms[arm], len(ones), missing, sr, spl_difference, soft_difference, spl_ratio,
        int(both.sum()), path_ratio, time_ratio,
        int((spl > base_spl + 1e-9).sum()), int((spl < base_spl - 1e-9).sum()),
    )  # fmt: skip


def _groups(
    outcomes: Outcomes, resamples: int
) -> dict[str, dict[str, dict[str, dict[str, Estimate]]]]:
    """Return SR and SPL by criterion, by group, by arm, by metric."""
    by = {
        "target": outcomes.target,
        "kind of world": outcomes.kind,
        "ways around the zone": outcomes.ways,
    }
    all_groups: dict[str, dict[str, dict[str, dict[str, Estimate]]]] = {}
    for name, labels in by.items():
        present = sorted({label for label in labels.tolist() if label}, key=natural_key)
        if len(present) > 1:
            all_groups[name] = {
                label: _group(outcomes, labels == label, resamples) for label in present
            }
    return all_groups


def _group(
    outcomes: Outcomes, inside: np.ndarray, resamples: int
) -> dict[str, dict[str, Estimate]]:
    """Return SR and SPL of the episodes inside a group, (E,) bool, by arm."""
    cluster, _ = clusters(outcomes.world)
    values = {key: np.where(inside, _values(key, outcomes), np.nan) for key in ("sr", "spl")}
    intervals = arm_means([values["spl"][:, inside]], cluster[inside], resamples)[0]
    groups = {}
    for a, name in enumerate(outcomes.arms):
        n = int(outcomes.ran[a, inside].sum())
        share = wilson(int(np.nansum(values["sr"][a])), n)
        groups[name] = {"sr": Estimate(n, share), "spl": Estimate(n, intervals[a])}
    return groups


def _failures(outcomes: Outcomes, arm: int) -> dict[str, int]:
    """Count an arm's failed episodes by kind of failure."""
    kinds = outcomes.failure[arm]
    return {kind: int((kinds == kind).sum()) for kind in FAILURES}


def _losses(
    outcomes: Outcomes, left_m: np.ndarray, cluster: np.ndarray, resamples: int
) -> dict[str, SplLoss]:
    """Return the decomposition of the lost SPL, by arm."""
    search, approach = excess_m(outcomes, left_m)  # metres
    spl, path_m = spl_of(outcomes), outcomes["path_m"]
    counted = outcomes.ran & (outcomes.target != "")
    metres = arm_means([search, approach], cluster, resamples)
    losses = {}
    for a, name in enumerate(outcomes.arms):
        kept, n = counted[a], int(counted[a].sum())
        if not n:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            lost = [np.nansum((part[a] / path_m[a])[kept]) / n for part in (search, approach)]
        failed = float((~outcomes.success[a])[kept].mean())
        found = float(np.nansum(spl[a][kept]) / n)
        losses[name] = SplLoss(n, found, failed, *map(float, lost), metres[0][a], metres[1][a])
    return losses


def excess_m(outcomes: Outcomes, left_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far a success drove beyond the shortest path: before and after first sight.

    `left_m` are the metres left at first sight; see `compare`.

    The search's excess is the path until first sight, plus the distance that was left then, minus
    the shortest path from the start. The approach's excess is the rest. If a success never saw its
    target (by ground truth), all is the search's.

    Returns:
        search and approach, (A, E) float64 each, at least 0, NaN for a failure or a mission with
        several targets. Their sum is the path minus the shortest path. If that is negative, because
        the shortest path is measured on cells, it is 0.
    """
    counted = outcomes.success & (outcomes.target != "")
    over = np.maximum(outcomes["path_m"] - outcomes["shortest_m"], 0.0)
    until = outcomes["first_sight_path_m"] + left_m - outcomes["shortest_m"]
    search = np.where(np.isnan(until), over, np.clip(until, 0.0, over))
    return np.where(counted, search, np.nan), np.where(counted, over - search, np.nan)
