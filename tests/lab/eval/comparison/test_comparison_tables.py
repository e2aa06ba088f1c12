"""The tables, in everything that they are written in."""

from __future__ import annotations

import json

import numpy as np
import pytest
from made_outcomes import failure, many, record

from edge.lab.eval.comparison import tables
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.comparison.statistics import compare

BAD = "<script>|\n\x1b[31m"


def comparison_of(records, left_m=None, baseline=None):
    return compare(gather(records), baseline, left_m, resamples=200)


@pytest.fixture(scope="module")
def comparison():
    outcomes = gather(many({"base": 2.5, "new": 1.5}, 12))
    return compare(outcomes, "base", np.full(outcomes.ran.shape, 3.0), 200)


def named(comparison, name):
    return next(table for table in tables.tables(comparison) if table.name == name)


def test_unmeasured_columns_are_left_out_and_gaps_are_dashes():
    without = {"false_confirmations": None, "score_ms": None}
    both = [record("1", "a", **without), record("1", "b", **without)]
    (never,) = {row[-2] for row in named(comparison_of(both), "conduct").rows}
    assert never == "0.0 [0.0, 79.3]"  # no wrong stop in one episode
    head = named(comparison_of(both), "conduct").head
    assert "false conf." not in head
    assert "wrong stops, %" in head
    one = [record("1", "a", false_confirmations=2), record("1", "b", **without)]
    assert named(comparison_of(one), "conduct").rows[1][-2] == tables.DASH


@pytest.mark.parametrize(
    ("worlds", "words"), [(1, "of 1 world; they do not"), (12, "over 12 worlds")]
)
def test_the_table_reports_the_unit_of_resampling(worlds, words):
    assert words in tables.summary(comparison_of(many({"a": 2.0}, worlds)), "summary").note


def test_each_word_has_its_recall_and_its_ends():
    records = [
        record("1", "a", target="sofa", views=30, detected=12),
        failure("2", "a", target="sofa", views=10, detected=0, failure="wrong thing"),
        failure("3", "a", target="bed"),
        record("3", "b", target="bed", views=4, detected=4),
        record("4", "a", target=None),
    ]
    table = named(comparison_of(records), "words")
    assert table.head == ("target", "arm", "n", "recall", "reached", "never seen", "wrong thing")
    assert table.rows == [
        ["bed", "a", "1", tables.DASH, "0", "1", "0"],
        ["bed", "b", "1", "1.00", "1", "0", "0"],
        ["sofa", "a", "2", "0.30", "1", "0", "1"],
    ]


def test_without_words_there_is_no_words_table():
    shown = {table.name for table in tables.tables(comparison_of([record("1", target=None)]))}
    assert "words" not in shown


def test_text_stays_text():
    comparison = comparison_of([record("1", BAD, target=BAD), record("2", "b")])
    for table in tables.tables(comparison):
        assert "\x1b" not in tables.text(table)
        assert "<script" not in tables.html(table)


def test_json_has_everything(comparison):
    data = json.loads(tables.to_json(comparison))
    assert data["arms"]["new"]["sr"]["n"] == 48
    assert data["arms"]["new"]["zone_entries"]["interval"]["value"] is None
    assert data["paired"]["new"]["spl"]["low"] > 0
    assert data["losses"]["new"]["spl"] == pytest.approx(comparison.losses["new"].spl)
    assert (data["baseline"], data["resampled"], data["worlds"]) == ("base", "world", 12)
