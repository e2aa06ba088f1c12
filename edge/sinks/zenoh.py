"""Goals, map, mission, status and latency over Zenoh.

The loop only puts things into a mailbox; encoding and sending happen on the mailbox's thread.
A goal goes out every 0.5 s until it is answered, then every second until it is settled, so that a
controller that was behind or starts anew finds it. The mission goes out when it changes and every
second, so that whoever joins late learns of it within a second; nothing needs to be asked for.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import zenoh

from edge.bus import topics
from edge.bus.session import declare_publisher
from edge.bus.wire import messages
from edge.config import Config
from edge.sinks import SinkBase
from edge.sinks.mailbox import Mailbox
from edge.types import Goal, GoalStatus, MissionStatus, Observation

if TYPE_CHECKING:
    from edge.loop.service import Service

UNANSWERED_S = 0.5
UNSETTLED_S = 1.0
MISSION_S = 1.0
LATENCY_HZ = 1.0
_CLOSE_S = 1.0

WRITTEN = tuple(topic for topic in topics.ALL if topic.writer == "service")


class Snapshot(Protocol):
    """A copy of the map: (h, w) int8 cells, the corner of cell (0, 0), metres a cell."""

    cells: np.ndarray
    origin_xy_m: tuple[float, float]
    resolution_m: float


@dataclass(slots=True)
class _Repeated:
    """Something that is sent again; touched by the mailbox's thread only."""

    payload: bytes
    period_s: float
    due_s: float
    stamp_ns: int = 0


class ZenohSink(SinkBase):
    """Publishes what the service writes; no method blocks.

    In lockstep everything leaves in order and nothing is dropped, so that whoever sees a tick has
    the goal and the map that came with it.
    """

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        lockstep = config.loop.lockstep
        self._lockstep = lockstep
        self._publishers = {
            topic.key: declare_publisher(
                session, replace(topic, qos="block") if lockstep else topic, config.zenoh
            )
            for topic in WRITTEN
        }
        self._repeated: dict[str, _Repeated] = {}
        self._repeat_s = {"goal": UNANSWERED_S, "mission": MISSION_S}
        if lockstep:
            # The simulated clock stands still until the controller, which may come late, has the
            # tick, and before it the map.
            self._repeat_s["tick"] = UNANSWERED_S
        self._last_map = b""
        self._period_ns = {
            "map": int(1e9 / config.report.map_hz),
            "status": int(1e9 / config.report.status_hz),
            "latency": int(1e9 / LATENCY_HZ),
        }
        self._last_ns: dict[str, int] = {}
        self._mission: tuple[str, str, str] | None = None
        self._mailbox = Mailbox("zenoh-sink", self._deliver, self._repeat)

    # -- what the loop calls (see `edge.sinks.Sink`) --------------------------------------------

    def goal(self, goal: Goal) -> None:
        self.publish_goal(goal)

    def answered(self, answer: GoalStatus) -> None:
        self.goal_answered(answer.stamp_ns, settled=answer.state != "accepted")

    def tick(self, service: Service, observation: Observation | None, now_ns: int) -> None:
        if self._is_due("map", now_ns):
            self.publish_map(now_ns, service.grid.snapshot)
        if self._is_due("status", now_ns):
            self.publish_status(service.status_dict())
        if self._is_due("latency", now_ns):
            self.publish_latency(lambda: service.latency.report().as_dict())
        status = service.status
        if (status.target, status.phase, status.reason) != self._mission:
            self._mission = (status.target, status.phase, status.reason)
            self.publish_mission(status)
        if self._lockstep and observation is not None:
            self.publish_tick(observation.stamp_ns)

    def close(self) -> None:
        """Send what is left; gives up after a second, for a stopped peer may block lockstep."""
        if self._mailbox.close(_CLOSE_S):
            for publisher in self._publishers.values():
                publisher.undeclare()

    # -- what goes out --------------------------------------------------------------------------

    def publish_goal(self, goal: Goal) -> None:
        """Send a goal and keep sending it; it takes the place of the one before."""
        self._put("goal", goal)

    def goal_answered(self, stamp_ns: int, settled: bool = True) -> None:
        """Stop sending a goal, or only send it less often while it is not `settled`."""
        self._mailbox.queue("answered", (stamp_ns, settled))

    def publish_map(self, stamp_ns: int, snapshot: Callable[[], Snapshot]) -> None:
        """`snapshot` is called on the mailbox's thread: copying a large map takes too long for a
        tick. In lockstep it is called at once, since the map must be the one of this tick."""
        if self._lockstep:
            taken = snapshot()
            self._put("map", (stamp_ns, lambda: taken))
        else:
            self._put("map", (stamp_ns, snapshot))

    def publish_status(self, status: dict[str, Any]) -> None:
        self._put("status", status)

    def publish_latency(self, report: Callable[[], dict[str, Any]]) -> None:
        """`report` is called on the mailbox's thread: percentiles take longer than a tick may."""
        self._put("latency", report)

    def publish_mission(self, status: MissionStatus) -> None:
        self._put("mission", status)

    def publish_tick(self, stamp_ns: int) -> None:
        """Say that the observation of this stamp has been dealt with."""
        self._put("tick", stamp_ns)

    # -- on the mailbox's thread ------------------------------------------------------------------

    def _deliver(self, name: str, item: Any) -> None:
        if name == "answered":
            self._slow_down(*item)
            return
        payload = _ENCODERS[name](item)
        self._publishers[name].put(payload)
        if name == "map" and self._lockstep:
            self._last_map = payload
        if name in self._repeat_s:
            period_s = self._repeat_s[name]
            stamp_ns = item.stamp_ns if name == "goal" else 0
            due_s = time.monotonic() + period_s
            self._repeated[name] = _Repeated(payload, period_s, due_s, stamp_ns)

    def _slow_down(self, stamp_ns: int, settled: bool) -> None:
        goal = self._repeated.get("goal")
        if goal is None or goal.stamp_ns != stamp_ns:
            return
        if settled:
            del self._repeated["goal"]
        else:
            goal.period_s = UNSETTLED_S

    def _repeat(self) -> None:
        now_s = time.monotonic()
        for name, repeated in self._repeated.items():
            if now_s >= repeated.due_s:
                repeated.due_s = now_s + repeated.period_s
                if name == "tick" and self._last_map:
                    self._publishers["map"].put(self._last_map)
                self._publishers[name].put(repeated.payload)

    # -- bookkeeping --------------------------------------------------------------------------

    def _put(self, name: str, item: Any) -> None:
        """Ticks, and in lockstep all, leave in order; else the newest of a name wins."""
        if self._lockstep or name == "tick":
            self._mailbox.queue(name, item)
        else:
            self._mailbox.post(name, item)

    def _is_due(self, name: str, now_ns: int) -> bool:
        last_ns = self._last_ns.get(name)
        # A clock that was set back must not silence the sink.
        if last_ns is not None and 0 <= now_ns - last_ns < self._period_ns[name]:
            return False
        self._last_ns[name] = now_ns
        return True


def _json(item: Any) -> bytes:
    return json.dumps(item, separators=(",", ":"), allow_nan=False).encode()


def _encode_map(item: tuple[int, Callable[[], Snapshot]]) -> bytes:
    stamp_ns, take = item
    snapshot = take()
    return messages.encode_occupancy_grid(
        stamp_ns, snapshot.cells, snapshot.origin_xy_m, snapshot.resolution_m
    )


_ENCODERS: dict[str, Callable[[Any], bytes]] = {
    "goal": lambda goal: messages.encode_pose_stamped(goal.stamp_ns, goal.pose),
    "map": _encode_map,
    "status": _json,
    "latency": lambda report: _json(report()),
    "mission": lambda status: _json(asdict(status)),
    "tick": lambda stamp_ns: _json({"stamp": stamp_ns}),
}
