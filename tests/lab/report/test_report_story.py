"""The page's section about the mission: when it exists, and its text."""

from __future__ import annotations

from dataclasses import replace

import pytest
from report_runs import FORMULA, story_of
from results import facts
from test_report_page import Reader

from edge.lab.report import page, path_plot, picture, story
from edge.mission.logic.ltl import parse
from edge.mission.planning.plan import DEAD

BAD = '<script>alert("x")</script>'


def test_a_run_with_one_target_has_none(run):
    assert story.section(run) == ""
    assert story.section(replace(run, mission_facts=facts())) == ""


def test_a_mission_is_explained_and_drawn(long_run):
    reader = Reader(page.html(long_run, b"png"))
    for words in ("Go to the chair or the sofa, then to the tv.", "in words (ltl)",
                  str(parse(FORMULA)), "sofa, then tv", "Automaton with 6 states, now in state 4",
                  "best views of the targets"):  # fmt: skip
        assert words in reader.text
    assert "left to reach" not in reader.text
    assert "2reached" in reader.text


def test_a_path_is_coloured_by_the_target_of_its_time(long_run):
    assert path_plot.pursuit_intervals(replace(long_run, mission_facts=None)) == []
    assert path_plot.pursuit_intervals(long_run) == [
        ("sofa", 0.0, 6.0), ("chair", 6.0, 12.0), ("sofa", 12.0, 19.0), ("tv", 19.0, 24.0),
    ]  # fmt: skip


def test_a_running_mission_lists_the_targets_left(long_run):
    plan = replace(DEAD, steps=("sofa", "", "tv"))
    under_way = replace(long_run.mission_facts, trace=(), state=0, log=(), plan=plan)
    text = Reader(story.section(replace(long_run, mission_facts=under_way))).text
    assert "left to reachsofa, then nothing, then tv" in text
    assert "reachednothing" in text


def test_important_steps_are_highlighted(long_run):
    text = page.html(long_run, b"")
    assert '<dd class="reached">reached: tv (seen in 7 images)</dd>' in text
    assert '<dd class="failed">failed: chair (stuck)</dd>' in text
    assert "<dd>seen: bed</dd>" in text


@pytest.mark.parametrize(("name", "n"), [(BAD, 40), ("x" * 190, 1), ("$a^ \\frac", 1)])
def test_any_names_and_many(run, name, n):
    quoted = [f'"{name.replace(chr(34), chr(39))} {k}"' for k in range(n)]
    steps = [(0.5 * k, "target", target.strip('"'), BAD) for k, target in enumerate(quoted)]
    shown = story_of(f"F({' | '.join(quoted)}) & F tv", (), steps, BAD * 300)
    record = replace(run, mission_facts=shown, targets=shown.spec.labels)
    text = page.html(record, picture.png(record))
    reader = Reader(text)
    assert "script" not in reader.tags
    assert "<script" not in text
    assert text.count("alert") < 2000
