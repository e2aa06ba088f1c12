"""The plots: files, reproducible, every column named in them, for any outcomes."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from made_outcomes import failure, many, record

from edge.lab.eval.comparison import plots
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.comparison.statistics import compare
from edge.lab.report.canvas import style_of


def drawn(records, tmp_path, kinds=("svg",)):
    return plots.write(compare(gather(records), resamples=100), tmp_path, kinds)


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


def test_looks_differ():
    looks = [style_of(k) for k in range(24)]
    assert len(set(looks)) == 24
    assert len({look.colour for look in looks[:12]}) == 12


@pytest.mark.parametrize(
    ("budget", "share"), [(0.99, 0.0), (1.0, 0.25), (1.99, 0.25), (2.0, 0.5), (1e9, 0.75)]
)
def test_within_budget(budget, share):
    outcomes = gather(
        [
            record("1", shortest_m=5.0, path_m=4.9), record("2", shortest_m=5.0, path_m=10.0),
            record("3", shortest_m=5.0, path_m=50.0), failure("4"), record("5", "other"),
        ]
    )  # fmt: skip
    assert plots.within_budget(outcomes, 0, np.array([budget])).tolist() == [share]


@pytest.mark.parametrize(("n", "bins"), [(1, 1), (16, 2), (100, 5)])
def test_bins_hold_every_episode_once(n, bins):
    found = plots._bins(np.random.default_rng(0).uniform(3, 20, n))
    assert len(found) == bins
    assert np.sum(found, axis=0).tolist() == [1] * n
