"""Time and path of a mission, for its limits."""

from __future__ import annotations

from collections.abc import Callable

from edge.geometry import SE2
from edge.mission.time_of_day import next_ns

# A longer or faster step of the pose between two calls is no driving.
_JUMP_M, _JUMP_MPS = 1.0, 4.0
_LONGEST_DAY_NS = 25 * 3_600_000_000_000  # the day of the change back from summer time


class MissionMeter:
    """Counts time and driven path of a mission, without pauses.

    Attributes:
        elapsed_s: time since the first observation.
        exempt_s: part of `elapsed_s` that does not count towards the limit: targets that end by
            themselves, and in a mission that repeats, earlier rounds.
        exempt_m: the same for `path_m`.
        pursued_s: for each target, the time for which it was pursued since it was last reached,
            failed or seen again.
        ends_ns: for each wait until a time of day, the loop time at which it ends.
        decide: makes a decision that depends on this computer; see `InputLog.record_decision`.
    """

    def __init__(self) -> None:
        self.elapsed_s = self.path_m = 0.0
        self.exempt_s = self.exempt_m = 0.0
        self.pursued_s: dict[str, float] = {}
        self.ends_ns: dict[str, int] = {}
        self.decide: Callable[[str, Callable[[], str]], str] = lambda what, decide: decide()
        self._last_ns: int | None = None
        self._last_pose: SE2 | None = None

    @property
    def running(self) -> bool:
        """True after the first `add`."""
        return self._last_ns is not None

    @property
    def limited(self) -> tuple[float, float]:
        """Time [s] and path [m] that count towards the limits."""
        return self.elapsed_s - self.exempt_s, self.path_m - self.exempt_m

    def add(
        self, pose: SE2 | None, now_ns: int, target: str | None, exempt: bool, searching: bool
    ) -> None:
        """Add the time and path since the last call.

        Args:
            pose: None while the pose is unknown; time counts in any case.
            now_ns: time of the loop.
            target: the pursued target; None if none is pursued, so that nothing counts.
            exempt: True if the target ends by itself.
            searching: False if the sensors see nothing. The time then does not count as search.
        """
        passed_s = 0.0 if self._last_ns is None else max(0, now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        step_m = 0.0
        if pose is not None:
            if self._last_pose is not None:
                step_m = self._last_pose.distance_to(pose.x_m, pose.y_m)
            self._last_pose = pose
        if target is None:
            return
        if step_m >= max(_JUMP_M, _JUMP_MPS * passed_s):
            step_m = 0.0
        self.elapsed_s += passed_s
        self.path_m += step_m
        if exempt:
            self.exempt_s += passed_s
            self.exempt_m += step_m
        if searching:
            self.pursued_s[target] = self.pursued_s.get(target, 0.0) + passed_s

    def end_of_wait_ns(self, target: str, time_of_day: str, now_ns: int) -> int:
        """Return the loop time at which a wait ends that began with the first call.

        It stays the same over pauses and restarts. So a wait whose time passed while the service
        was off ends at once.
        """
        ends_ns = self.ends_ns.get(target)
        # A later end is of another clock, for example of a simulation that began again.
        if ends_ns is None or ends_ns - now_ns > _LONGEST_DAY_NS:
            ends = self.decide(
                "wait", lambda: str(next_ns(time_of_day, now_ns))
            )  # by its time zone
            ends_ns = self.ends_ns[target] = int(ends)
        return ends_ns

    def end_pursuit(self, target: str) -> None:
        """Forget the time of a target that was reached or given up."""
        self.pursued_s[target] = 0.0
        self.ends_ns.pop(target, None)

    def begin_round(self) -> None:
        """Exempt all time and path so far, and begin each search again."""
        self.exempt_s, self.exempt_m = self.elapsed_s, self.path_m
        self.pursued_s.clear()
        self.ends_ns.clear()
