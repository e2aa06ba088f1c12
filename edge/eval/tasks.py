"""The task-level benchmark (ViTL V-C, figure 4): which planner completes tasks in language with
the fewest explorations, under a probabilistic executor.

The formulas are given (right): translation is what `edge eval translate` measures.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from edge.errors import FileError, UserError

if TYPE_CHECKING:
    from edge.eval.task_runs import Results, Settings
    from edge.eval.task_templates import Task

P_OBS = "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1.0"
JSON_NAME = "results.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `edge eval tasks`; all have defaults."""
    from edge.cli.parsers import count

    whole = parser.add_argument
    whole("--tasks", type=Path, metavar="FILE", help="tasks from there (JSON lines) instead")
    whole("--export", type=Path, metavar="FILE", help="write the tasks there and stop")
    whole("--n", type=count, default=2000, help="tasks to generate (default: %(default)s)")
    whole("--seed", type=_seed, default=0, help="of tasks and of luck (default: %(default)s)")
    whole(
        "--p-obs", type=_p_obs, default=P_OBS, metavar="P,P,…",
        help="probabilities that an exploration finds its target (default: 0.1,0.2,…,1.0)",
    )  # fmt: skip
    whole("--planners", metavar="NAME,NAME,…", help="default: all that need no language model")
    whole("--episodes", type=count, default=1, help="a task and p_obs (default: %(default)s)")
    whole("--jobs", type=count, default=_cores(), help="processes (default: one a core)")
    whole(
        "--out", type=Path, default=Path("tasks-report"), metavar="DIR",
        help="for the plots and results.json (default: ./%(default)s)",
    )  # fmt: skip
    whole("--llm", metavar="URL", help="compare a language model too: an OpenAI-compatible API")
    whole("--model", default="default", help="its name on that server (default: %(default)s)")
    whole(
        "--llm-tasks", type=count, default=20, metavar="N",
        help="how many of the tasks it gets (default: %(default)s)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Handle `edge eval tasks`.

    Raises:
        UserError: bad options or tasks; nothing can be written to `--out`; the language model's
            server failed. What ends the language model's runs, Ctrl-C too, is raised after the
            results until then have been printed and written.
    """
    from edge.eval import task_file, task_report
    from edge.eval.task_runs import Settings

    began_s = time.monotonic()
    settings = Settings(_planners(args.planners), args.p_obs, args.episodes, args.seed)
    client = _client(args)
    tasks = task_file.read_tasks(args.tasks) if args.tasks else _generate(args.n, args.seed)
    if args.export:
        task_file.write_tasks(args.export, tasks)
        print(f"{len(tasks)} tasks in {args.export}")
        return 0
    out = _writable(args.out)
    print(task_report.tasks_line(tasks), flush=True)
    results = _run_offline(tasks, settings, args.jobs)
    failure = None
    if client is not None:
        results, failure = _run_llm(tasks, settings, args, client, results)
    _report(results, tasks, settings, out, began_s)
    if failure is not None:
        raise failure
    return 0


def _report(
    results: Results, tasks: list[Task], settings: Settings, out: Path, began_s: float
) -> None:
    """Print the figures, write them and the plots."""
    from edge.eval import task_report
    from edge.eval.task_plots import write_plots
    from edge.host.files import write_atomically

    rows = task_report.rows_of(results)
    print(task_report.legend(results.planners), end="\n\n")
    print(task_report.table(rows), end="\n\n")
    print(task_report.summary(rows), end="\n\n")
    seconds = time.monotonic() - began_s
    try:
        content = task_report.to_json(rows, tasks, settings, seconds)
        write_atomically(out / JSON_NAME, content)
        paths = [out / JSON_NAME, *write_plots(rows, out)]
    except OSError as error:
        raise FileError(f"--out {out}: {error.strerror}; name another directory") from None
    print("\n".join(map(str, paths)))
    print(f"{seconds:.0f} s")


def _writable(directory: Path) -> Path:
    """Make sure, before the work, that its results can be written there.

    Raises:
        UserError: they cannot.
    """
    from edge.host.files import make_writable

    try:
        make_writable(directory)
    except OSError as error:
        reason = error.strerror
        raise FileError(f"--out {directory}: {reason}; name another directory") from None
    return directory


def _generate(n: int, seed: int) -> list[Task]:
    from edge.eval.task_templates import generate

    return generate(n, seed)


def _run_offline(tasks: list[Task], settings: Settings, jobs: int) -> Results:
    from edge.eval.progress_bar import ProgressBar
    from edge.eval.task_runs import run_tasks

    with ProgressBar("tasks", len(tasks)) as bar:
        return run_tasks(tasks, settings, jobs, bar.update)


def _run_llm(tasks, settings, args, client, results):  # type: ignore[no-untyped-def]
    """The results with the language model's, and what ended its runs early."""
    import numpy as np

    from edge.eval.llm_planner import merged, run_llm
    from edge.eval.progress_bar import ProgressBar

    n = min(args.llm_tasks, len(tasks))
    rows = np.linspace(0, len(tasks) - 1, n).round().astype(int).tolist()
    total = n * len(settings.p_obs) * settings.episodes
    with ProgressBar("runs of the language model", total) as bar:
        own, failure = run_llm(tasks, rows, settings, client, args.jobs, bar.update)
    return merged(results, own), failure


def _client(args: argparse.Namespace):  # type: ignore[no-untyped-def]
    """The language model's client; None when none is asked for."""
    if not args.llm:
        return None
    from edge.chat import client_of
    from edge.config import TranslatorLlm

    return client_of(TranslatorLlm(url=args.llm, model=args.model))


def _planners(text: str | None) -> tuple[str, ...]:
    """
    Raises:
        UserError: an unknown name; lists what there is.
    """
    from edge.eval.task_planners import PLANNERS

    if text is None:
        return tuple(PLANNERS)
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    unknown = [name for name in names if name not in PLANNERS]
    if unknown or not names:
        what = f"no planner {unknown[0]!r}" if unknown else "no planner named"
        raise UserError(f"--planners: {what}; there are: {', '.join(PLANNERS)}")
    return names


def _p_obs(text: str) -> tuple[float, ...]:
    try:
        values = tuple(dict.fromkeys(round(float(part), 6) for part in text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers such as 0.5,1, got {text!r}") from None
    for value in values:
        if not 0 < value <= 1:
            raise argparse.ArgumentTypeError(f"must be above 0 and at most 1, got {value:g}")
    return values


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < 1 << 63:
        raise argparse.ArgumentTypeError(f"must be between 0 and 2**63 - 1, got {text}")
    return value


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
