"""The time line of a mission: bars, switches and marks, from nothing to far too much."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import pytest
from matplotlib.colors import to_hex
from report_runs import FORMULA, story_of

from edge.lab.report import canvas, gantt, palette


def with_steps(run, steps, formula=FORMULA, targets=("chair", "sofa", "tv", "bed")):
    story = story_of(formula, (), steps)
    return replace(run, mission_facts=story, targets={name: name for name in targets})


def words(page) -> list[str]:
    root = ElementTree.fromstring(canvas.svg(page))
    return [e.text or "" for e in root.iter() if e.tag.endswith("}text")]


def chart(page):
    return page.figure.axes[1]


def test_without_a_log_there_is_no_chart(run):
    assert gantt.pursuit_intervals(run) == []
    assert gantt.draw(run) is None
    assert gantt.draw(with_steps(run, ())) is None
    assert gantt.draw(with_steps(run, ((0.0, "start", "", "mission"),))) is None


def test_spans(long_run):
    spans = [(s.label, s.start_s, s.end_s, s.settled) for s in gantt.pursuit_intervals(long_run)]
    assert spans == [
        ("sofa", 0.0, 6.0, False),
        ("chair", 6.0, 12.0, True),
        ("sofa", 12.0, 19.0, True),
        ("tv", 19.0, 24.0, True),
    ]


def test_the_chart_shows_pursuits_switches_and_ends(long_run):
    drawn = chart(gantt.draw(long_run))
    assert [t.get_text() for t in drawn.get_yticklabels()] == ["sofa", "bed", "chair", "tv"]
    (bars,) = drawn.containers
    colours = [
        palette.target_colour(s.label, long_run.targets) for s in gantt.pursuit_intervals(long_run)
    ]
    assert [to_hex(bar.get_facecolor()) for bar in bars] == colours
    assert [bar.get_width() for bar in bars] == pytest.approx([6.0, 6.0, 7.0, 5.0])
    (switch,) = (text for text in drawn.texts if not text.get_text())
    assert switch.xy[0] == 6.0
    marked = [(line.get_marker(), *line.get_xydata()[0]) for line in drawn.lines[1:]]
    assert {("o", 2.0, 1.0), ("X", 12.0, 2.0), ("^", 9.0, 1.0)} <= set(marked)
    said = gantt.in_words(long_run)
    assert "6.0 to 12.0 s: target: chair: it was seen, and the sofa was not" in said


def test_forty_targets_and_a_thousand_steps(run):
    labels = [f"object {k}" for k in range(50)]
    steps = [(0.1 * k, "target", labels[k % 50], "why " * 200) for k in range(1000)]
    record = with_steps(run, steps, "F a", tuple(labels))
    assert len(gantt.pursuit_intervals(record)) == 1000
    page = gantt.draw(record)
    assert "10 more targets are not shown" in words(page)
    assert page.figure.get_figheight() * 72 < 40 * gantt.ROW + 100
    assert len(canvas.img(page, gantt.in_words(record))) < 2_000_000


@pytest.mark.parametrize(("end_s", "last"), [(0.0, "1 s"), (8.0, "8 s"), (3000.0, "50 min")])
def test_the_axis_has_round_numbers(run, end_s, last):
    short = replace(run, trajectory_t_s=run.trajectory_t_s[:0], events=())
    steps = ((0.0, "target", "tv", ""), (end_s, "end", "", ""))
    ticks = [w for w in words(gantt.draw(with_steps(short, steps))) if w.endswith((" s", " min"))]
    assert ticks[0] == "0 s"
    assert ticks[-1] == last
    assert len(ticks) <= 13
