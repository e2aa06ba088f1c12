"""Progress of a mission through its formula: the automaton's state, the trace and the round."""

from __future__ import annotations

from edge.mission.destinations import FailureTarget
from edge.mission.logic.automaton import NOTHING
from edge.mission.spec import MissionSpec


class MissionProgress:
    """The automaton's state and the trace that led to it, in the current round.

    Attributes:
        state: the automaton's state.
        trace: propositions that became true, oldest first; `NOTHING` is a step without one.
        round: number of the current round, from 1, of a mission that repeats.
    """

    def __init__(self, spec: MissionSpec) -> None:
        self.state = 0
        self.trace: tuple[str, ...] = ()
        self.round = 1
        self._spec = spec
        self._n_left_out = 0  # targets left out of rounds since one was reached
        destinations = spec.translation.destinations
        self._n_stops = sum(
            not isinstance(destinations.get(name), FailureTarget)
            for name in spec.automaton.possible
        )

    @property
    def accepted(self) -> bool:
        """True if the formula is fulfilled."""
        return bool(self._spec.automaton.accepting[self.state])

    @property
    def forbidden(self) -> tuple[str, ...]:
        """Targets that would make success impossible if they were reached now."""
        return tuple(label for label in self._spec.targets if self._is_forbidden(label))

    def advance(self, reached: str) -> None:
        """Take a step: a target was reached, or `NOTHING`."""
        if reached != NOTHING:
            self._n_left_out = 0
        self.state = self._spec.automaton.step(self.state, reached)
        self.trace = (*self.trace, reached)

    def leave_out(self, label: str) -> bool:
        """Leave out a target in this round, as if it had been reached.

        Return False, and do nothing, if that is not possible: the mission does not repeat, the
        target is forbidden now, or all others were left out since one was reached.
        """
        n_left_out = self._n_left_out
        if self._spec.translation.repeat is None or n_left_out >= self._n_stops - 1:
            return False
        if self._is_forbidden(label):
            return False
        self.advance(label)
        self._n_left_out = n_left_out + 1
        return True

    def begin_round(self) -> None:
        """Begin the next round."""
        self.round += 1
        self.state, self.trace = 0, ()

    def _is_forbidden(self, label: str) -> bool:
        automaton = self._spec.automaton
        return automaton.is_dead(automaton.step(self.state, label))
