"""Report of `edge eval planning`: figures of the planners with intervals, as a table and as JSON.

- complete: share of runs that end in an accepting state, with Wilson's interval.
- explorations: mean of the completed runs (the paper's attempts, figure 4b).
- steps / bound: sum of explorations and direct reaches in completed runs, divided by the sum of the
  steps of the shortest accepted traces of their tasks (the steps of `clairvoyant`).
- explorations / optimum: sum of the planner's explorations, divided by the sum of those of
  `optimal`, in the runs that both completed.

Means and ratios have intervals by the delta method, with the task as the independent unit.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from edge.lab.eval.intervals import Interval, ratio, wilson
from edge.lab.eval.json_lines_file import json_data
from edge.lab.eval.planning.delexicalised import delexicalise
from edge.lab.eval.planning.executor import OUTCOMES
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.sweep import Settings, SweepResults
from edge.lab.eval.planning.templates import BenchmarkTask
from edge.text import format_table


@dataclass(frozen=True, slots=True)
class Row:
    """A planner's figures at one p_obs, or over all of them.

    Attributes:
        p_obs: probability that an exploration finds its target; None for all together.
        outcomes: number of runs by outcome.
        complete: share of completed runs.
        explorations: mean over completed runs.
        steps_to_bound: ratio; NaN without a bound.
        explorations_to_optimum: ratio; NaN without an optimum.
    """

    planner: str
    p_obs: float | None
    runs: int
    outcomes: dict[str, int]
    complete: Interval
    explorations: Interval
    steps_to_bound: Interval
    explorations_to_optimum: Interval


def rows_of(results: SweepResults) -> list[Row]:
    """Return, by planner, a row for each p_obs, then one for all if there are several."""
    rows = []
    for k in range(len(results.planners)):
        rows += [_row(results, k, slice(j, j + 1), p) for j, p in enumerate(results.p_obs)]
        if len(results.p_obs) > 1:
            rows.append(_row(results, k, slice(None), None))
    return rows


def _row(results: SweepResults, k: int, at: slice, p_obs: float | None) -> Row:
    """Return the figures of planner `k` at a slice `at` of the p_obs.

    The local arrays are (p_obs, tasks, episodes).
    """
    outcome, complete = results.outcome[k, at], results.complete[k, at]
    explorations, steps = results.explorations[k, at], results.steps[k, at]
    ended = Counter(outcome.ravel().tolist())
    bound = np.broadcast_to(results.bound[None, :, None], complete.shape)
    optimum = Interval(math.nan, math.nan, math.nan)
    if "optimal" in results.planners and not PLANNERS[results.planners[k]].knows_all_places:
        best = results.planners.index("optimal")
        both = complete & results.complete[best, at]
        optimum = _ratio(explorations, results.explorations[best, at], both)
    return Row(
        results.planners[k],
        p_obs,
        outcome.size,
        {OUTCOMES[code]: n for code, n in sorted(ended.items())},
        wilson(int(complete.sum()), outcome.size),
        _ratio(explorations, np.ones_like(explorations), complete),
        _ratio(steps, bound, complete),
        optimum,
    )


def _ratio(numerators: np.ndarray, denominators: np.ndarray, where: np.ndarray) -> Interval:
    """Return the ratio of two sums over the runs in `where`; tasks are independent.

    All arrays are (p_obs, tasks, episodes); `where` is bool.
    """
    counted = where.any(axis=(0, 2))
    sums = [np.where(where, a, 0).sum(axis=(0, 2))[counted] for a in (numerators, denominators)]
    return ratio(sums[0].astype(float), sums[1].astype(float))


def table(rows: Sequence[Row]) -> str:
    """Return the figures as aligned text."""
    head = ("planner", "p_obs", "runs", "complete, % [95 % interval]", "explorations",
            "steps / bound", "expl. / optimum")  # fmt: skip
    return format_table([head, *map(_cells, rows)], left=1)


def _cells(row: Row) -> tuple[object, ...]:
    share, low, high = (100 * x for x in row.complete)
    return (
        row.planner, "all" if row.p_obs is None else f"{row.p_obs:g}", row.runs,
        f"{share:.2f} [{low:.2f}, {high:.2f}]", _pm(row.explorations, 2),
        _pm(row.steps_to_bound, 3), _pm(row.explorations_to_optimum, 3),
    )  # fmt: skip


def _pm(interval: Interval, digits: int) -> str:
    """Format `1.23 ± 0.04`; without an interval, the value alone."""
    if math.isnan(interval.value):
        return "-"
    text = f"{interval.value:.{digits}f}"
    if math.isnan(interval.low):
        return text
    return f"{text} ± {interval.high - interval.value:.{digits}f}"


def legend(planners: Sequence[str]) -> str:
    """Return a line for each planner, with its description."""
    return format_table([(name, PLANNERS[name].words) for name in planners])


def tasks_line(tasks: Sequence[BenchmarkTask]) -> str:
    """Return the number of tasks, in total and by family.

    Lifted (delexicalised) formulas count formulas that differ only in their objects once.
    """
    families = Counter(task.family for task in tasks)
    structures = len({delexicalise(task.formula) for task in tasks})
    kinds = ", ".join(f"{n} {name}" for name, n in families.items())
    return f"{len(tasks)} tasks, {structures} lifted formulas: {kinds}"


def to_json(
    rows: Sequence[Row], tasks: Sequence[BenchmarkTask], settings: Settings, seconds: float
) -> bytes:
    """Return the figures as JSON. NaN, which JSON lacks, is null, and so is the p_obs of "all"."""
    data = {
        "tasks": len(tasks),
        "templates": Counter(task.family for task in tasks),
        "lifted_formulas": len({delexicalise(task.formula) for task in tasks}),
        "seed": settings.seed,
        "episodes": settings.episodes,
        "seconds": round(seconds, 1),
        "rows": [json_data(asdict(row)) for row in rows],
    }
    return json.dumps(data, indent=1, allow_nan=False).encode()
