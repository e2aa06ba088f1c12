"""The two plots: files, reproducible, every planner named in them."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from edge.lab.eval.intervals import Interval
from edge.lab.eval.planning.planners import PLANNERS
from edge.lab.eval.planning.plots import figures
from edge.lab.eval.planning.report import Row
from edge.lab.report.canvas import save_plots

NAN = Interval(float("nan"), float("nan"), float("nan"))


def row(planner: str, p_obs: float | None, complete: float, explorations: Interval = NAN) -> Row:
    share = Interval(complete, complete - 0.01, complete)
    return Row(planner, p_obs, 100, {}, share, explorations, NAN, NAN)


@pytest.fixture
def rows():
    return [
        row(planner, p, 0.9 if planner == "in-order" else 1.0, Interval(k + 2 / p, k, k + 3 / p))
        for k, planner in enumerate(PLANNERS)
        for p in (0.1, 0.5, 1.0)
    ] + [row("vitl", None, 1.0)]


def words(path) -> str:
    return " ".join(e.text or "" for e in ElementTree.parse(path).iter() if e.tag.endswith("text"))


def test_files(tmp_path, rows):
    paths = save_plots(figures(rows), tmp_path)
    assert [path.name for path in paths] == [
        "completion.svg", "explorations.svg", "completion.png", "explorations.png",
    ]  # fmt: skip
    assert all(path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for path in paths[2:])
    for planner in PLANNERS:
        assert planner in words(paths[0])
        # The clairvoyant does not explore.
        assert (planner in words(paths[1])) == (planner != "clairvoyant")


@pytest.mark.parametrize(
    "rows", [[], [row("vitl", 0.5, 1.0)], [row("vitl", 0.1, 0.2), row("optimal", 0.1, 0.3)]]
)
def test_few_rows_make_plots_too(tmp_path, rows):
    assert len(save_plots(figures(rows), tmp_path)) == 4
