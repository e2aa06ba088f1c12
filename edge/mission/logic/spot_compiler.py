"""The compiler "spot": uses Spot (https://spot.lre.epita.fr) if its Python bindings are installed.

Spot reads formulas over infinite traces. `from_ltlf` embeds finite traces, with a proposition
`alive` that holds until the trace ends; `to_finite` removes it from the automaton (Spot's tutorial
"Working with LTL formulas with finite semantics"). Only steps with "one reached object or nothing"
are kept. Spot has no empty trace, so this module decides if it is accepted.

The package `spot` on the Python package index is another project; the package `spottl` has the
bindings (tested with 2.13). The work inside Spot is neither counted nor interrupted, only the work
after it. Use the compiler "own" for untrusted formulas.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from edge.errors import UnavailableError
from edge.mission.logic.compiler import minimise
from edge.mission.logic.limits import CompileBudget, CompileError
from edge.mission.logic.ltl import UNARY, Formula, postorder

_ALIVE = "alive"
_NEEDED = {
    "spot": ("formula", "from_ltlf", "translate", "to_finite"),
    "buddy": ("bdd_ithvar", "bdd_nithvar", "bddfalse", "bddtrue"),
}
# In Spot's LTLf, X is the weak next and X[!] the strong one.
_SPELLING = {"X": "X[!] ", "WX": "X "}
_MAX_DEPTH = 1000  # Spot recurses on the machine's stack


def missing() -> str:
    """Return what Spot lacks here, in words; "" if it can be used."""
    for name, wanted in _NEEDED.items():
        try:
            module = importlib.import_module(name)
        except (ImportError, OSError):
            return f"no module {name!r} is installed"
        absent = [attribute for attribute in wanted if not hasattr(module, attribute)]
        if absent:
            return f"the installed module {name!r} is not Spot's: it has no {absent[0]!r}"
    return ""


def available() -> bool:
    """Return True if Spot's Python bindings can be imported."""
    return not missing()


def minimal_automaton_by_spot(
    formula: Formula, propositions: Sequence[str], budget: CompileBudget
) -> tuple[np.ndarray, np.ndarray]:
    """Return the automaton, like `edge.mission.logic.compiler.minimal_automaton`, computed by Spot.

    Raises:
        UnavailableError: Spot is not installed.
        CompileError: a limit was exceeded, or the formula is nested too deep for Spot.
    """
    reason = missing()
    if reason:
        raise UnavailableError(
            f"compiler 'spot': {reason}; install Spot's Python bindings (package spottl or "
            "conda-forge's spot), or choose the compiler 'own'"
        )
    if _depth(formula) > _MAX_DEPTH:
        raise CompileError(
            f"formula: nested deeper than {_MAX_DEPTH}, too deep for the compiler 'spot'; "
            "choose 'own'"
        )
    spot, buddy = (importlib.import_module(name) for name in _NEEDED)
    embedded = spot.from_ltlf(spot.formula(_text(formula, propositions)), _ALIVE)
    finite = spot.to_finite(spot.translate(embedded, "buchi", "sbacc", "deterministic"), _ALIVE)
    steps = _step_conditions(finite, buddy, len(propositions))
    rows, accepting = _determinise(finite, steps, buddy.bddfalse, budget)
    # The empty trace may differ from other traces that lead to the initial state. So a copy of the
    # initial state comes first, and all numbers grow by 1.
    delta = np.array([rows[0], *rows], np.int32) + 1
    accepting = [_accepts_empty_trace(formula), *accepting]
    return minimise(delta, np.array(accepting), budget)


def _determinise(
    automaton, steps: list, impossible, budget: CompileBudget
) -> tuple[list[list[int]], list[bool]]:
    """Return the subset construction; a deterministic input keeps its states."""
    states = [frozenset({automaton.get_init_state_number()})]
    index = {states[0]: 0}
    rows: list[list[int]] = []
    accepting: list[bool] = []
    n = 0
    while n < len(states):
        row = []
        edges = [edge for state in states[n] for edge in automaton.out(state)]
        budget.spend(len(edges) * len(steps))
        for step in steps:
            target = frozenset(edge.dst for edge in edges if (edge.cond & step) != impossible)
            if target not in index:
                index[target] = len(states)
                states.append(target)
                budget.check_states(len(states))
            row.append(index[target])
        rows.append(row)
        accepting.append(any(automaton.state_is_accepting(state) for state in states[n]))
        n += 1
    return rows, accepting


def _step_conditions(automaton, buddy: ModuleType, n_propositions: int) -> list:
    """Return Spot's condition of each step: one proposition is true, or none (last)."""
    variables = [automaton.register_ap(f"p{k}") for k in range(n_propositions)]
    steps = []
    for true_one in range(n_propositions + 1):
        values = buddy.bddtrue
        for k, variable in enumerate(variables):
            literal = buddy.bdd_ithvar if k == true_one else buddy.bdd_nithvar
            values = values & literal(variable)
        steps.append(values)
    return steps


def _accepts_empty_trace(formula: Formula) -> bool:
    """Return True if the empty trace is accepted; on it, every temporal operator is a constant."""
    truth: dict[int, bool] = {}
    for f in postorder(formula):
        args = [truth[id(arg)] for arg in f.args]
        match f.op:
            case "!":
                holds = not args[0]
            case "&" | "|":
                holds = all(args) if f.op == "&" else any(args)
            case "->" | "<->":
                holds = args[0] == args[1] or (f.op == "->" and args[1])
            case _:
                holds = f.op in ("true", "WX", "G", "R", "W")
        truth[id(f)] = holds
    return truth[id(formula)]


def _text(formula: Formula, propositions: Sequence[str]) -> str:
    """Return the formula in Spot's syntax: propositions p0, p1 …, each operand in parentheses."""
    number = {name: k for k, name in enumerate(propositions)}
    out: list[str] = []
    todo: list[Formula | str] = [formula]
    while todo:
        f = todo.pop()
        if isinstance(f, str):
            out.append(f)
        elif f.op == "ap":
            out.append(f"p{number[f.name]}")
        elif not f.args:
            out.append(f.op)
        else:
            op = _SPELLING.get(f.op, f.op)
            pieces: list[Formula | str] = [op] if f.op in UNARY else []
            for k, arg in enumerate(f.args):
                pieces += [f" {op} "] if k else []
                pieces += ["(", arg, ")"]
            todo.extend(reversed(pieces))
    return "".join(out)


def _depth(formula: Formula) -> int:
    depth: dict[int, int] = {}
    for f in postorder(formula):
        depth[id(f)] = 1 + max((depth[id(arg)] for arg in f.args), default=0)
    return depth[id(formula)]
