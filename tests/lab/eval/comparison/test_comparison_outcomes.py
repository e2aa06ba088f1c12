"""Outcomes to arrays: what is refused, what is passed over, what need not be measured."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import numpy as np
import pytest
from made_outcomes import failure, record

from edge.errors import FileError, UserError
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.intervals import clusters
from edge.lab.eval.outcome import EpisodeOutcome, read_outcomes

RECORD = asdict(record())


def written(tmp_path, *lines) -> list[EpisodeOutcome]:
    path = tmp_path / "outcomes.jsonl"
    texts = [line if isinstance(line, str) else json.dumps(line) + "\n" for line in lines]
    path.write_text("".join(texts), encoding="utf-8")
    return read_outcomes(path)


def test_nothing(tmp_path):
    assert written(tmp_path) == []
    outcomes = gather([])
    assert outcomes.arms == outcomes.episodes == ()
    assert outcomes.success.shape == (0, 0)
    assert clusters(outcomes.world)[0].shape == (0,)


def test_no_file(tmp_path):
    with pytest.raises(FileError, match=r"No such file.*`edge eval episodes --out DIR` writes"):
        read_outcomes(tmp_path / "outcomes.jsonl")


def test_an_unfinished_line_is_ignored(tmp_path):
    assert written(tmp_path, RECORD, '{"episode": "hou') == [record()]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("[]\n", "not a JSON object"),
        ('{"x": \x1b}\n', "not JSON"),
        ({k: v for k, v in RECORD.items() if k != "world"}, "world: Field required"),
        ({**RECORD, "path_m": "far"}, "path_m: Input should be a valid number"),
        ({**RECORD, "shortest_m": math.inf}, "shortest_m: Input should be a finite number"),
        ({**RECORD, "shortest_m": -1.0}, "shortest_m: Input should be greater"),
        ({**RECORD, "world": 3}, "world: Input should be a valid string"),
    ],
)
def test_an_invalid_outcome_is_reported_with_its_line(tmp_path, line, words):
    with pytest.raises(
        UserError, match=f"outcomes.jsonl: line 2: not an outcome: {words}.*; remove"
    ):
        written(tmp_path, RECORD, line)


def test_arrays_have_a_row_per_arm_and_nan_for_gaps():
    outcomes = gather(
        [
            record("house-10/bed", "a"),
            failure("house-9/bed", "a", world="house-9", wrong_stops=None),
            record("house-9/bed", "b", world="house-9", score_ms=0.25),
        ]
    )
    assert outcomes.arms == ("a", "b")
    assert outcomes.episodes == ("house-9/bed", "house-10/bed")
    assert outcomes.ran.tolist() == [[True, True], [True, False]]
    assert outcomes.success.tolist() == [[False, True], [True, False]]
    assert outcomes.failure.tolist() == [["never seen", ""], ["", ""]]
    np.testing.assert_array_equal(outcomes["path_m"], [[40.0, 10.0], [10.0, np.nan]])
    np.testing.assert_array_equal(outcomes["wrong_stops"], [[np.nan, 0.0], [0.0, np.nan]])
    np.testing.assert_array_equal(outcomes["score_p95_ms"], [[0.5, 0.5], [0.25, np.nan]])
    np.testing.assert_array_equal(outcomes["tick_p95_ms"][0], [2.0, 2.0])


def test_the_newest_of_a_column_counts():
    outcomes = gather(
        [
            record("one", "a", arm_id="old", path_m=1.0),
            record("two", "a", arm_id="old", path_m=1.0),
            record("one", "a", arm_id="new", path_m=2.0),
            record("one", "a", arm_id="new", path_m=3.0),
        ]
    )
    assert outcomes.episodes == ("one",)
    assert outcomes["path_m"].tolist() == [[3.0]]
    assert outcomes.n_ignored == 3


@pytest.mark.parametrize("changes", [{"shortest_m": 6.0}, {"target": "sofa"}])
def test_columns_on_different_episodes_of_one_name_are_not_compared(changes):
    with pytest.raises(UserError, match="run both arms on the same file of episodes"):
        gather([record(arm="a"), record(arm="b", **changes)])
