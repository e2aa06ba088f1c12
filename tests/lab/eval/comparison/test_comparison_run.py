"""`edge eval episodes --compare` on a folder, from its files to its page."""

from __future__ import annotations

import json
import os
from dataclasses import asdict

import pytest
from made_outcomes import record

from edge.cli.main import main
from edge.config import load
from edge.lab.eval import episodes as eps
from edge.lab.eval.comparison import run
from edge.lab.eval.json_lines_file import to_line

START = (1.5, 1.5, 0.0)
DEMO = {"kind": "house", "house": "demo"}


@pytest.fixture
def folder(tmp_path):
    """Two columns on an episode in the demo house, and on one of a run before."""
    sensing = eps.sensing_settings(load("demo"))
    planned = [eps.make_episode(DEMO, "demo", START, 5.0, sensing, t) for t in ("bed", "sofa")]
    eps.write(tmp_path / run.EPISODES_NAME, planned)
    lines = [
        record(e.id, column, world="demo", target=e.target, start=list(START), path_m=path)
        for e in planned
        for column, path in (("slow", 10.0), ("fast", 5.0))
    ]
    write(tmp_path, lines)
    return tmp_path


def write(folder, lines) -> None:
    (folder / "outcomes.jsonl").write_bytes(b"".join(to_line(asdict(line)) for line in lines))


def test_a_folder_is_compared(folder, capsys):
    assert main(["eval", "episodes", "--compare", str(folder), "--baseline", "slow"]) == 0
    printed = capsys.readouterr().out
    for words in ("Against slow, paired", "Where the rest of the SPL goes", "By target",
                  str(folder / "comparison.html")):  # fmt: skip
        assert words in printed, words
    data = json.loads((folder / "results.json").read_text())
    assert data["paired"]["fast"]["spl"]["value"] == pytest.approx(0.5)
    assert data["losses"]["fast"]["spl"] == pytest.approx(1.0)
    page = (folder / "comparison.html").read_text()
    assert page.count('id="w0"') == 1
    assert page.count('href="#w0"') == 4
    assert page.count("<article") == 2


@pytest.mark.parametrize(
    ("spoil", "options", "code", "words"),
    [
        (
            lambda f: (f / "outcomes.jsonl").unlink(),
            [],
            os.EX_IOERR,
            "`edge eval episodes --out DIR`",
        ),
        (lambda f: write(f, []), [], os.EX_DATAERR, "outcomes.jsonl: has no outcomes"),
        (lambda f: None, ["--baseline", "none"], os.EX_DATAERR, "(choices: slow, fast)"),
        (lambda f: (f / "episodes.jsonl").unlink(), [], os.EX_IOERR, "episodes.jsonl"),
        (lambda f: (f / "episodes.jsonl").write_text("{}\n"), [], os.EX_DATAERR, "line 1"),
        (lambda f: (f / "results.json").mkdir(), [], os.EX_IOERR, "Is a directory"),
    ],
)
def test_a_comparison_that_cannot_run_is_reported_in_one_line(
    folder, capsys, spoil, options, code, words
):
    spoil(folder)
    assert main(["eval", "episodes", "--compare", str(folder), *options]) == code
    said = [line for line in capsys.readouterr().err.splitlines() if "worlds" not in line]
    assert len(said) == 1
    assert words in said[0]


def test_the_report_after_a_run():
    assert run.summary_text([]) == "no outcomes"
    assert "100.0 [20.7, 100.0]" in run.summary_text([record()])


def test_older_outcomes_are_ignored_with_a_message():
    comparison = run.compare(run.gather([record(arm_id="old"), record()]), resamples=50)
    assert "1 older outcomes are ignored" in run.text(comparison)
