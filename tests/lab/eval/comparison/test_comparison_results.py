"""`edge eval results`: what it runs, and the document that it writes."""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
from pathlib import Path

import pytest
from made_outcomes import many, record

from edge.cli.main import main
from edge.cli.parsers import make_parser
from edge.errors import ConfigError, UserError
from edge.lab.eval import episodes as eps
from edge.lab.eval.comparison import results
from edge.lab.eval.comparison.outcomes import gather
from edge.lab.eval.comparison.statistics import compare

SHIPPED = Path(__file__).parents[4] / "docs" / "results.yaml"
DEMO = {"kind": "house", "house": "demo"}
BOOK = """
title: Results of a test
text: Tuned on nothing.
sections:
  - name: first
    title: The first
    text: "*How* it was done."
    episodes: ["demo --targets 'trash can,bed' --starts 1"]
    columns: {slow: {}, fast: {policy: {kind: nearest_frontier}, loop: {priority: null}}}
    baseline: slow
    tables: [summary, paired, losses]
    plots: [differences, rates]
  - name: alone
    title: Not there
    episodes: [demo]
  - name: both
    title: What it costs
    of: [first]
    tables: [cost]
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "results.yaml"
    path.write_text(BOOK)
    return path


def outcomes_in(folder: Path, columns=("slow", "fast")) -> None:
    planned = eps.make_episode(DEMO, "demo", (1.5, 1.5, 0.0), 5.0, {}, "bed")
    folder.mkdir(parents=True)
    eps.write(folder / "episodes.jsonl", [planned])
    path_m = {"slow": 9, "fast": 6, "old": 7}
    lines = [record(planned.id, c, world="demo", path_m=path_m[c]) for c in columns]
    text = "".join(f"{json.dumps(line)}\n" for line in lines)
    (folder / "outcomes.jsonl").write_text(text)


def made(tmp_path, *options) -> list[str]:
    file, out = str(tmp_path / "results.yaml"), str(tmp_path / "out")
    return ["eval", "results", file, "--out", out, *options]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("baseline: slow", "base: slow"), "sections.0.base: unknown key (did you mean"),
        (("tables: [cost]", "tables: [costs]"), "unknown 'costs' (choices: summary, paired"),
        (("plots: [differences, rates]", "plots: [rate]"), "unknown 'rate' (choices: rates"),
        (("of: [first]", "of: [second]"), "both: of: no section 'second'"),
        (("of: [first]", "of: [both]"), "both: of: no section 'both' runs"),
        (("name: alone", "name: first"), "first: there are two of that name"),
        (("name: alone", "name: ../up"), "should match pattern"),
        (("baseline: slow", "baseline: quick"), "first: baseline: 'quick' is no column that it"),
        (("    of: [first]\n", ""), "both: give it either `episodes`, `traj"),
        (
            ("    of: [first]\n", "    trajectories: ['streets[0:2]']\n"),
            "unknown 'cost' (choices: t",
        ),
        (("episodes: [demo]", "trajectories: [x]\n    show: [a]"), "trajectories have no 'show'"),
        (("sections:", "sections: {"), "not YAML"),
        ((BOOK, ""), "expected a section"),
    ],
)
def test_a_file_that_is_not_right_is_told_in_a_line(file, change, words):
    file.write_text(BOOK.replace(*change))
    with pytest.raises(ConfigError) as told:
        results.read(file)
    assert words in str(told.value)
    assert "\n" not in str(told.value)


def test_no_file(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        results.read(tmp_path / "none.yaml")


def test_commands(file):
    book = results.read(file)
    (words,) = results.commands(book.sections[0], Path("out"))
    assert shlex.join(words) == (
        "eval episodes demo --targets 'trash can,bed' --starts 1 --column slow --column fast "
        "policy.kind=nearest_frontier loop.priority=null --out out/first"
    )
    assert results.commands(book.sections[2], Path("out")) == []


def test_a_section_of_trajectories(file, tmp_path):
    file.write_text(BOOK.replace("episodes: [demo]", "trajectories: ['streets[0:1] --limit 1']"))
    assert main(made(tmp_path, "--only", "alone")) == 0
    text = (tmp_path / "out" / "results.md").read_text()
    assert "edge eval trajectories 'streets[0:1]' --limit 1 --out" in text
    assert "1 episode in 1 place." in text
    assert "OpenNav table II" in text


def test_which_sections_are_run(file):
    book = results.read(file)
    assert results.chosen(book, None) == list(book.sections)
    assert [chapter.name for chapter in results.chosen(book, ["both"])] == ["first", "both"]
    with pytest.raises(UserError, match="no section 'x'; there are: first, alone, both"):
        results.chosen(book, ["x"])


def test_only_what_is_asked_for_is_run_and_all_that_is_there_is_written(
    file, tmp_path, monkeypatch, capsys
):
    asked = []

    def instead(words, check):
        asked.append(words)
        outcomes_in(tmp_path / "out" / "first")
        return argparse.Namespace(returncode=0)

    monkeypatch.setattr(subprocess, "run", instead)
    assert main(made(tmp_path, "--only", "both", "--episodes", "7", "--workers", "2")) == 0
    (words,) = asked
    assert words[-4:] == ["--workers", "2", "--limit", "7"]
    printed = capsys.readouterr().out
    assert "edge eval episodes demo" in printed
    assert str(tmp_path / "out" / "first-rates.png") in printed
    text = (tmp_path / "out" / "results.md").read_text()
    assert text.startswith("# Results of a test\n\nTuned on nothing.\n\nMade by `edge eval results")
    assert "1 episode in 1 world." in text
    assert "--column fast policy.kind=nearest_frontier" in text
    assert "![SPL and success rate of each column, with 95 % intervals](first-" in text
    assert "| slow | 1 | 100.0 [20.7, 100.0] | 0.556 |" in text
    assert "## Not there\n\n```sh\nedge eval episodes demo --out" in text
    assert text.count("Not run yet.") == 1
    assert text.index("Cost in the tick") > text.index("## What it costs")
    files = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert files == {"first-differences.png", "first-rates.png"}


def test_what_is_there_is_written_the_same_again(file, tmp_path):
    outcomes_in(tmp_path / "out" / "first")
    written = []
    for _ in range(2):
        assert main(made(tmp_path, "--no-run")) == 0
        written.append((tmp_path / "out" / "results.md").read_bytes())
    assert written[0] == written[1]


def test_a_run_that_fails_ends_it(file, tmp_path, monkeypatch, capsys):
    failed = argparse.Namespace(returncode=78)
    monkeypatch.setattr(subprocess, "run", lambda words, check: failed)
    assert main(made(tmp_path)) == 65
    assert "first: `edge eval episodes` ended with 78" in capsys.readouterr().err
    assert not (tmp_path / "out" / "results.md").exists()


def test_columns_that_ran_fewer_episodes_are_named(file):
    records = many({"slow": 2.0, "fast": 1.5}, 2)[:-1]
    book = results.read(file)
    shown = results.of_comparison(
        book.sections[0], compare(gather(records), "slow", None, 50), ("slow", "fast")
    )
    text = results.document(book, {"first": shown}, file, Path("out"), "a machine")
    assert "8 episodes in 2 worlds. Of these ran fewer: fast 7." in text


@pytest.mark.parametrize(
    ("ran", "words"),
    [
        (("fast", "slow"), "1 episode in 1 world.\n"),
        (("slow", "old"), "1 episode in 1 world. Not run yet: fast."),
        (("fast",), "Not run yet."),  # for lack of the baseline
        (("old",), "Not run yet."),
    ],
)
def test_what_is_there_of_a_broken_off_run_is_shown(file, tmp_path, ran, words):
    """In the order of the YAML, whoever came first; what it does not name is not shown."""
    outcomes_in(tmp_path / "out" / "first", ran)
    assert main(made(tmp_path, "--no-run")) == 0
    chapter = (tmp_path / "out" / "results.md").read_text().split("## ")[1]
    assert words in chapter
    assert "| old |" not in chapter
    if "slow" in ran and "fast" in ran:
        assert chapter.index("| slow |") < chapter.index("| fast |")


def test_the_one_that_we_ship_is_right():
    book = results.read(SHIPPED)
    for chapter in book.sections:
        for words in results.commands(chapter, Path("results")):
            args = make_parser("", {}).parse_args(words)
            assert args.out == Path("results") / chapter.name
