"""The time line of a mission: bars, switches and marks, from nothing to far too much."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import pytest
from matplotlib.colors import to_hex
from report_runs import FORMULA, S, story_of

from edge.lab.report import canvas, gantt, palette
from edge.text import shorten

BAD = "<script>alert('x')</script>"


def told(run, steps, formula=FORMULA, targets=("chair", "sofa", "tv", "bed")):
    return replace(run, story=story_of(formula, (), steps), targets=targets)


def words(page) -> list[str]:
    root = ElementTree.fromstring(canvas.svg(page))
    return [e.text or "" for e in root.iter() if e.tag.endswith("}text")]


def chart(page):
    """The axes inside the page."""
    return page.figure.axes[1]


def test_without_a_story_or_steps_there_is_no_picture(run):
    assert gantt.spans(run) == []
    assert gantt.draw(run) is None
    assert gantt.draw(told(run, ())) is None
    assert gantt.draw(told(run, ((0.0, "start", "", "mission"),))) is None


def test_spans(long_run):
    spans = [(s.label, s.start_s, s.end_s, s.settled) for s in gantt.spans(long_run)]
    assert spans == [
        ("sofa", 0.0, 6.0, False),
        ("chair", 6.0, 12.0, True),
        ("sofa", 12.0, 19.0, True),
        ("tv", 19.0, 24.0, True),
    ]


def test_a_target_that_is_reached_twice_is_settled_twice(run):
    steps = ((1.0, "target", "tv", ""), (2.0, "reached", "tv", ""), (2.0, "target", "tv", ""),
             (3.0, "target", "sofa", ""), (4.0, "end", "", ""))  # fmt: skip
    assert [s.settled for s in gantt.spans(told(run, steps))] == [True, False, False]


def test_a_mission_under_way_is_pursued_up_to_the_last_moment(run):
    last_s = run.trajectory_t_s[-1]
    spans = gantt.spans(told(run, ((3.0, "target", "tv", ""),)))
    assert [(s.start_s, s.end_s) for s in spans] == [(3.0, max(last_s, run.events[-1][0]))]


def test_the_picture_shows_what_happened(long_run):
    drawn = chart(gantt.draw(long_run))
    assert [t.get_text() for t in drawn.get_yticklabels()] == ["sofa", "bed", "chair", "tv"]
    (bars,) = drawn.containers
    colours = [palette.target_colour(s.label, long_run.targets) for s in gantt.spans(long_run)]
    assert [to_hex(bar.get_facecolor()) for bar in bars] == colours
    assert [bar.get_width() for bar in bars] == pytest.approx([6.0, 6.0, 7.0, 5.0])
    (switch,) = (text for text in drawn.texts if not text.get_text())
    assert switch.xy[0] == 6.0
    marked = [(line.get_marker(), *line.get_xydata()[0]) for line in drawn.lines[1:]]
    assert {("o", 2.0, 1.0), ("X", 12.0, 2.0), ("^", 9.0, 1.0)} <= set(marked)
    said = gantt.in_words(long_run)
    assert "6.0 to 12.0 s: target: chair: it was seen, and the sofa was not" in said


def test_reached_targets_are_numbered(long_run):
    numbers = [(t.get_text(), t.get_position()) for t in chart(gantt.draw(long_run)).texts]
    assert [n for n in numbers if n[0]] == [("1", (19.0, 0)), ("2", (24.0, 3))]


def test_forty_targets_and_a_thousand_steps(run):
    labels = [f"thing {k}" for k in range(50)]
    steps = [(0.1 * k, "target", labels[k % 50], "why " * 200) for k in range(1000)]
    record = told(run, steps, "F a", tuple(labels))
    assert len(gantt.spans(record)) == 1000
    page = gantt.draw(record)
    assert "10 more targets are not shown" in words(page)
    assert page.figure.get_figheight() * 72 < 40 * gantt.ROW + 100
    assert len(canvas.img(page, gantt.in_words(record))) < 2_000_000


@pytest.mark.parametrize("label", [BAD, "x" * 200, 'a"b', "$x^", "沙发"])
def test_any_name_is_text(run, label):
    steps = ((0.0, "target", label, BAD), (1.0, "reached", label, BAD))
    page = gantt.draw(told(run, steps, targets=(label,)))
    assert shorten(label, 22) in words(page)
    assert b"<script" not in canvas.svg(page)
    assert "<script" not in canvas.img(page, BAD)


@pytest.mark.parametrize(("end_s", "last"), [(0.0, "1 s"), (8.0, "8 s"), (3000.0, "50 min")])
def test_the_axis_has_round_numbers(run, end_s, last):
    short = replace(run, trajectory_t_s=run.trajectory_t_s[:0], events=())
    steps = ((0.0, "target", "tv", ""), (end_s, "end", "", ""))
    ticks = [w for w in words(gantt.draw(told(short, steps))) if w.endswith((" s", " min"))]
    assert ticks[0] == "0 s"
    assert ticks[-1] == last
    assert len(ticks) <= 13


def test_stamps_before_the_start_are_drawn_at_the_edge(run):
    record = replace(told(run, ((0.0, "target", "tv", ""),)), start_ns=5 * S)
    assert len(chart(gantt.draw(record)).containers[0]) == 1
