"""What a compilation may take: states and seconds."""

from __future__ import annotations

import time

from edge.errors import UserError


class CompileError(UserError):
    """A formula whose automaton is too big, or takes too long."""


class Limits:
    """The limits of one compilation; the clock starts when this is made."""

    def __init__(self, max_states: int, limit_s: float) -> None:
        self.max_states = max_states
        self.limit_s = limit_s
        self._end_s = time.perf_counter() + limit_s

    def check_time(self) -> None:
        """Raises CompileError once the time is up."""
        if time.perf_counter() > self._end_s:
            raise CompileError(
                f"formula: no automaton within {self.limit_s:g} s; "
                "use fewer targets or constraints, or raise the time limit"
            )

    def check_states(self, n: int) -> None:
        """Raises CompileError when there are more than the allowed states."""
        if n > self.max_states:
            raise CompileError(
                f"formula: its automaton needs more than {self.max_states} states; "
                "use fewer targets or constraints, or raise the limit of states"
            )
