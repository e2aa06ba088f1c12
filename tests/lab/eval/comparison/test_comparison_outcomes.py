"""Records to arrays: refused lines, ignored records and optional fields."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from made_outcomes import failure, record

from edge.errors import FileError, UserError
from edge.lab.eval.comparison.outcomes import clusters, gather, read_records, with_rooms


def written(tmp_path, *lines) -> list[dict]:
    path = tmp_path / "outcomes.jsonl"
    texts = [line if isinstance(line, str) else json.dumps(line) + "\n" for line in lines]
    path.write_text("".join(texts), encoding="utf-8")
    return read_records(path)


def test_nothing(tmp_path):
    assert written(tmp_path) == []
    outcomes = gather([])
    assert outcomes.arms == outcomes.episodes == ()
    assert outcomes.success.shape == (0, 0)
    assert clusters(outcomes)[0].shape == (0,)


def test_no_file(tmp_path):
    with pytest.raises(FileError, match="No such file"):
        read_records(tmp_path / "outcomes.jsonl")


def test_an_unfinished_line_is_ignored(tmp_path):
    assert written(tmp_path, record(), '{"episode": "hou') == [record()]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("[]\n", "not a JSON object"),
        ('{"x": \x1b}\n', "not JSON"),
        ({k: v for k, v in record().items() if k != "path_m"}, "the field 'path_m' is missing"),
        (record(path_m="far"), "path_m: expected a number"),
        (record(shortest_m=math.inf), "shortest_m: expected a length"),
        (record(shortest_m=-1.0), "shortest_m: expected a length"),
        (record(world=3), "world: expected a text"),
    ],
)
def test_an_invalid_outcome_is_reported_with_its_line(tmp_path, line, words):
    with pytest.raises(UserError, match=f"outcomes.jsonl: line 2: not an outcome: {words}"):
        written(tmp_path, record(), line)


def test_arrays_have_a_row_per_arm_and_nan_for_gaps():
    outcomes = gather(
        [
            record("house-10/bed", "a"),
            failure("house-9/bed", "a", world="house-9", wrong_stops=None),
            record("house-9/bed", "b", world="house-9", score_ms={"p95": 0.25}),
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
    assert np.isnan(outcomes.rooms).all()
    told = with_rooms(outcomes, {"house-9": 3, "house-10": None})
    np.testing.assert_array_equal(told.rooms, [3.0, np.nan])


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
