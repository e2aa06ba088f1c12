"""Export of a whole automaton as Graphviz text, also for automata too large to draw here."""

from __future__ import annotations

from collections.abc import Sequence

from edge.lab.report.automaton_graph import CURRENT, STYLES
from edge.live.automaton_graph import format_letters, transitions_from
from edge.mission.logic.automaton import Automaton


def to_dot(automaton: Automaton, state: int | None = None, plan: Sequence[str] = ()) -> str:
    """Return the automaton as Graphviz text, for `dot`.

    A letter is a proposition that becomes true. Letters with the same next state share an edge, and
    letters that keep the state are left out. States without a path to success are grey, the current
    state is filled, and the plan's edges are bold.
    """
    at, planned = 0 if state is None else state, set()  # planned: (state, next state) pairs
    for letter in plan:
        at, before = automaton.step(at, letter), at
        planned.add((before, at))
    lines = [
        "digraph automaton {",
        '  rankdir=LR; node [shape=circle, fontname="sans-serif"];',
        '  edge [fontname="sans-serif"];',
        '  entry [shape=point, style=invis, label=""];',
        "  entry -> 0;",
    ]
    for s in range(automaton.n_states):
        attributes = {"label": str(s)}
        if automaton.accepting[s]:
            attributes["shape"] = "doublecircle"
        if automaton.is_dead(s):
            attributes.update(color="gray60", fontcolor="gray60", style="dashed")
        if s == state:
            attributes.update(style="filled", fillcolor=CURRENT, fontcolor="white")
        lines.append(f"  {s} [{_attribute_text(attributes)}];")
    for s in range(automaton.n_states):
        for to, letters in transitions_from(automaton, s).items():
            attributes = {"label": format_letters(letters, automaton.propositions)}
            if automaton.is_dead(to):
                attributes.update(color="gray60", fontcolor="gray60", style="dashed")
            if (s, to) in planned:
                attributes.update(color=STYLES["plan"].colour, penwidth="2.5")
            lines.append(f"  {s} -> {to} [{_attribute_text(attributes)}];")
    return "\n".join([*lines, "}", ""])


def _attribute_text(attributes: dict[str, str]) -> str:
    """Return attributes as Graphviz strings, in which a backslash starts an escape."""
    return ", ".join(
        '{}="{}"'.format(key, value.replace("\\", "\\\\").replace('"', '\\"'))
        for key, value in attributes.items()
    )
