"""Tables of `edge eval trajectories`, in the form of OpenNav IV, next to the paper's figures."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from edge.lab.eval.comparison.tables import DASH, ReportTable, bounded
from edge.lab.eval.intervals import Interval, bootstrap, clusters, intervals_note, wilson
from edge.lab.eval.trajectories.methods import METHODS, REFUSALS
from edge.lab.eval.trajectories.outcomes import DEEP_M, TrajectoryResults
from edge.lab.eval.trajectories.references import CATEGORIES
from edge.text import one_line

BASELINE = "ours"
# Rows for tasks whose end depends, or not, on ground that no frame shows.
_CERTAIN, _UNCERTAIN = "end certain", "end depends on unseen ground"


class PaperRow(NamedTuple):
    """A row of table I: navigation error, and successes of 50."""

    error_m: float
    reached: int


PAPER_TASKS: dict[str, dict[str, PaperRow]] = {
    "LLM-TG": {
        "specific": PaperRow(1.44, 43), "ambiguous": PaperRow(7.40, 13),
        "high-level": PaperRow(5.90, 23),
    },
    "OpenNav": {
        "specific": PaperRow(1.01, 45), "ambiguous": PaperRow(1.63, 42),
        "high-level": PaperRow(2.40, 40),
    },
}  # fmt: skip
"""OpenNav table I, by method, by category."""
PAPER_TOTAL = {"LLM-TG": (4.91, "53"), "OpenNav": (1.68, "84")}
"""Totals of table I: navigation error [m], and success rate [%]."""
PAPER_SHAPES = {
    "ours": (12.60, 0.38, "2/30"), "vlt_code": (17.53, 0.16, "16/30"),
    "a_star": (24.20, 0.08, "0/30"),
}  # fmt: skip
"""OpenNav table II, by our names: Fréchet distance, NDTW, trajectories that collide."""


def tables(results: TrajectoryResults) -> list[ReportTable]:
    """Return every table that has rows."""
    found = [
        by_task(results),
        by_thing(results),
        shapes(results),
        paired(results),
        refusals(results),
    ]
    return [table for table in found if table.rows]


def by_task(results: TrajectoryResults) -> ReportTable:
    """Return a table of success and navigation error, one row for each category (table I)."""
    wanted = [m for m, name in enumerate(results.method_names) if METHODS[name].ends]
    category = np.array([facts.category for facts in results.facts], str)
    head = ["task", "n"]
    for m in wanted:
        head += [f"{one_line(results.methods[m])}: NE, m", "SR, %"]
    for name in PAPER_TASKS:
        head += [f"{name} (paper): NE", "SR"]
    rows = []
    certain = np.array([facts.certain for facts in results.facts], bool)
    inside_of = {name: category == name for name in CATEGORIES}
    inside_of["total"] = np.ones(len(category), bool)
    if not certain.all():
        inside_of |= {_CERTAIN: certain, _UNCERTAIN: ~certain}
    for row, inside in inside_of.items():
        if not inside.any():
            continue
        cells = [row, str(int((results.ran[wanted][:, inside]).any(axis=0).sum()))]
        for m in wanted:
            kept = inside & results.ran[m]
            reached = int(results.numbers["success"][m, kept].sum())
            cells += [
                bounded(_means(results, "error_m", m, kept), 2),
                bounded(wilson(reached, int(kept.sum())), 0, 100.0),
            ]
        rows.append([*cells, *_paper_cells(row)])
    return ReportTable("tasks", "By kind of task (OpenNav table I)", head, rows, _note(results))


def by_thing(results: TrajectoryResults) -> ReportTable:
    """Return a table of success by the class of the object at the end, the most frequent first."""
    labels = np.array([facts.label for facts in results.facts], str)
    wanted = [m for m, name in enumerate(results.method_names) if METHODS[name].ends]
    head = ["to", "n"]
    for m in wanted:
        head += [f"{one_line(results.methods[m])}: SR, %", "at it, %"]
    rows = []
    for label in sorted(set(labels), key=lambda one: (-(labels == one).sum(), one)):
        rows.append([one_line(label), str(int((labels == label).sum()))])
        for m in wanted:
            kept = (labels == label) & results.ran[m]
            for key in ("success", "at it"):
                reached = int(results.numbers[key][m, kept].sum())
                rows[-1].append(bounded(wilson(reached, int(kept.sum())), 0, 100.0))
    note = "At it: ends as near to the object as the reference, on any side of it. "
    return ReportTable("things", "By kind of object", head, rows, note + _note(results))


def shapes(results: TrajectoryResults) -> ReportTable:
    """Return a table of similarity to the references, one row for each method (table II)."""
    head = ("method", "n", "Fréchet, m", "NDTW", "collided", "in truth", "deep", "refused", "SR, %",
            "NE, m", "time, s", "paper: Fréchet", "NDTW", "collided")  # fmt: skip
    rows = []
    for m, name in enumerate(results.methods):
        ran = results.ran[m]
        n = int(ran.sum())
        keys = ("success", "collided", "truly collided", "deeply collided", "refused")
        counts = {key: int(results.numbers[key][m, ran].sum()) for key in keys}
        paper = PAPER_SHAPES.get(results.method_names[m])
        rows.append([
            one_line(name), str(n),
            bounded(_means(results, "frechet_m", m, ran), 2),
            bounded(_means(results, "ndtw", m, ran), 2),
            f"{counts['collided']}/{n}", f"{counts['truly collided']}/{n}",
            f"{counts['deeply collided']}/{n}", f"{counts['refused']}/{n}",
            bounded(wilson(counts["success"], n), 0, 100.0),
            bounded(_means(results, "error_m", m, ran), 2),
            f"{np.median(results.numbers['seconds'][m, ran]):.2f}",
            *((f"{paper[0]:.2f}", f"{paper[1]:.2f}", paper[2]) if paper else (DASH,) * 3),
        ])  # fmt: skip
    note = (
        "Collided: trajectories that come nearer to an obstacle than the robot's radius, in the "
        "map that they were made on. In truth: the same, with all true obstacles; deep: by more "
        f"than {DEEP_M:g} m. If a trajectory was refused, the robot's place counts as the "
        "trajectory. Time: median of writing and refining. " + _note(results)
    )
    return ReportTable("shapes", "Shape of the trajectories (OpenNav table II)", head, rows, note)


def paired(results: TrajectoryResults) -> ReportTable:
    """Return a table of ours minus each other method, on the same episodes."""
    head = ("ours minus", "n", "SR, % points", "NE, m", "Fréchet, m", "NDTW", "collided, % points")
    rows = []
    base = next((m for m, name in enumerate(results.method_names) if name == BASELINE), None)
    for m, name in enumerate(results.methods) if base is not None else ():
        both = results.ran[m] & results.ran[base]
        if m == base or not both.any():
            continue
        keys = (("success", 1, 100.0), ("error_m", 2, 1.0), ("frechet_m", 2, 1.0),
                ("ndtw", 2, 1.0), ("collided", 1, 100.0))  # fmt: skip
        cells = [
            bounded(_mean(results.numbers[key][base] - results.numbers[key][m], results, both),
                    digits, scale, "+")
            for key, digits, scale in keys
        ]  # fmt: skip
        rows.append([one_line(name), str(int(both.sum())), *cells])
    return ReportTable("paired", "Ours against the others, paired", head, rows, _note(results))


def refusals(results: TrajectoryResults) -> ReportTable:
    """Return a table of refusals by cause, one row for each method."""
    causes = [c for c in REFUSALS if any(o.refused == c for o in results.outcomes.values())]
    rows = []
    for m, name in enumerate(results.methods):
        outcomes = [o for (row, _), o in results.outcomes.items() if row == m]
        counts = [sum(o.refused == cause for o in outcomes) for cause in causes]
        rows.append([one_line(name), str(len(outcomes)), *map(str, counts)])
    rows = rows if causes else []
    return ReportTable("refusals", "Refused", ("method", "n", *causes), rows)


def _paper_cells(row: str) -> list[str]:
    """Return the paper's figures for a category, or for "total"."""
    cells = []
    for name, by_category in PAPER_TASKS.items():
        if row in (_CERTAIN, _UNCERTAIN):
            cells += [DASH, DASH]
        elif row == "total":
            error_m, share = PAPER_TOTAL[name]
            cells += [f"{error_m:.2f}", share]
        else:
            cells += [f"{by_category[row].error_m:.2f}", f"{by_category[row].reached}/50"]
    return cells


def _means(results: TrajectoryResults, key: str, method: int, kept: np.ndarray) -> Interval:
    return _mean(results.numbers[key][method], results, kept)


def _mean(values: np.ndarray, results: TrajectoryResults, kept: np.ndarray) -> Interval:
    """Return the mean over some episodes, with its interval by bootstrap over their worlds."""
    if not kept.any():
        return Interval(math.nan, math.nan, math.nan)
    ones = np.ones((1, int(kept.sum())))
    return bootstrap(values[kept][None], ones, clusters(_places(results))[0][kept])[0]


def _places(results: TrajectoryResults) -> np.ndarray:
    return np.array([facts.world for facts in results.facts], str)


def _note(results: TrajectoryResults) -> str:
    return intervals_note(_places(results), "place")
