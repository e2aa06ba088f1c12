"""`edge eval planning`: the task-level benchmark (ViTL V-C, figure 4).

It measures which planner completes tasks in natural language with the fewest explorations. The
correct formulas are given: `edge eval translate` measures translation.
"""

from __future__ import annotations

import argparse
import time

from edge.errors import FileError, UserError
from edge.host.files import make_writable, save
from edge.host.progress import ProgressBar
from edge.lab.eval.planning import report
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.sweep import Settings, run_tasks
from edge.lab.eval.planning.templates import generate

JSON_NAME = "results.json"


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval planning`.

    Raises:
        UserError: an option is wrong, or `--out` cannot be written.
    """
    began_s = time.monotonic()
    settings = Settings(_parse_planners(args.planners), args.p_obs, args.episodes, args.seed)
    try:  # before the work
        make_writable(args.out)
    except OSError as error:
        raise FileError(
            f"--out {args.out}: cannot be written: {error.strerror or error}; choose another folder"
        ) from None
    tasks = generate(args.n, args.seed)
    print(report.tasks_line(tasks), flush=True)
    with ProgressBar("tasks", len(tasks)) as bar:
        results = run_tasks(tasks, settings, args.workers, bar.set_done)
    rows = report.rows_of(results)
    print(report.legend(results.planners), end="\n\n")
    print(report.table(rows), end="\n\n")
    seconds = time.monotonic() - began_s
    try:
        save(args.out / JSON_NAME, report.to_json(rows, tasks, settings, seconds))
    except FileError as error:
        raise FileError(
            f"{error}; the table above is complete; for the file, run again with another folder"
        ) from None
    print(f"{args.out / JSON_NAME}\n{seconds:.0f} s")
    return 0


def _parse_planners(text: str | None) -> tuple[str, ...]:
    if text is None:
        return tuple(PLANNERS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in PLANNERS]
    if unknown or not names:
        what = f"no planner {unknown[0]!r}" if unknown else "got no name"
        raise UserError(f"--planners: {what} (choices: {', '.join(PLANNERS)})")
    return names
