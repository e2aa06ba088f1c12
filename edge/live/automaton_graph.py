"""Graph of an automaton to draw: selection of states, transitions and labels.

In each step one proposition of the formula is true, or `NOTHING`. Steps that lead from one state to
the same next state share an arrow. Two kinds of steps have no arrow: those that keep the state, and
fatal ones, which make success impossible. The state lists its fatal steps ("not tv"). So a step
that is neither on an arrow nor in that list changes nothing, and the drawing is complete.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from edge.mission.logic.automaton import NOTHING, Automaton
from edge.text import shorten

MAX_WHOLE = 40  # automata with at most this many states are drawn completely
MAX_PART = 26  # states that are drawn of a larger automaton
MAX_ARROWS = 160  # more are unreadable
LABEL_LENGTH = 22  # characters in a line of an arrow's label
CAPTION_LENGTH = 15  # characters in a line below a state
MAX_LINES = 3  # lines of a label or caption
_NO_BREAK = "\u00a0"

Role = Literal["other", "visited", "plan"]


class StateNode(NamedTuple):
    """A state.

    Attributes:
        state: number of the state in the automaton.
        accepting: True if the mission succeeds here.
        dead: True if success is impossible from here.
        forbidden: lines with the steps that are fatal here.
        hidden: number of next states that are not shown.
        title: a full description in one sentence.
    """

    state: int
    initial: bool
    accepting: bool
    dead: bool
    current: bool
    forbidden: tuple[str, ...]
    hidden: int
    title: str


class StateArrow(NamedTuple):
    """A transition.

    Attributes:
        source: index in `AutomatonGraph.nodes` of the state where the transition begins.
        target: index of the state where the transition ends.
        lines: label, line by line.
        title: a full description in one line.
        role: `visited`: taken by the robot; `plan`: planned; `other`.
    """

    source: int
    target: int
    lines: tuple[str, ...]
    title: str
    role: Role


class AutomatonGraph(NamedTuple):
    """The graph.

    Attributes:
        nodes: the initial state first; if it is not shown, the current one.
        arrows: transitions between the nodes.
        note: legend, and a sentence about what is left out.
    """

    nodes: tuple[StateNode, ...]
    arrows: tuple[StateArrow, ...]
    note: str


def make_automaton_graph(
    automaton: Automaton,
    state: int | None = None,
    plan: Sequence[str] = (),
    path: Sequence[str] = (),
) -> AutomatonGraph:
    """Select the states and transitions to draw.

    Args:
        automaton: the automaton.
        state: the current state, which is marked; None: no mark.
        plan: planned trace from `state` (or the initial state).
        path: trace so far, from the initial state.
    """
    visited = _walk(automaton, 0, path)
    planned = _walk(automaton, 0 if state is None else state, plan)
    shown = _choose_states(automaton, state, planned, visited)
    index = {s: i for i, s in enumerate(shown)}  # state → index of its node
    # (state, next state) → role, and the step that was taken. The plan overrides the past.
    roles = _roles(visited, path, "visited") | _roles(planned, plan, "plan")
    nodes, arrows = [], []
    for s in shown:
        next_states = transitions_from(automaton, s)
        fatal = [] if automaton.is_dead(s) else _fatal_steps(automaton, s)
        hidden = [t for t in next_states if t not in index and not automaton.is_dead(t)]
        nodes.append(_node(automaton, s, s == state, fatal, len(hidden)))
        for t, steps in next_states.items():
            if t not in index or (automaton.is_dead(t) and (s, t) not in roles):
                continue  # not shown, or fatal and not taken
            arrows.append(_arrow(automaton, (s, t), steps, index, roles))
    return AutomatonGraph(tuple(nodes), tuple(arrows), _note(automaton, shown, nodes))


def _walk(automaton: Automaton, state: int, trace: Sequence[str]) -> list[int]:
    """Return the states that a trace leads through, from this state on."""
    states = [state]
    for step in trace:
        states.append(automaton.step(states[-1], step))
    return states


def _roles(
    states: Sequence[int], trace: Sequence[str], role: Role
) -> dict[tuple[int, int], tuple[Role, str]]:
    """Return the role of each transition along a path, and the step that takes it."""
    return {pair: (role, step) for pair, step in zip(pairwise(states), trace, strict=True)}


def transitions_from(automaton: Automaton, state: int) -> dict[int, list[str]]:
    """Return next states with the steps that lead there, without steps that change nothing."""
    next_states: dict[int, list[str]] = {}
    for step, to in automaton.edges(state):
        if to != state:
            next_states.setdefault(to, []).append(step)
    return next_states


def _fatal_steps(automaton: Automaton, state: int) -> list[str]:
    """Return the steps that lead from this state to one from which success is impossible."""
    return [step for step, to in automaton.edges(state) if automaton.is_dead(to)]


def _choose_states(
    automaton: Automaton, state: int | None, planned: Sequence[int], visited: Sequence[int]
) -> list[int]:
    """Return the states to draw: all of a small automaton, or those near the current state.

    States without a way to success are drawn only if the robot is in one, was in one, or started in
    one.
    """
    current = 0 if state is None else state
    # `steps_left`: fewest objects to reach until success; -1 if success is impossible.
    hopeful = np.flatnonzero(automaton.steps_left >= 0).tolist()
    wanted = list(dict.fromkeys((current, *planned, *reversed(visited))))
    complete = list(dict.fromkeys((0, *wanted, *hopeful)))
    if len(hopeful) <= MAX_WHOLE and _arrows_among(automaton, complete) <= MAX_ARROWS:
        return complete
    # The states that must be shown, then level by level those that follow them.
    part = wanted[:MAX_PART]
    while len(part) > 1 and not _is_readable(automaton, part):
        part.pop()
    level = part[:1]
    while level:
        is_first = level == [current]
        next_states = (
            t for s in level for t in transitions_from(automaton, s) if not automaton.is_dead(t)
        )
        level = [t for t in dict.fromkeys(next_states) if t not in part]
        while level and not _is_readable(automaton, [*part, *level]):
            # Show at least some of the next states; of later ones all or none.
            level = level[:-1] if is_first else []
        part += level
    # The initial state (0) comes first, then the current one.
    return sorted(part, key=lambda s: (s != 0, s != current)) if 0 in part else part


def _is_readable(automaton: Automaton, part: Sequence[int]) -> bool:
    return len(part) <= MAX_PART and _arrows_among(automaton, part) <= MAX_ARROWS


def _arrows_among(automaton: Automaton, states: Sequence[int]) -> int:
    """Return the number of arrows between the states: pairs of states with a transition."""
    inside = set(states)
    return sum(len(inside.intersection(automaton.delta[s].tolist()) - {s}) for s in states)


def _node(
    automaton: Automaton, state: int, current: bool, fatal: Sequence[str], hidden: int
) -> StateNode:
    """Return the node of a state, with its caption and description."""
    accepting, left = bool(automaton.accepting[state]), int(automaton.steps_left[state])
    parts = [f"state {state}"]
    parts += ["the robot is here"] if current else []
    parts += ["accepting"] if accepting else []
    parts += ["success impossible"] if left < 0 else []
    parts += [f"at least {left} to reach"] if left > 0 else []
    parts += [f"not {', '.join(map(_step_text, fatal))}"] if fatal else []
    parts += [f"{hidden} more next states, not shown"] if hidden else []
    caption = f"not {format_steps(fatal, automaton.propositions)}"
    words = wrap(caption, CAPTION_LENGTH) if fatal else ()
    return StateNode(
        state, state == 0, accepting, left < 0, current, words, hidden, "; ".join(parts)
    )


def _arrow(
    automaton: Automaton,
    ends: tuple[int, int],
    steps: Sequence[str],
    index: Mapping[int, int],
    roles: Mapping[tuple[int, int], tuple[Role, str]],
) -> StateArrow:
    """Return the arrow between two states, labelled with its steps."""
    role, taken = roles.get(ends, ("other", ""))
    title = f"{ends[0]} to {ends[1]}: {', '.join(map(_step_text, steps))}"
    if taken in steps and role != "other":  # name the step that was taken first
        words = ", ".join(map(_step_text, dict.fromkeys((taken, *steps))))
    else:
        words = format_steps(steps, automaton.propositions)
    return StateArrow(index[ends[0]], index[ends[1]], wrap(words), title, role)


def _note(automaton: Automaton, shown: Collection[int], nodes: Sequence[StateNode]) -> str:
    """Return the legend for what is drawn."""
    parts = []
    left_out = set(np.flatnonzero(automaton.steps_left >= 0).tolist()) - set(shown)
    if left_out:
        parts.append(f"{len(shown)} of {automaton.n_states} states shown.")
    if any(node.forbidden for node in nodes):
        parts.append('"not …": reaching it there makes success impossible.')
    if any(node.dead for node in nodes):
        parts.append("Dashed: success is impossible.")
    if any(node.hidden for node in nodes):
        parts.append('"+ …": next states that are not shown.')
    return " ".join([*parts, "Names that a state does not list change nothing there."])


def format_steps(steps: Sequence[str], propositions: Sequence[str]) -> str:
    """Format some of the propositions, and possibly `NOTHING`, as a short list.

    >>> format_steps(["chair", ""], ["chair", "tv"])
    'chair, nothing'
    >>> format_steps(["a", "b", "c", "d"], ["a", "b", "c", "d", "e"])
    'all but e'
    """
    names = [step for step in steps if step != NOTHING]
    others = [name for name in propositions if name not in set(names)]
    nothing = len(names) < len(steps)
    if nothing and not others:
        return "anything or nothing"
    words = ", ".join(map(_step_text, names))
    if len(names) > 3 and len(others) <= 2:
        words = (
            f"all but {', '.join(map(_step_text, others))}" if others else f"any of {len(names)}"
        )
    return ", ".join(part for part in (words, _step_text(NOTHING) if nothing else "") if part)


def _step_text(step: str) -> str:
    return "nothing" if step == NOTHING else shorten(step, 60)


def wrap(words: str, length: int = LABEL_LENGTH) -> tuple[str, ...]:
    """Break a list at its commas into at most `MAX_LINES` lines of about `length` characters.

    >>> wrap("potted plant, television, sofa")
    ('potted plant,', 'television, sofa')
    """
    items = [shorten(item, length).replace(" ", _NO_BREAK) for item in words.split(", ")]
    lines = textwrap.wrap(
        ", ".join(items), length + 1, max_lines=MAX_LINES, placeholder=" …",
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return tuple(line.replace(_NO_BREAK, " ") for line in lines)
