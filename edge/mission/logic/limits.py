"""What a compilation may take: states and steps, which are the same on every machine.

A step is a small piece of work, such as looking up a state's successor; what takes longer counts
as several, so that a step takes about as long wherever it is taken: 0.03 to 0.15 µs on a desktop
computer. Nothing here reads a clock, so that whether a mission is taken does not depend on how
busy the machine is.
"""

from __future__ import annotations

from edge.errors import UserError

MAX_STATES = 20_000
MAX_STEPS = 30_000_000

PER_NODE = 4  # of a node visited, and of each of its operands
_CELLS = 16


class CompileError(UserError):
    """A formula whose automaton is too big, or takes too much work."""


class Effort:
    """The work of one compilation, or of several together, and how much of it is allowed.

    Attributes:
        steps: taken until now.
    """

    def __init__(self, max_states: int = MAX_STATES, max_steps: int = MAX_STEPS) -> None:
        self.max_states = max_states
        self.max_steps = max_steps
        self.steps = 0

    def spend(self, steps: int) -> None:
        """Count steps that are about to be taken; CompileError where they are too many."""
        self.steps += steps
        if self.steps > self.max_steps:
            raise CompileError(
                f"formula: no automaton within {self.max_steps} steps; use fewer targets or "
                "constraints, or raise mission.compile_limit_steps"
            )

    def spend_cells(self, cells: int) -> None:
        """Count work on whole arrays, of which a step does `_CELLS` at once."""
        self.spend(1 + cells // _CELLS)

    def check_states(self, n: int) -> None:
        """Raises CompileError when there are more than the allowed states."""
        if n > self.max_states:
            raise CompileError(
                f"formula: its automaton needs more than {self.max_states} states; use fewer "
                "targets or constraints, or raise mission.max_states"
            )
