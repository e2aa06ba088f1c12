"""Observations from a robot's ROS 2 graph, without ROS, however it is reached (`ros2.via`).

On rmw_zenoh a message's key says what it is, so a topic may bring pictures as they are or
compressed, and of any distribution. Our subscriptions are announced, since drivers send nothing
while nobody listens.
"""

from __future__ import annotations

import logging
import time

import zenoh

from edge.bus import topics
from edge.bus.ros2.node import Subscription, open_node
from edge.bus.ros2.topics import LATCHED, heard_types
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError
from edge.config import Config
from edge.geometry import SE2
from edge.sources.decoder import KINDS, CdrDecoder
from edge.sources.goal_status import GoalStatusInbox
from edge.sources.streams import KEPT
from edge.sources.synchronizer import TimeSynchronizer
from edge.sources.tf import Frames
from edge.sources.zenoh import PAUSE_S
from edge.text import one_line
from edge.types import Observation

log = logging.getLogger("edge.sources.ros2")

_TF_KEPT = 256


class Ros2Source:
    """The sensors that `ros2.topics` names as Observations (an `edge.loop.source.Source`).

    Raises:
        ConfigError: a cloud is asked for and no LiDAR is described.
    """

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._settings = config.ros2
        self._synchronizer = TimeSynchronizer(config)
        self._frames = Frames(config.ros2)
        self._decoder = CdrDecoder(self._synchronizer, frames=self._frames)
        self._max_bytes = int(config.source.max_message_mb * 1e6)
        self._node = open_node(config, session, "source")
        # What was moored first: a frame whose sensor sits nowhere yet is dropped.
        self._transforms = [self._subscribe(name, _TF_KEPT) for name in ("tf_static", "tf")]
        kept = {topics.ODOMETRY: config.source.odometry_ring, topics.CAMERA_INFO: 1}
        heard = self._synchronizer.streams
        kept |= {topic: KEPT for topic, kind in KINDS.items() if kind.field in heard}
        self._sensors = {topic: self._subscribe(topic.key, n) for topic, n in kept.items()}
        self.inbox = GoalStatusInbox(session, config.zenoh)

    def _subscribe(self, name: str, kept: int) -> Subscription:
        ros_name = self._settings.topic(name)
        types = heard_types(name, ros_name)
        return self._node.subscription(ros_name, types, kept, latched=name in LATCHED)

    @property
    def counters(self) -> dict[str, int]:
        return self._synchronizer.counters

    @property
    def epoch(self) -> int:
        return self._synchronizer.odometry.epoch

    @property
    def pose(self) -> SE2 | None:
        return self._synchronizer.odometry.newest_pose

    def poll(self) -> Observation | None:
        """See `edge.loop.source.Source`."""
        self._drain()
        return self._synchronizer.poll()

    def wait(self, timeout_s: float) -> bool:
        """See `edge.loop.source.Source`; looks every 0.3 ms, since rings cannot be waited on."""
        deadline_s = time.monotonic() + timeout_s
        while not self._drain():
            if time.monotonic() >= deadline_s:
                return False
            time.sleep(PAUSE_S)
        return True

    def close(self) -> None:
        self._node.close()
        self.inbox.close()

    def _drain(self) -> int:
        """Hand a ring's worth of each topic to the decoder; how many messages it was."""
        self._node.look()
        n = 0
        for subscription in self._transforms:
            for _, payload in subscription.take():
                n += 1
                self._take_transforms(subscription.topic, payload)
        for topic, subscription in self._sensors.items():
            for type_name, payload in subscription.take():
                n += 1
                self._take(topic, subscription, type_name, payload)
        every = (*self._transforms, *self._sensors.values())
        self.counters["overrun"] = sum(subscription.overruns for subscription in every)
        return n

    def _take(
        self, topic: Topic, subscription: Subscription, type_name: str, payload: zenoh.ZBytes
    ) -> None:
        if len(payload) > self._max_bytes:
            self._synchronizer.count(topic.key, "oversized", f"{len(payload)} bytes")
        elif type_name not in subscription.types:
            expected = " or ".join(subscription.types)
            self._synchronizer.count(
                topic.key, "malformed",
                f"{subscription.topic} brings {type_name or 'what has no type'}, not {expected}",
            )  # fmt: skip
        else:
            self._decoder.offer(topic, payload.to_bytes(), type_name.replace("/msg/", "/"))

    def _take_transforms(self, name: str, payload: zenoh.ZBytes) -> None:
        counters = self.counters
        counters["received"] += 1
        if len(payload) > self._max_bytes:
            self._synchronizer.count(name, "oversized", f"{len(payload)} bytes")
            return
        try:
            untaken = self._frames.take(payload.to_bytes())
        except DecodeError as error:
            self._synchronizer.count(name, "malformed", one_line(error))
            return
        if untaken:
            self._synchronizer.count(name, "malformed", f"{untaken} transforms that fit nowhere")
