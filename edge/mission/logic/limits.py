"""Limits of a compilation in states and steps; they are the same on every machine.

A step is a small piece of work, such as looking up the successor of a state. Longer work counts as
several steps. A step takes 0.03 to 0.15 µs on a desktop computer. No clock is read, so the load
of the machine does not decide if a mission is accepted.
"""

from __future__ import annotations

from edge.errors import UserError

MAX_STATES = 20_000
"""Limit of the states of each automaton."""
MAX_STEPS = 30_000_000
"""Limit of the steps of all compilations together."""

PER_NODE = 4  # steps to visit a node, and to visit each of its operands
_CELLS = 16  # array cells that NumPy processes in one step


class CompileError(UserError):
    """A formula whose automaton is too large or takes too much work."""


class CompileBudget:
    """The limits of one or several compilations, and the steps used so far."""

    def __init__(self, max_states: int = MAX_STATES, max_steps: int = MAX_STEPS) -> None:
        self.max_states = max_states
        self.max_steps = max_steps
        self.steps = 0

    def spend(self, steps: int) -> None:
        """Count steps before they are taken; raise CompileError above the limit."""
        self.steps += steps
        if self.steps > self.max_steps:
            raise CompileError(
                f"formula: not compiled within {self.max_steps} steps; use fewer targets or "
                "constraints"
            )

    def spend_cells(self, cells: int) -> None:
        """Count work on entire arrays, at `_CELLS` cells per step."""
        self.spend(1 + cells // _CELLS)

    def check_states(self, n: int) -> None:
        """Raise CompileError if the number of states is above the limit."""
        if n > self.max_states:
            raise CompileError(
                f"formula: needs an automaton of more than {self.max_states} states; use fewer "
                "targets or constraints"
            )
