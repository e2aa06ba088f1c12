"""The record of a soak, its verdict and its page."""

from __future__ import annotations

import json
from contextlib import closing

import pytest

from edge.eval.soak.page import html, write
from edge.eval.soak.record import Record, of, verdict

USED = {"pid": 1, "memory_mb": 200.0, "shared_mb": 0.0, "threads": 30, "descriptors": 28}


@pytest.fixture
def record(tmp_path):
    with closing(Record(tmp_path / "record.jsonl")) as record:
        record.add("begin", seed=0)
        yield record


def watch(record: Record, **fields) -> None:
    sample = {"calm": True, "service": USED, "model": None, "readyz": 200, "log_a_minute": 3}
    record.add("sample", **{**sample, **fields})


def test_a_soak_of_nothing_held_and_has_a_page(record):
    assert verdict(record.rows) == "all held for 0 min: 0 faults, 0 missions, 0 of them reached"
    page = html(record.rows, "a machine")
    assert "<img" not in page
    assert "a machine" in page


def test_the_file_has_every_row_at_once(record, tmp_path):
    watch(record)
    lines = (tmp_path / "record.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line) for line in lines] == record.rows
    assert [row["kind"] for row in record.rows] == ["begin", "sample"]


def test_the_first_rule_that_broke_is_the_verdict(record):
    for rule, why in (("log", "900 lines in a minute"), ("missions", "none was reached")):
        record.add("broken", rule=rule, why=why)
    assert verdict(record.rows) == "broken at 0 s: log: 900 lines in a minute (1 more)"


def test_the_page_shows_what_was_watched_and_quotes_what_was_said(record, tmp_path):
    said = "<script>alert(1)</script>"
    watch(record)  # before the first beat was heard, and with no model's process
    tick = {"ticks": 10, "interval_ms": [1, 2, 3], "gap_ms": [1, 2, 3], "tick_ms": [0, 0, 0]}
    watch(record, **tick, dropped={"stale": 3}, goals=4, goals_reached=1, goals_failed=0)
    watch(record, service=None)
    for name, why in (("camera-gone", ""), ("reload", said)):
        times = {"began_s": 1.0, "lasted_s": 2.0, "recovered_s": 3.0}
        record.add("fault", name=name, broken=why, **times)
    record.add("mission", instruction=said, phase="reached", reason=said, elapsed_s=9.0, path_m=2.0)
    record.add("growth", name="memory", unit="MB", most_per_h=20, per_h=1, low=0, high=2)
    page = write(record.rows, tmp_path, "a machine").read_text(encoding="utf-8")
    assert page.count("<img") == 6
    assert said not in page
    assert page.count("&lt;script&gt;") == 3
    for cell in ("camera-gone", "1 of 1", "+0.00 … +2.00"):
        assert cell in page
    assert len(of(record.rows, "fault")) == 2
