"""Budgets of the benchmarks (`budgets.yaml`): prints each time next to its budget.

A benchmark names its budget: `benchmark.extra_info["budget"] = "astar_weighted_1000"`. A budget is
a ratio to a reference that is timed in the same run. So a slower computer changes no verdict, but
slower code does. The reference is a workload of `edge.host.calibration`, another benchmark, the
work that the test gives to `against` (such as OpenCV for the same task), or a deadline such as a
tick. Times are processor time, so that other programs change little. Only work on several threads
or processes is measured in real time. With `--enforce-budgets` the run fails if a budget is
exceeded, or if its reference was not measured. Without the option, only the table shows this.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from edge.host import calibration

BUDGETS = yaml.safe_load((Path(__file__).parent / "budgets.yaml").read_text())
ROUNDS = 25  # runs of a reference
WORK = calibration.workloads()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--enforce-budgets", action="store_true", help="fail when a budget is passed")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Set the default timer of benchmarks: the processor time of one thread."""
    cv2.setNumThreads(1)
    config.option.benchmark_timer = "time.thread_time"


@pytest.fixture
def against(benchmark) -> Callable[[Callable[[], object]], None]:
    """Return a function that times a reference in the way that the benchmark is timed."""

    def compare(work: Callable[[], object], timer: Callable[[], float] = time.thread_time) -> None:
        benchmark.extra_info["reference_ms"] = median_ms(work, timer)

    return compare


@pytest.fixture(autouse=True)
def _calibrated(request: pytest.FixtureRequest) -> Iterator[None]:
    """Time the reference work that the budget names, right after the benchmark."""
    yield
    benchmark = request.node.funcargs.get("benchmark")
    if benchmark is not None:
        reference = BUDGETS.get(benchmark.extra_info.get("budget"), {}).get("of")
        if reference in WORK:
            benchmark.extra_info["reference_ms"] = median_ms(WORK[reference], time.thread_time)


def median_ms(work: Callable[[], object], timer: Callable[[], float]) -> float:
    """Return the median time of `work` over `ROUNDS` runs, after one that is not timed."""
    work()
    took_s = []
    for _ in range(ROUNDS):
        began_s = timer()
        work()
        took_s.append(timer() - began_s)
    return 1e3 * statistics.median(took_s)


def _verdicts(config: pytest.Config) -> list[tuple[str, float, str, bool]]:
    """Return (budget name, time in ms, limit as text, passed) of each benchmark, in order."""
    session = getattr(config, "_benchmarksession", None)
    measured = {
        bench.extra_info["budget"]: bench
        for bench in (session.benchmarks if session else [])
        if bench.extra_info.get("budget") and bench.stats.data
    }
    rows = []
    for name, bench in measured.items():
        limit = BUDGETS[name]
        quantile, times_s = limit.get("quantile", 0.5), bench.stats.data
        figure_ms = 1e3 * float(
            np.mean(times_s) if quantile == "mean" else np.quantile(times_s, quantile)
        )
        reference = limit.get("of")
        reference_ms = bench.extra_info.get("reference_ms")
        if reference in measured:
            reference_ms = measured[reference].stats.median * 1e3
        if reference is None:
            rows.append((name, figure_ms, "reference", True))
        elif reference_ms is None:
            rows.append((name, figure_ms, f"{reference} was not measured", False))
        else:
            ratio, max_ms = figure_ms / reference_ms, limit.get("max_ms", math.inf)
            words = f"{ratio:.3g} <= {limit['max_ratio']:g} of {reference} ({reference_ms:.3f} ms)"
            words += f", and {max_ms} ms" if max_ms < math.inf else ""
            rows.append(
                (name, figure_ms, words, ratio <= limit["max_ratio"] and figure_ms <= max_ms)
            )
    return rows


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    rows = _verdicts(config)
    if rows:
        terminalreporter.section("budgets")
    for name, figure_ms, words, holds in rows:
        verdict = "ok" if holds else "OVER"
        terminalreporter.write_line(f"{verdict:4}  {name:45} {figure_ms:9.3f} ms   {words}")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    if not session.config.getoption("--enforce-budgets") or exitstatus != 0:
        return
    rows = _verdicts(session.config)
    if not rows or not all(row[3] for row in rows):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
