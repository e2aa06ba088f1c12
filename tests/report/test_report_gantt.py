"""The time line of a mission: bars, switches and marks, from nothing to far too much."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import pytest
from report_runs import FORMULA, S, story_of

from edge.report import gantt, palette
from edge.report.drawing.shapes import Box, Disc, svg

BAD = "<script>alert('x')</script>"


def told(run, steps, formula=FORMULA, targets=("chair", "sofa", "tv", "bed")):
    return replace(run, story=story_of(formula, (), steps), targets=targets)


def words(picture) -> list[str]:
    root = ElementTree.fromstring(svg(picture))
    return [e.text or "" for e in root.iter() if e.tag.endswith("}text")]


def titles(picture) -> list[str]:
    return [group.title for group in picture.parts if group.title]


def test_without_a_story_or_steps_there_is_no_picture(run):
    assert gantt.spans(run) == []
    assert gantt.picture(run) is None
    assert gantt.picture(told(run, ())) is None
    assert gantt.picture(told(run, ((0.0, "start", "", "mission"),))) is None


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


def test_the_picture_says_what_happened(long_run):
    picture = gantt.picture(long_run)
    assert words(picture)[:4] == ["sofa", "bed", "chair", "tv"]
    said = titles(picture)
    assert "switched at 6.0 s: target: chair: it was seen, and the sofa was not" in said
    assert sum(title.startswith("switched") for title in said) == 1
    for text in ("2.0 s: seen: bed", "12.0 s: failed: chair (stuck)", "9.0 s: will stop 0.6 m"):
        assert any(title.startswith(text) for title in said)
    bars = [s for g in picture.parts for s in g.shapes if isinstance(s, Box) and s.radius]
    colours = [palette.target_colour(s.label, long_run.targets) for s in gantt.spans(long_run)]
    assert [bar.fill for bar in bars] == colours
    lengths = [bar.width for bar in bars]
    assert lengths[0] == pytest.approx(lengths[1])
    assert lengths[2] / lengths[3] == pytest.approx(7 / 5)


def test_reached_targets_are_numbered(long_run):
    green = palette.OUTCOME["reached"]
    numbers = [
        group.shapes[-1].text
        for group in gantt.picture(long_run).parts
        if group.title and isinstance(group.shapes[0], Disc) and group.shapes[0].fill == green
    ]
    assert numbers == ["1", "2"]


def test_everything_stays_inside(long_run):
    picture = gantt.picture(long_run)
    for group in picture.parts:
        for shape in group.shapes:
            points = getattr(shape, "points", None) or [(shape.x, shape.y)]
            assert all(0 <= x <= picture.width and 0 <= y <= picture.height for x, y in points)


def test_forty_targets_and_a_thousand_steps(run):
    labels = [f"thing {k}" for k in range(50)]
    steps = [(0.1 * k, "target", labels[k % 50], "why " * 200) for k in range(1000)]
    record = told(run, steps, "F a", tuple(labels))
    assert len(gantt.spans(record)) == 1000
    picture = gantt.picture(record)
    assert "10 more targets are not shown" in words(picture)
    assert picture.height < 40 * gantt.ROW + 100
    assert len(svg(picture)) < 2_000_000


@pytest.mark.parametrize("label", [BAD, "x" * 200, "沙发", 'a"b', "$x^"])
def test_any_name_is_text(run, label):
    steps = ((0.0, "target", label, BAD), (1.0, "reached", label, BAD))
    text = svg(gantt.picture(told(run, steps, targets=(label,))))
    tags = {e.tag.rpartition("}")[2] for e in ElementTree.fromstring(text).iter()}
    assert tags <= {"svg", "g", "title", "rect", "path", "polygon", "circle", "text"}


@pytest.mark.parametrize(("end_s", "last"), [(0.0, "1 s"), (8.0, "8 s"), (3000.0, "50 min")])
def test_the_axis_has_round_numbers(run, end_s, last):
    short = replace(run, trajectory_t_s=run.trajectory_t_s[:0], events=())
    steps = ((0.0, "target", "tv", ""), (end_s, "end", "", ""))
    ticks = [w for w in words(gantt.picture(told(short, steps))) if w.endswith((" s", " min"))]
    assert ticks[0] == "0 s"
    assert ticks[-1] == last
    assert len(ticks) <= 13


def test_stamps_before_the_start_are_drawn_at_the_edge(run):
    record = replace(told(run, ((0.0, "target", "tv", ""),)), start_ns=5 * S)
    assert gantt.picture(record).parts
