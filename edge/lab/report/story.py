"""Mission section of a report's page: the instruction, its translation, and the outcome."""

from __future__ import annotations

from html import escape

from edge.lab.report import automaton_graph, canvas
from edge.lab.report.record import RunRecord
from edge.live.automaton_graph import make_automaton_graph
from edge.loop.result import MissionFacts
from edge.text import shorten

MAX_TEXT = 4000  # characters


def section(record: RunRecord) -> str:
    """Return the mission's HTML; empty if the run was only asked to find one target."""
    facts = record.mission_facts
    if facts is None:
        return ""
    translation, automaton = facts.spec.translation, facts.spec.automaton
    if record.has_single_target and translation.backend == "target":
        return ""
    pairs = [
        ("asked", translation.instruction),
        ("understood as", f"{translation.english} ({translation.backend})"),
        ("formula", str(automaton.formula)),
        ("reached", ", then ".join(step.label for step in record.reached) or "nothing"),
    ]
    if steps_left := _steps_left(facts):
        pairs.append(("left to reach", ", then ".join(a or "nothing" for a in steps_left)))
    rows = "".join(
        f"<dt>{escape(k)}</dt><dd{_class(k)}>{escape(shorten(v, MAX_TEXT))}</dd>" for k, v in pairs
    )
    drawing = "" if record.has_single_target else _automaton(facts)
    return f'<section><h2>Mission</h2><dl class="story">{rows}</dl>{drawing}</section>'


def _steps_left(facts: MissionFacts) -> tuple[str, ...]:
    """Return the plan's targets; empty if the mission is fulfilled, when the last plan is old."""
    return () if facts.spec.automaton.accepting[facts.state] else facts.plan.steps


def _class(key: str) -> str:
    return ' class="formula"' if key == "formula" else ""


def _automaton(facts: MissionFacts) -> str:
    """Return the drawing of the mission's automaton."""
    automaton = facts.spec.automaton
    scene = make_automaton_graph(automaton, facts.state, _steps_left(facts), facts.trace)
    title = f"Automaton with {automaton.n_states} states, now in state {facts.state}"
    alternative = "; ".join([title, *(part.title for part in (*scene.arrows, *scene.nodes))])
    drawing = canvas.img(automaton_graph.draw(scene), alternative)
    return (
        f'<h2>Automaton</h2><div class="drawing">{drawing}</div>'
        '<p class="note">Blue disc: the '
        "state at the end. Green: the way there. Blue arrows: the plan from there. Double ring: "
        "the mission is fulfilled. The robot follows an arrow by reaching an object named on it."
        "</p>"
    )
