"""An automaton for other programs, whole: networkx and Graphviz."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from edge.mission.automaton import NOTHING, Automaton
from edge.report.drawing import CURRENT, STYLES
from edge.report.scene import in_words

if TYPE_CHECKING:
    import networkx as nx


def to_networkx(automaton: Automaton) -> nx.MultiDiGraph:
    """The whole automaton: an edge for each state and letter, `NOTHING` ("") included.

    Nodes are states with `accepting`, `dead`, `initial` (bool) and `steps_left` (int, -1 where
    success is impossible); edges have `letter`, which is their key too.
    """
    import networkx

    graph = networkx.MultiDiGraph(letters=automaton.letters, formula=str(automaton.formula))
    for state in range(automaton.n_states):
        left = int(automaton.steps_left[state])
        accepting = bool(automaton.accepting[state])
        graph.add_node(
            state, accepting=accepting, dead=left < 0, steps_left=left, initial=state == 0
        )
    letters = (*automaton.letters, NOTHING)
    for state, row in enumerate(automaton.delta.tolist()):
        for letter, to in zip(letters, row, strict=True):
            graph.add_edge(state, to, key=letter, letter=letter)
    return graph


def to_dot(automaton: Automaton, state: int | None = None, plan: Sequence[str] = ()) -> str:
    """The whole automaton as Graphviz text, for `dot`; letters with the same way share an edge.

    Letters that leave a state as it is are left out. States from which success is impossible are
    grey; the current state is filled, the plan's edges are bold.
    """
    letters = (*automaton.letters, NOTHING)
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
    for s, row in enumerate(automaton.delta.tolist()):
        ways: dict[int, list[str]] = {}
        for letter, to in zip(letters, row, strict=True):
            if to != s:
                ways.setdefault(to, []).append(letter)
        for to, those in ways.items():
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
