"""The part of the page that is about the mission: what was asked, understood and done."""

from __future__ import annotations

from html import escape

from edge.report import canvas, drawing, gantt
from edge.report.record import RunRecord, Story
from edge.report.scene import make_scene
from edge.text import shorten

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
    axes = gantt.draw(record)
    if axes is None:
        return ""
    return f'<div class="drawing">{canvas.img(axes, gantt.in_words(record))}</div>'


def _automaton(story: Story) -> str:
    scene = make_scene(story.automaton, story.state, story.plan, story.word)
    title = f"Automaton with {story.automaton.n_states} states, now in state {story.state}"
    words = "; ".join([title, *(part.title for part in (*scene.arrows, *scene.nodes))])
    return (
        f'<h2>Automaton</h2><div class="drawing">{canvas.img(drawing.draw(scene), words)}</div>'
        '<p class="note">Blue disc: the '
        "state at the end. Green: the way there. Blue arrows: the plan from there. Double ring: "
        "the mission is fulfilled. An arrow is taken by reaching one of the things beside it.</p>"
    )
