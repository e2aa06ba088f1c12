"""Receiver of goal statuses from the motion controller."""

from __future__ import annotations

import logging

import zenoh

from edge.bus import topics
from edge.bus.session import Ring
from edge.config import ZenohConfig
from edge.geometry import FARTHEST_M
from edge.text import bounded_repr, one_line, read_json_object
from edge.types import GoalStatus

log = logging.getLogger("edge.sources.goal_status")

STATES = ("accepted", "reached", "failed")
"""Values of `state` in a message."""
_MAX_BYTES = 4096  # of a message
_RING_MESSAGES = 64


def parse_goal_status(payload: bytes) -> GoalStatus:
    """Parse `{"stamp": <the goal's, ns>, "state": accepted | reached | failed, "reason": …}`.

    An optional `"blocked": [x, y]` (metres in `map`) is the place where the robot was blocked.

    Raises:
        ValueError: with one line that names the fault.
    """
    data = read_json_object(payload, _MAX_BYTES)
    stamp, state, reason = data.get("stamp"), data.get("state"), data.get("reason", "")
    if type(stamp) is float and stamp.is_integer():  # some encoders write 1.8e18
        stamp = int(stamp)
    if type(stamp) is not int:
        raise ValueError(f"stamp: expected an integer (ns), got {bounded_repr(stamp, 40)}")
    if state not in STATES:
        raise ValueError(f"state: unknown {bounded_repr(state, 40)} (choices: {', '.join(STATES)})")
    if not isinstance(reason, str):
        raise ValueError(f"reason: expected text, got {bounded_repr(reason, 40)}")
    return GoalStatus(stamp, state, one_line(reason), _parse_point(data.get("blocked")))


def _parse_point(blocked: object) -> tuple[float, float] | None:
    """Parse a point; raise ValueError if it is neither None nor a point."""
    if blocked is None:
        return None
    is_pair = isinstance(blocked, list) and len(blocked) == 2
    if not is_pair or not all(type(v) in (int, float) and abs(v) <= FARTHEST_M for v in blocked):
        raise ValueError(f"blocked: expected [x, y] in metres, got {bounded_repr(blocked, 40)}")
    return float(blocked[0]), float(blocked[1])


class GoalStatusInbox:
    """Receives goal statuses over Zenoh.

    Attributes:
        malformed: number of malformed messages.
    """

    def __init__(self, session: zenoh.Session, settings: ZenohConfig) -> None:
        self.malformed = 0
        self._ring = Ring(session, settings.key(topics.GOAL_STATUS.key), _RING_MESSAGES)

    @property
    def overruns(self) -> int:
        """Number of overruns; see `edge.bus.session.Ring`."""
        return self._ring.overruns

    def poll(self) -> list[GoalStatus]:
        """Return the statuses since the last poll, oldest first, at most one ring's length."""
        answers = []
        for sample in self._ring.take():
            try:
                answers.append(parse_goal_status(sample.payload.to_bytes()))
            except ValueError as error:
                self.malformed += 1
                if self.malformed == 1:
                    log.warning("goal_status: message ignored: %s; further ones are only counted",
                                error)  # fmt: skip
        return answers

    def close(self) -> None:
        self._ring.close()
