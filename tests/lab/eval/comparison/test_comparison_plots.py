"""The plots: files, reproducible, every column named in them, for any outcomes."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from made_outcomes import failure, many, record

from edge.lab.eval.comparison import plots
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.comparison.statistics import compare
from edge.lab.report.canvas import save_plots


def drawn(records, tmp_path, kinds=("svg",)):
    return save_plots(plots.figures(compare(gather(records), resamples=100)), tmp_path, kinds)


def words(path) -> str:
    return " ".join(e.text or "" for e in ElementTree.parse(path).iter() if e.tag.endswith("text"))


def test_nothing(tmp_path):
    assert drawn([], tmp_path) == []


def test_files(tmp_path):
    records = many({"base": 2.5, "new $x_1": 1.5}, 12)
    paths = drawn(records, tmp_path, ("svg", "png"))
    assert [p.name for p in paths] == [f"{n}.{k}" for k in ("svg", "png") for n in plots.PLOTS]
    assert all(path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for path in paths[4:])
    for path in paths[:4]:
        assert "new $x_1" in words(path), path.name
        assert "base" in words(path), path.name
    before = [path.read_bytes() for path in paths]
    assert [path.read_bytes() for path in drawn(records, tmp_path, ("svg", "png"))] == before


@pytest.mark.parametrize(
    "records",
    [
        [record()],
        [failure()],
        [record("1", "a"), record("2", "b")],
        [record(shortest_m=0.0, path_m=0.0)],
        many({f"{k}": 1.5 for k in range(18)}, 2),
    ],
)
def test_any_outcomes_can_be_drawn(tmp_path, records):
    assert drawn(records, tmp_path)
