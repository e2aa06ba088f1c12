"""Tables, pictures and sections of documents, of outcomes made by hand."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import pytest
from made_episodes import facts, outcome

from edge.errors import UserError
from edge.lab.eval.trajectories import pictures, tables
from edge.lab.eval.trajectories.outcomes import ResultsFolder, gather
from edge.lab.eval.trajectories.references import CATEGORIES
from edge.lab.report import canvas

FACTS = [facts(k, CATEGORIES[k % 3], ("to", "past", "then")[k % 3]) for k in range(12)]
OURS = [outcome(k, error_m=0.5 + (k % 4)) for k in range(12)]
A_STAR = [outcome(k, "a_star", 3.0, frechet_m=6.0, contacts=k % 2) for k in range(12)]


def table(name, outcomes, of=FACTS):
    found = {t.name: t for t in tables.tables(gather(of, outcomes))}
    return [dict(enumerate(row)) for row in found[name].rows] if name in found else None


def test_no_outcomes_give_no_tables_or_plots():
    assert all(not t.rows for t in tables.tables(gather([], [])))
    assert pictures.figures(gather([], [])) == {}


def test_a_task_a_row_next_to_the_paper():
    rows = table("tasks", OURS + A_STAR)
    assert [row[0] for row in rows] == [*CATEGORIES, "total"]
    total = rows[-1]
    assert total[1] == "12"
    assert total[2].startswith("2.00 [")
    assert total[3].startswith("25 [")
    assert [total[k] for k in (4, 5, 6, 7)] == ["4.91", "53", "1.68", "84"]


def test_tasks_with_unseen_ends_have_their_own_row():
    of = [replace(one, certain=k < 8) for k, one in enumerate(FACTS)]
    certain, not_certain = table("tasks", OURS, of)[-2:]
    assert (certain[0], certain[1]) == ("end certain", "8")
    assert (not_certain[0], not_certain[1]) == ("end depends on unseen ground", "4")


def test_a_row_per_class_with_the_most_frequent_first():
    of = [replace(one, label="van" if k < 8 else "fence") for k, one in enumerate(FACTS)]
    outcomes = [replace(one, at_thing=k < 4) for k, one in enumerate(OURS)]
    rows = [list(row.values()) for row in table("things", outcomes, of)]
    assert [row[:2] for row in rows] == [["van", "8"], ["fence", "4"]]
    assert [row[3].split()[0] for row in rows] == ["50", "0"]
    assert rows[0][2].startswith("25 [")


def test_deep_contacts_are_counted():
    driven = [replace(one, true_contacts=k % 2, true_depth_m=0.1 * k) for k, one in enumerate(OURS)]
    (row,) = table("shapes", driven)
    assert [row[5], row[6]] == ["6/12", "9/12"]


def test_pairs_are_of_the_episodes_that_both_ran():
    (row,) = table("paired", OURS + A_STAR[:5])
    assert row[1] == "5"
    assert row[4] == "-4.00 [-4.00, -4.00]"
    assert table("paired", A_STAR) is None


def test_refusals_are_counted_by_cause():
    assert table("refusals", OURS) is None
    refused = [replace(one, refused="not understood", success=False) for one in A_STAR[:3]]
    rows = table("refusals", OURS + refused)
    assert [list(row.values()) for row in rows] == [["ours", "12", "0"], ["a_star", "3", "3"]]


def test_hostile_words_are_escaped_in_images():
    (figure,) = pictures.figures(gather(FACTS, OURS)).values()
    content = canvas.content(figure, "svg")
    assert b"go to &lt;b&gt;$x$&lt;/b&gt;" in content


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("outcomes.jsonl", b"{}"),
        ("outcomes.jsonl", b'{"episode": 1}'),
        ("episodes.jsonl", b"[1]"),
        ("episodes.jsonl", json.dumps({**asdict(FACTS[0]), "category": "x"}).encode()),
        ("outcomes.jsonl", json.dumps({**asdict(OURS[0]), "error_m": "far"}).encode()),
    ],
)
def test_a_foreign_folder_is_reported_in_one_line(tmp_path, name, line):
    (tmp_path / name).write_bytes(line + b"\n")
    with pytest.raises(UserError, match=f"{name}: line 1: not an") as caught:
        ResultsFolder(tmp_path)
    assert "\n" not in str(caught.value)


def test_outcomes_of_no_episode_are_reported():
    with pytest.raises(UserError, match="the episode e0 is missing"):
        gather(FACTS[1:], OURS)
