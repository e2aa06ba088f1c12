"""Sink for Zenoh: goals, map, mission, trajectory, status and latency.

The loop only queues data; a worker thread encodes and sends them. A goal is repeated every 0.5 s
until it is acknowledged, then every second until it is settled, so that a slow or restarted
controller receives it. The mission is sent when it changes and every second, so a late subscriber
has it within a second. A task's trajectory, which may be long, is sent when it changes and every
five seconds; an empty one is sent after its end.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import zenoh

from edge.bus import topics
from edge.bus.session import declare_publisher
from edge.bus.wire import messages
from edge.config import Config
from edge.geometry import Grid
from edge.host.worker import Worker
from edge.loop.result import TickResult
from edge.loop.status import status_message
from edge.sinks.rate_limiter import RateLimiter
from edge.tasks.follow import path_message
from edge.tasks.refine import RefinedTrajectory

# Periods at which messages are repeated.
UNANSWERED_S = 0.5  # a goal that the controller has not acknowledged
UNSETTLED_S = 1.0  # a goal that it has acknowledged
MISSION_S = 1.0
TRAJECTORY_S = 5.0
LATENCY_HZ = 1.0
_CLOSE_S = 1.0  # longest time to send what is pending at the end

WRITTEN = tuple(topic for topic in topics.ALL if topic.writer == "service")
"""Topics that this sink publishes."""


@dataclass(slots=True)
class _Repeated:
    """A message that is repeated; used by the worker's thread only.

    Attributes:
        period_s: time between repetitions.
        due_s: monotonic time of the next repetition.
        stamp_ns: stamp of a goal; 0 for other messages.
    """

    payload: bytes
    period_s: float
    due_s: float
    stamp_ns: int = 0


class ZenohSink:
    """Publishes the topics of the service; no method blocks.

    In lockstep all messages are sent in order and none is dropped, so that the receiver of a tick
    has the goal and the map of that tick.
    """

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        lockstep = config.loop.lockstep
        self._lockstep = lockstep
        self._publishers = {
            topic.key: declare_publisher(
                session, replace(topic, qos="block") if lockstep else topic, config.zenoh
            )
            for topic in WRITTEN
        }
        self._repeated: dict[str, _Repeated] = {}
        self._repeat_s = {
            "goal": UNANSWERED_S, "mission": MISSION_S, "trajectory": TRAJECTORY_S,
        }  # fmt: skip
        if lockstep:
            # Simulated time waits until the controller, which may start late, has received the tick
            # and, before it, the map.
            self._repeat_s["tick"] = UNANSWERED_S
        self._last_map = b""
        self._limiter = RateLimiter(
            map=config.report.map_hz, status=config.report.status_hz, latency=LATENCY_HZ
        )
        self._mission: tuple[str, str, str] | None = None
        self._trajectory: RefinedTrajectory | None = None
        self._worker = Worker(
            "zenoh-sink", self._deliver, finish_on_close=True, periodic=self._repeat
        )

    # -- on the loop's thread -------------------------------------------------------------------

    def tick(self, result: TickResult) -> None:
        """Queue what changed; see `edge.loop.result.Sink`."""
        for goal_status in result.goal_statuses:
            settled = goal_status.state != "accepted"
            self._worker.enqueue(("goal_status", (goal_status.stamp_ns, settled)))
        for goal in result.goals:
            self._put("goal", goal)
        now_ns, status = result.now_ns, result.status
        if self._limiter.take_turn("map", now_ns):
            self._put("map", (now_ns, self._map_of(result)))
        if self._limiter.take_turn("status", now_ns):
            self._put("status", status_message(result))
        if self._limiter.take_turn("latency", now_ns):
            self._put("latency", result.latency)
        if (status.target, status.phase, status.reason) != self._mission:
            self._mission = (status.target, status.phase, status.reason)
            self._put("mission", status)
        task = result.task()
        refined = None if task is None else task.refined
        if refined is not self._trajectory:
            self._trajectory = refined
            self._put("trajectory", (now_ns, refined))
        if self._lockstep and result.observation is not None:
            self._put("tick", result.observation.stamp_ns)

    def _map_of(self, result: TickResult) -> Callable[[], Grid]:
        """Return a function that copies the map on the worker's thread, as it is slow.

        In lockstep the map is copied now, since it must be the one of this tick.
        """
        if not self._lockstep:
            return result.snapshot
        grid = result.snapshot()
        return lambda: grid

    def status(self) -> dict[str, Any]:
        """Return worker statistics; see `edge.loop.result.Sink`."""
        return self._worker.stats.status()

    def close(self) -> None:
        """Send what is pending, for at most a second: a stopped peer may block lockstep."""
        if self._worker.close(_CLOSE_S):
            for publisher in self._publishers.values():
                publisher.undeclare()

    def _put(self, name: str, item: Any) -> None:
        """Queue an item.

        A tick, and in lockstep every item, is sent in order. Otherwise a newer item replaces an
        older one of the same name.
        """
        if self._lockstep or name == "tick":
            self._worker.enqueue((name, item))
        else:
            self._worker.submit((name, item), key=name)

    # -- on the worker's thread ------------------------------------------------------------------

    def _deliver(self, message: tuple[str, Any]) -> None:
        """Publish one queued item, and keep it if it is repeated."""
        name, item = message
        if name == "goal_status":
            self._slow_down(*item)
            return
        try:
            payload = _ENCODERS[name](item)
        except Exception as error:
            raise ValueError(f"{name}: {error}") from error
        self._publishers[name].put(payload)
        if name == "map" and self._lockstep:
            self._last_map = payload
        if name in self._repeat_s:
            period_s = self._repeat_s[name]
            stamp_ns = item.stamp_ns if name == "goal" else 0
            due_s = time.monotonic() + period_s
            self._repeated[name] = _Repeated(payload, period_s, due_s, stamp_ns)

    def _slow_down(self, stamp_ns: int, settled: bool) -> None:
        """Repeat an acknowledged goal less often, and a settled goal no more."""
        goal = self._repeated.get("goal")
        if goal is None or goal.stamp_ns != stamp_ns:
            return
        if settled:
            del self._repeated["goal"]
        else:
            goal.period_s = UNSETTLED_S

    def _repeat(self) -> None:
        """Send the messages again whose period is over."""
        now_s = time.monotonic()
        for name, repeated in self._repeated.items():
            if now_s >= repeated.due_s:
                repeated.due_s = now_s + repeated.period_s
                if name == "tick" and self._last_map:
                    self._publishers["map"].put(self._last_map)
                self._publishers[name].put(repeated.payload)


def _json(item: Any) -> bytes:
    return json.dumps(item, separators=(",", ":"), allow_nan=False).encode()


def _encode_map(item: tuple[int, Callable[[], Grid]]) -> bytes:
    stamp_ns, copy_map = item
    return messages.encode_occupancy_grid(stamp_ns, copy_map())


# Name of a topic → encoder of its queued item.
_ENCODERS: dict[str, Callable[[Any], bytes]] = {
    "goal": lambda goal: messages.encode_pose_stamped(goal.stamp_ns, goal.pose),
    "map": _encode_map,
    "status": _json,
    "latency": lambda report: _json(report().as_dict()),
    "mission": lambda status: _json(asdict(status)),
    "trajectory": lambda item: path_message(item[1], item[0]),
    "tick": lambda stamp_ns: _json({"stamp": stamp_ns}),
}
