"""Holds benchmarks to `budgets.yaml` and prints where each stands.

A benchmark names its budget: `benchmark.extra_info["budget"] = "astar_weighted_1000"`.
`--enforce-budgets` turns an exceeded budget, or one that nothing was measured for, into a failed
run; without it the table only says so, since a shared machine's speed is not the code's.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

BUDGETS = yaml.safe_load((Path(__file__).parent / "budgets.yaml").read_text())


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--enforce-budgets", action="store_true", help="fail when a budget is passed")


def _verdicts(config: pytest.Config) -> list[tuple[str, float, str, bool]]:
    """(budget name, median in ms, the limit in words, whether it holds), in order of running."""
    session = getattr(config, "_benchmarksession", None)
    medians = {
        bench.extra_info["budget"]: bench.stats.median * 1e3
        for bench in (session.benchmarks if session else [])
        if bench.extra_info.get("budget") and bench.stats.data
    }
    rows = []
    for name, median in medians.items():
        limit = BUDGETS[name]
        if "median_ms" in limit:
            rows.append((name, median, f"<= {limit['median_ms']} ms", median <= limit["median_ms"]))
        elif limit.get("ratio_of") in medians:
            ratio = median / medians[limit["ratio_of"]]
            words = f"ratio {ratio:.2f} <= {limit['max_ratio']} of {limit['ratio_of']}"
            rows.append((name, median, words, ratio <= limit["max_ratio"]))
        elif "ratio_of" in limit:
            rows.append((name, median, f"{limit['ratio_of']} was not measured", False))
        else:
            rows.append((name, median, "reference", True))
    return rows


def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    rows = _verdicts(config)
    if rows:
        terminalreporter.section("budgets")
    for name, median, words, holds in rows:
        verdict = "ok" if holds else "OVER"
        terminalreporter.write_line(f"{verdict:4}  {name:45} {median:9.3f} ms   {words}")


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    if not session.config.getoption("--enforce-budgets") or exitstatus != 0:
        return
    rows = _verdicts(session.config)
    skipped = session.config.pluginmanager.get_plugin("terminalreporter").stats.get("skipped")
    if skipped or not rows or not all(row[3] for row in rows):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
