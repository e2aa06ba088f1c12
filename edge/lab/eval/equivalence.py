"""Compares the languages of two formulas, and finds a trace on which they differ."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from edge.mission.logic.automaton import Automaton, compile_formula, shortest_trace
from edge.mission.logic.ltl import Formula, postorder, weak_until

Trace = tuple[str, ...]
"""Propositions in the order in which they become true."""

_compiled = lru_cache(maxsize=8192)(compile_formula)


def distinguishing_trace(a: Formula, b: Formula, silent_end: bool = False) -> Trace | None:
    """Return a shortest trace that only one of the formulas accepts; None if they are equivalent.

    With `silent_end`, traces are compared as if nothing more were ever reached after them. A
    formula for infinite traces applies to a mission, which ends, in this way.

    Raises:
        CompileError: an automaton grows beyond the compiler's limits.
    """
    if a == b:
        return None
    first, second = _compiled(a), _compiled(b)
    accepts = [_accepting(automaton, silent_end) for automaton in (first, second)]
    return shortest_trace(first, second, lambda s, t: bool(accepts[0][s] != accepts[1][t]))


def satisfiable(formula: Formula) -> bool:
    """Return True if any trace with a silent end fulfils the formula."""
    return bool(_accepting(_compiled(formula), silent_end=True).any())


def with_weak_untils(formula: Formula) -> Formula:
    """Return the formula with each `!x U y` of two propositions replaced by the weak `!x W y`."""
    done: dict[int, Formula] = {}
    for node in postorder(formula):
        args = tuple(done[id(arg)] for arg in node.args)
        if node.op == "U" and _is_ban(args[0]) and args[1].op == "ap":
            done[id(node)] = weak_until(*args)
        else:
            done[id(node)] = Formula(node.op, args, node.name)
    return done[id(formula)]


def _is_ban(formula: Formula) -> bool:
    """Return True for `!x` of a proposition x."""
    return formula.op == "!" and formula.args[0].op == "ap"


def _accepting(automaton: Automaton, silent_end: bool) -> np.ndarray:
    """Return (n_states,) bool: the accepting states.

    With a silent end, a state counts if it accepts after enough steps in which nothing is reached.
    Repeating such a step always ends in one state, never in a cycle of several: formulas of LTL on
    finite traces have star-free languages.
    """
    if not silent_end:
        return automaton.accepting
    ends = np.arange(automaton.n_states)
    for _ in range(automaton.n_states):
        after = automaton.delta[ends, -1]  # last column: nothing is reached
        if np.array_equal(after, ends):
            break
        ends = after
    return automaton.accepting[ends]
