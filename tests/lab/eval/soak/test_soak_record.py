"""The record of a soak, its verdict and its tables."""

from __future__ import annotations

import json
from contextlib import closing

import pytest

from edge.lab.eval.soak.record import Record, of, verdict
from edge.lab.eval.soak.tables import summary

USED = {"pid": 1, "memory_mb": 200.0, "shared_mb": 0.0, "threads": 30, "descriptors": 28}


@pytest.fixture
def record(tmp_path):
    with closing(Record(tmp_path / "record.jsonl")) as record:
        record.add("begin", seed=0)
        yield record


def watch(record: Record, **fields) -> None:
    sample = {"calm": True, "service": USED, "model": None, "readyz": 200, "log_a_minute": 3}
    record.add("sample", **{**sample, **fields})


def test_a_soak_of_nothing_held_and_has_no_tables(record):
    assert verdict(record.rows) == "all held for 0 min: 0 faults, 0 missions, 0 of them reached"
    assert summary(record.rows) == ""


def test_the_file_has_every_row_at_once(record, tmp_path):
    watch(record)
    lines = (tmp_path / "record.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line) for line in lines] == record.rows
    assert [row["kind"] for row in record.rows] == ["begin", "sample"]


def test_the_first_rule_that_broke_is_the_verdict(record):
    for rule, why in (("log", "900 lines in a minute"), ("missions", "none was reached")):
        record.add("broken", rule=rule, why=why)
    assert verdict(record.rows) == "broken at 0 s: log: 900 lines in a minute (1 more)"


def test_the_tables_show_what_was_watched_a_line_each(record):
    said = "two\nlines"
    for name, why in (("camera-gone", ""), ("reload", said)):
        times = {"began_s": 1.0, "lasted_s": 2.0, "recovered_s": 3.0}
        record.add("fault", name=name, broken=why, **times)
    record.add("mission", instruction=said, phase="reached", reason=said, elapsed_s=9.0, path_m=2.0)
    record.add("growth", name="memory", unit="MB", most_per_h=20, per_h=1, low=0, high=2)
    record.add("broken", rule="log", why=said)
    lines = summary(record.rows).splitlines()
    for row in ("log", "memory", "camera-gone", "reload", "reached"):
        assert sum(row in line.split() for line in lines) == 1
    assert any("+0.00 … +2.00" in line for line in lines)
    assert "lines" not in lines
    assert len(of(record.rows, "fault")) == 2
