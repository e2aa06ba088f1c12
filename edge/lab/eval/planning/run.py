"""`edge eval planning`: the task-level benchmark (ViTL V-C, figure 4).

It measures which planner completes tasks in natural language with the fewest explorations. The
correct formulas are given: `edge eval translate` measures translation.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from edge.errors import FileError, UserError

if TYPE_CHECKING:
    from edge.lab.eval.planning.sweep import Settings, SweepResults
    from edge.lab.eval.planning.templates import BenchmarkTask

JSON_NAME = "results.json"


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval planning`.

    Raises:
        UserError: an option or a task is wrong; `--out` cannot be written; or the language model's
            server failed. The error that ends the language model's runs, even Ctrl-C, is raised
            after the results so far are printed and written.
    """
    from edge.lab.eval.planning import file, report
    from edge.lab.eval.planning.sweep import Settings

    began_s = time.monotonic()
    settings = Settings(_parse_planners(args.planners), args.p_obs, args.episodes, args.seed)
    client = _client(args)
    tasks = file.read_tasks(args.tasks) if args.tasks else _generate(args.n, args.seed)
    if args.export:
        file.write_tasks(args.export, tasks)
        print(f"{len(tasks)} tasks in {args.export}")
        return 0
    out = _check_writable(args.out)
    print(report.tasks_line(tasks), flush=True)
    results = _run_offline(tasks, settings, args.jobs)
    failure = None
    if client is not None:
        results, failure = _run_llm(tasks, settings, args, client, results)
    _report(results, tasks, settings, out, began_s)
    if failure is not None:
        raise failure
    return 0


def _report(
    results: SweepResults, tasks: list[BenchmarkTask], settings: Settings, out: Path, began_s: float
) -> None:
    """Print the figures, and write them and the plots."""
    from edge.host.files import write_atomically
    from edge.lab.eval.planning import report
    from edge.lab.eval.planning.plots import write_plots

    rows = report.rows_of(results)
    print(report.legend(results.planners), end="\n\n")
    print(report.table(rows), end="\n\n")
    print(report.summary(rows), end="\n\n")
    seconds = time.monotonic() - began_s
    try:
        content = report.to_json(rows, tasks, settings, seconds)
        write_atomically(out / JSON_NAME, content)
        paths = [out / JSON_NAME, *write_plots(rows, out)]
    except OSError as error:
        raise FileError(
            f"--out {out}: files cannot be written: {error.strerror}; the table above is "
            "complete; for the files, run again with another folder"
        ) from None
    print("\n".join(map(str, paths)))
    print(f"{seconds:.0f} s")


def _check_writable(directory: Path) -> Path:
    """Return the directory if results can be written there; checked before the work."""
    from edge.host.files import make_writable

    try:
        make_writable(directory)
    except OSError as error:
        reason = error.strerror
        raise FileError(
            f"--out {directory}: cannot be written: {reason}; choose another folder"
        ) from None
    return directory


def _generate(n: int, seed: int) -> list[BenchmarkTask]:
    from edge.lab.eval.planning.templates import generate

    return generate(n, seed)


def _run_offline(tasks: list[BenchmarkTask], settings: Settings, jobs: int) -> SweepResults:
    from edge.host.progress import ProgressBar
    from edge.lab.eval.planning.sweep import run_tasks

    with ProgressBar("tasks", len(tasks)) as bar:
        return run_tasks(tasks, settings, jobs, bar.set_done)


def _run_llm(tasks, settings, args, client, results):  # type: ignore[no-untyped-def]
    """Return the results with the language model's, and the error that ended its runs early."""
    import numpy as np

    from edge.host.progress import ProgressBar
    from edge.lab.eval.planning.llm_planner import merged, run_llm

    n = min(args.llm_tasks, len(tasks))
    rows = np.linspace(0, len(tasks) - 1, n).round().astype(int).tolist()
    total = n * len(settings.p_obs) * settings.episodes
    with ProgressBar("runs of the language model", total) as bar:
        llm_results, failure = run_llm(tasks, rows, settings, client, args.jobs, bar.set_done)
    return merged(results, llm_results), failure


def _client(args: argparse.Namespace):  # type: ignore[no-untyped-def]
    """Return the language model's client; None without `--llm`."""
    if not args.llm:
        return None
    from edge.chat import make_chat_client
    from edge.config import TranslatorLlm

    return make_chat_client(TranslatorLlm(url=args.llm, model=args.model))


def _parse_planners(text: str | None) -> tuple[str, ...]:
    """Parse the names of planners."""
    from edge.lab.eval.planning.planners import PLANNERS

    if text is None:
        return tuple(PLANNERS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in PLANNERS]
    if unknown or not names:
        what = f"no planner {unknown[0]!r}" if unknown else "got no name"
        raise UserError(f"--planners: {what} (choices: {', '.join(PLANNERS)})")
    return names
