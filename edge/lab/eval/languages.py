"""Whether two formulas mean the same, and if not, a word that tells them apart."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from edge.mission.logic.automaton import Automaton, compile_formula, shortest_word
from edge.mission.logic.ltl import Formula, postorder, weak_until

Word = tuple[str, ...]

_compiled = lru_cache(maxsize=8192)(compile_formula)


def difference(a: Formula, b: Formula, silent_end: bool = False) -> Word | None:
    """A shortest word that one formula accepts and the other does not; None when they agree.

    Args:
        silent_end: compare the words as if nothing more were ever reached after them. That is
            how a formula meant for endless words applies to a mission, which ends.

    Raises:
        CompileError: an automaton grows beyond the compiler's limits.
    """
    if a == b:
        return None
    first, second = _compiled(a), _compiled(b)
    accepts = [_accepting(automaton, silent_end) for automaton in (first, second)]
    return shortest_word(first, second, lambda s, t: bool(accepts[0][s] != accepts[1][t]))


def satisfiable(formula: Formula, silent_end: bool = False) -> bool:
    """Whether any word fulfils the formula."""
    return bool(_accepting(_compiled(formula), silent_end).any())


def with_weak_untils(formula: Formula) -> Formula:
    """The formula with `!x U y`, x and y propositions, read as `!x W y` ("not x until y")."""
    done: dict[int, Formula] = {}
    for node in postorder(formula):
        args = tuple(done[id(arg)] for arg in node.args)
        if node.op == "U" and _is_ban(args[0]) and args[1].op == "ap":
            done[id(node)] = weak_until(*args)
        else:
            done[id(node)] = Formula(node.op, args, node.name)
    return done[id(formula)]


def _is_ban(f: Formula) -> bool:
    return f.op == "!" and f.args[0].op == "ap"


def _accepting(automaton: Automaton, silent_end: bool) -> np.ndarray:
    """(n_states,) bool; with a silent end, whether it accepts after enough steps of nothing.

    Languages of LTLf are star-free, so repeating one letter always ends in one state.
    """
    if not silent_end:
        return automaton.accepting
    ends = np.arange(automaton.n_states)
    for _ in range(automaton.n_states):
        after = automaton.delta[ends, -1]
        if np.array_equal(after, ends):
            break
        ends = after
    return automaton.accepting[ends]
