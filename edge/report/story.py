"""The part of the page that is about the mission: what was asked, understood and done."""

from __future__ import annotations

from html import escape

from edge.report import gantt
from edge.report.automaton import draw_svg
from edge.report.drawing.shapes import shorten, svg
from edge.report.record import RunRecord, Story

MAX_TEXT = 4000


def section(record: RunRecord) -> str:
    """Nothing for a run that was told just to find one thing."""
    story = record.story
    if story is None or (story.simple and story.backend == "target"):
        return ""
    pairs = [
        ("asked", story.instruction),
        ("understood as", f"{story.english} ({story.backend})"),
        ("formula", story.formula),
        ("reached", ", then ".join(step.label for step in story.reached) or "nothing"),
    ]
    if story.plan:
        pairs.append(("left to reach", ", then ".join(a or "nothing" for a in story.plan)))
    rows = "".join(
        f"<dt>{escape(k)}</dt><dd{_class(k)}>{escape(shorten(v, MAX_TEXT))}</dd>" for k, v in pairs
    )
    drawings = "" if story.simple else _timeline(record) + _automaton(story)
    return f'<section><h2>Mission</h2><dl class="story">{rows}</dl>{drawings}</section>'


def _class(key: str) -> str:
    return ' class="formula"' if key == "formula" else ""


def _timeline(record: RunRecord) -> str:
    picture = gantt.picture(record)
    return f'<div class="drawing">{svg(picture)}</div>' if picture is not None else ""


def _automaton(story: Story) -> str:
    drawing = draw_svg(story.automaton, story.state, story.plan, story.word)
    return (
        f'<h2>Automaton</h2><div class="drawing">{drawing}</div><p class="note">Blue disc: the '
        "state at the end. Green: the way there. Blue arrows: the plan from there. Double ring: "
        "the mission is fulfilled. An arrow is taken by reaching one of the things beside it.</p>"
    )
