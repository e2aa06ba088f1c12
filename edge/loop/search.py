"""What is left where no candidate is: turning on the spot, trying again, looking again."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from edge.host.checkpoint import Arrays
from edge.loop.candidates import CandidatePool
from edge.mapping.coverage import Viewpoint
from edge.mapping.grid import RollingMap
from edge.perception.tracking.instances import InstanceTracker
from edge.policies.base import Context

# With nowhere to go for so long the robot turns on the spot, so often to come round.
TURN_AFTER_NS, TURNS = 1_000_000_000, 3
# From afar the rim of what is known flickers: a frontier that turns up later has to last.
LASTING_NS = 2_000_000_000
# Where the robot was held up is tried again for so long at least: a frontier that comes to
# light there is gone to once it has lasted, and shows a tick or two after the opening.
_RETRY_NS = LASTING_NS + 1_000_000_000
# It is tried so often, and so long after the last time: who stood there may have gone.
_RETRIES, _PAUSE_NS = 2, 10_000_000_000
# A frontier left so often for another, or because it vanished, before the robot came there, shows
# from afar alone or is farther than it looks: then it is seen through, or left alone.
_FICKLE, _SAME_M, LEFT = 3, 0.6, 64
_SAME_PLACE_M = 0.3  # goals this near to one another are for standing at one place


@dataclass(slots=True, eq=False)
class Search:
    """What was tried to get to one target.

    Attributes:
        exhausted: nothing was left to go to, and turning on the spot showed nothing new. What
            turns up since is gone to, but the robot does not turn after it.
        left: places of frontiers that were left before the robot came there.
    """

    exhausted: bool = False
    left: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=LEFT))
    _turns: int = 0  # since there was something to go to
    _idle_since_ns: int | None = None
    _second_chance: bool = False
    _missed: tuple[int, tuple[float, float]] | None = None
    _retry: tuple[int, int] | None = None  # reach generation and time that end it
    _retries: int = 0
    _next_retry_ns: int = 0

    def state_dict(self) -> Arrays:
        """Return what is held against places, but nothing that takes only seconds."""
        missed = () if self._missed is None else ((self._missed[0], *self._missed[1]),)
        return {
            "exhausted": np.array(self.exhausted),
            "turns": np.array(self._turns),
            "second_chance": np.array(self._second_chance),
            "left_m": np.array(self.left, np.float64).reshape(-1, 2),
            "missed": np.array(missed, np.float64).reshape(-1, 3),
        }

    @classmethod
    def of_state_dict(cls, state: Arrays) -> Search:
        """Make it again from a `state_dict` that was checked."""
        search = cls(bool(state["exhausted"]))
        search.left.extend((x, y) for x, y in state["left_m"].tolist())
        search._turns, search._second_chance = int(state["turns"]), bool(state["second_chance"])
        for i, x, y in state["missed"].tolist():
            search._missed = (int(i), (x, y))
        return search

    def fickle(self, xy_m: tuple[float, float]) -> bool:
        """Whether a frontier was left too often before the robot came there."""
        return sum(math.dist(xy_m, left) < _SAME_M for left in self.left) >= _FICKLE

    def missed(self, instance_id: int, at_m: tuple[float, float]) -> bool:
        """An instance turned out to be out of reach from a place; whether it was so before."""
        before, self._missed = self._missed, (instance_id, at_m)
        return (
            before is not None
            and before[0] == instance_id
            and math.dist(before[1], at_m) <= _SAME_PLACE_M
        )

    def found(self) -> None:
        """There is something to go to."""
        self._idle_since_ns = None
        if not self.exhausted:
            self._turns = 0

    def may_turn(self, turning: bool, now_ns: int) -> bool:
        """Whether the robot turns on the spot: the space behind may never have been seen.

        Args:
            turning: whether it is about that already.
        """
        if self.exhausted:
            return False
        if self._idle_since_ns is None:
            self._idle_since_ns = now_ns
        if turning:
            return True
        if now_ns - self._idle_since_ns < TURN_AFTER_NS:
            return False
        if self._turns == TURNS:
            self.exhausted = True
            return False
        self._turns += 1
        return True

    def turned(self, now_ns: int) -> None:
        """A turn is done, or failed."""
        self._idle_since_ns = now_ns

    def trying_again(
        self, context: Context, grid: RollingMap, pool: CandidatePool, tracker: InstanceTracker
    ) -> bool:
        """Try again what was given up; return whether that may yet come to something.

        Discarded candidates and rejected objects get one more chance. Where the robot was held up
        the map is opened, up to twice.
        """
        first, self._second_chance = not self._second_chance, True
        if first:
            pool.lift_discards()
            tracker.forget_refuted(context.target)
        if self._retry is not None:
            generation, until_ns = self._retry
            if grid.reach.generation < generation or context.now_ns < until_ns:
                return True
            self._retry = None
        if self._retries == _RETRIES or not grid.bumps.closed_m:
            return first
        if context.now_ns >= self._next_retry_ns:  # doors open, and people go
            grid.bumps.open_all()
            pool.lift_discards()
            self._retries += 1
            self._next_retry_ns = context.now_ns + _PAUSE_NS
            # The travel-cost field that is growing may have begun before; the next one leads there.
            self._retry = (grid.reach.generation + 2, context.now_ns + _RETRY_NS)
        return True


class NextBestView:
    """Looking again, from near by, at what the detector saw badly: one view after another, until
    none is worth a goal; each is tried once.

    Args:
        enough: images of the detector, for which the robot stays at a view.

    Attributes:
        enough: the same; may be set.
        done: there is nothing left that could be seen better.
        views: how many views the robot has seen, from where they are or on the way there.
    """

    def __init__(self, enough: int) -> None:
        self.done = False
        self.views = 0
        self.enough = enough
        self._view: Viewpoint | None = None
        self._searching = self._given_up = False
        self._came_at: int | None = None  # the detector's count of images when the robot came

    def choose(self, grid: RollingMap, images: int) -> Viewpoint | None:
        """The view to go to; None while it is being searched for, and when there is none.

        Args:
            images: how many the detector has searched so far.
        """
        if self._view is not None and (self._over(images) or not grid.coverage.worth(self._view)):
            grid.coverage.write_off(self._view)
            self.views += not self._given_up
            self.drop()
        if self._view is None and not self.done:
            self._search(grid)
        return self._view

    def came(self, images: int) -> None:
        """The robot stands at the present view."""
        if self._came_at is None:
            self._came_at = images

    def give_up(self) -> None:
        """The robot does not get to the present view."""
        self._given_up = True

    def start_over(self) -> None:
        """Another mission: no view of it has been seen."""
        self.drop()
        self.views = 0

    def drop(self) -> None:
        """Leave the present view; what it shows may be sought again."""
        self._view = self._came_at = None
        self.done = self._searching = self._given_up = False

    def _over(self, images: int) -> bool:
        stayed = self._came_at is not None and images - self._came_at >= self.enough
        return stayed or self._given_up

    def _search(self, grid: RollingMap) -> None:
        coverage = grid.coverage
        if not self._searching:
            coverage.start_over()
        self._searching = True
        if not coverage.search(grid.reach):
            return
        view, self._searching = coverage.view, False
        if view is None:
            self.done = True
        elif coverage.worth(view):
            self._view = view
        else:  # rays that just missed a cell's corner
            coverage.write_off(view)
