"""Command that learns the prior (which objects stand near each other) from furnished houses.

python -m exporters.training.prior HOUSES.jsonl.gz --out edge/perception/prior/table.json
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from edge.host.files import replace_atomically
from edge.lab.sim.procthor import read_houses
from edge.perception.prior.table import parse
from exporters.files import ExportError, exit_on_user_error
from exporters.training.prior import learn
from exporters.training.prior.counts import count, count_kinds
from exporters.training.prior.house import HousePlan, read_plan
from exporters.training.prior.samples import Samples, gather

_BLANK = {"evidence": 1.0, "power": [1.0, 1.0]}
"""Fitted values of the part `kinds` before they are fitted."""


def read_plans(path: Path) -> tuple[list[dict[str, Any]], list[HousePlan]]:
    """Return the houses of a file, and their plans.

    Raises:
        ExportError: the file's content is no list of houses.
        WorldError: the file cannot be read.
    """
    try:
        houses = list(read_houses(path))
        return houses, [read_plan(house) for house in houses]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ExportError(f"{path}: not a file of ProcTHOR houses: {error!r}") from None


def count_tables(houses: list[dict[str, Any]], plans: list[HousePlan]) -> dict[str, Any]:
    """Return the part of a table that is counted, not fitted."""
    table = count(houses)
    kinds = sorted({kind for plan in plans for kind in plan.kinds})
    return {**table, "kinds": {**count_kinds(plans, table["things"], kinds), **_BLANK}}


def fit_table(
    data: dict[str, Any], samples: Samples
) -> tuple[dict[str, Any], dict[int, learn.Fit]]:
    """Fit the weights of a table to samples.

    Returns:
        The entire table, and the fit of each target by its index in `classes`.
    """
    classes = tuple(data["things"])
    found = ((target, learn.cross_fit(samples, target)) for target in range(len(classes)))
    fits = {target: fit for target, fit in found if fit is not None}
    data = {**data, "near": learn.near_part(fits, classes)}
    kinds = data["kinds"] = dict(data["kinds"])
    kinds["evidence"] = learn.fit_evidence(samples, parse(data))
    kinds["power"], gained = learn.fit_powers(samples, parse(data), fits)
    print(f"rooms: {({k: kinds[k] for k in _BLANK})}, share of the log loss gained alone "
          f"{gained[0]:.2%}, on top of what is near {gained[1]:.2%}")  # fmt: skip
    return data, fits


def print_scores(fits: dict[int, learn.Fit], samples: Samples, classes: list[str]) -> None:
    """Print for each target how well the held-out houses were predicted."""
    print("target               houses  share   base   loss  gained     auc  opinion")
    for target, fit in sorted(fits.items(), key=lambda item: item[1].score.loss):
        s = fit.score
        gained = f"{s.base - s.loss:+.4f} ±{s.error:.4f}"
        print(f"{classes[target]:20} {s.houses:6} {s.share:6.3f} {s.base:6.3f} {s.loss:6.3f} "
              f"{gained} {s.auc:6.3f}  {'yes' if fit.has_opinion else 'no'}")  # fmt: skip
    print("predicted → observed likelihood ratio (places)")
    for predicted, observed, n in learn.reliability(
        samples, fits, np.array([0.5, 0.7, 0.9, 1.1, 1.5, 2])
    ):
        print(f"  {predicted:5.2f} → {observed:5.2f} ({n})")


@exit_on_user_error
def main(argv: list[str] | None) -> None:
    """Learn a table from a file of houses and write it."""
    parser = argparse.ArgumentParser(
        prog="python -m exporters.training.prior", description=main.__doc__
    )
    parser.add_argument(
        "file", type=Path, help="ProcTHOR houses to learn from (.jsonl or .jsonl.gz)"
    )
    parser.add_argument("--out", type=Path, required=True, help="table to write (.json; required)")
    args = parser.parse_args(argv)
    houses, plans = read_plans(args.file)
    data = count_tables(houses, plans)
    kinds = data["kinds"]["names"]
    samples = gather(plans, data["things"], kinds)
    data, fits = fit_table(data, samples)
    print_scores(fits, samples, data["things"])
    about = {
        "about": "Where things stand by what stands around; see edge/perception/prior/table.py.",
        "source": f"{args.file.name}, sha256 {hashlib.sha256(args.file.read_bytes()).hexdigest()}",
        "command": f"python -m exporters.training.prior {args.file.name} --out {args.out.name}",
        "licence": "Learned from houses of ProcTHOR (Allen Institute for AI), Apache-2.0.",
    }
    with replace_atomically(args.out) as path:
        path.write_text(json.dumps({**about, **data}, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    sys.exit(main())
