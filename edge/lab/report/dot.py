"""An automaton as Graphviz text, whole: for `dot`, and for automata too large to draw here."""

from __future__ import annotations

from collections.abc import Sequence

from edge.lab.report.drawing import CURRENT, STYLES
from edge.live.scene import in_words, ways_on
from edge.mission.logic.automaton import Automaton


def to_dot(automaton: Automaton, state: int | None = None, plan: Sequence[str] = ()) -> str:
    """The whole automaton as Graphviz text, for `dot`; letters with the same way share an edge.

    Letters that leave a state as it is are left out. States from which success is impossible are
    grey; the current state is filled, the plan's edges are bold.
    """
    at, planned = 0 if state is None else state, set()
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
        looks = {"label": str(s)}
        if automaton.accepting[s]:
            looks["shape"] = "doublecircle"
        if automaton.dead(s):
            looks.update(color="gray60", fontcolor="gray60", style="dashed")
        if s == state:
            looks.update(style="filled", fillcolor=CURRENT, fontcolor="white")
        lines.append(f"  {s} [{_looks(looks)}];")
    for s in range(automaton.n_states):
        for to, those in ways_on(automaton, s).items():
            looks = {"label": in_words(those, automaton.letters)}
            if automaton.dead(to):
                looks.update(color="gray60", fontcolor="gray60", style="dashed")
            if (s, to) in planned:
                looks.update(color=STYLES["plan"].colour, penwidth="2.5")
            lines.append(f"  {s} -> {to} [{_looks(looks)}];")
    return "\n".join([*lines, "}", ""])


def _looks(attributes: dict[str, str]) -> str:
    """Attributes as Graphviz's quoted strings, in which a backslash begins an escape."""
    return ", ".join(
        '{}="{}"'.format(key, value.replace("\\", "\\\\").replace('"', '\\"'))
        for key, value in attributes.items()
    )
