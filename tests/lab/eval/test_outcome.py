"""The file of outcomes: whole lines, each once, whatever broke off a run."""

from __future__ import annotations

import json
import math

import pytest

from edge.errors import FileError, UserError
from edge.lab.eval.arms import ExperimentArm
from edge.lab.eval.episodes import Episode
from edge.lab.eval.outcome import OUTCOMES_NAME, EpisodeOutcome, OutcomeFile, crashed_outcome

COLUMN = ExperimentArm("hvl", {}, {}, "c0", "here")
EPISODE = Episode("e0", {"kind": "house", "house": "demo"}, (0.0, 1.0, 2.0), "bed", None, 3.0)


def test_a_new_folder_has_no_outcomes(tmp_path):
    assert OutcomeFile(tmp_path / "new").known == {}


def test_an_appended_outcome_is_read_back(tmp_path):
    outcome = crashed_outcome(COLUMN, EPISODE, "two\nlines")
    OutcomeFile(tmp_path).append(outcome)
    assert OutcomeFile(tmp_path).known == {("e0", "c0"): outcome}
    assert (outcome.world, outcome.kind, outcome.failure) == ("demo", "house", "crashed")
    assert outcome.reason == "crashed: two lines"


def test_the_last_of_an_episode_and_column_counts(tmp_path):
    file = OutcomeFile(tmp_path)
    file.append(crashed_outcome(COLUMN, EPISODE, "first"))
    file.append(crashed_outcome(COLUMN, EPISODE, "second"))
    assert [o.reason for o in OutcomeFile(tmp_path).known.values()] == ["crashed: second"]


def test_half_a_line_is_cut_off_and_written_again(tmp_path):
    file = OutcomeFile(tmp_path)
    file.append(crashed_outcome(COLUMN, EPISODE, "whole"))
    with (tmp_path / OUTCOMES_NAME).open("ab") as raw:
        raw.write(b'{"episode": "e1", "colu')
    again = OutcomeFile(tmp_path)
    assert len(again.known) == 1
    again.append(crashed_outcome(ExperimentArm("x", {}, {}, "c1", ""), EPISODE, "next"))
    assert len(OutcomeFile(tmp_path).known) == 2


@pytest.mark.parametrize("text", ["[]", "{", "{}", json.dumps({"episode": "a", "start": [0]})])
def test_invalid_outcome_lines_are_refused(tmp_path, text):
    (tmp_path / OUTCOMES_NAME).write_text(text + "\n")
    with pytest.raises(UserError, match="line 1: not an outcome of this version"):
        OutcomeFile(tmp_path)


def test_a_place_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="file"):
        OutcomeFile(tmp_path / "file")


def test_non_finite_numbers_become_null(tmp_path):
    outcome = EpisodeOutcome(
        "e", "c", "i", "w", "house", "bed", None, (0.0, 0.0, 0.0), 1.0, False, "", "budget",
        distance_m=math.inf, trail=[[1.23456789, math.nan]],
    )  # fmt: skip
    OutcomeFile(tmp_path).append(outcome)
    data = json.loads((tmp_path / OUTCOMES_NAME).read_text())
    assert data["distance_m"] is None
    assert data["trail"] == [[1.2346, None]]
