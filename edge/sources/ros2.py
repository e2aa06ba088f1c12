"""Observations from a robot's ROS 2 graph, without a ROS installation here.

The transport is that of `ros2.via`. With rmw_zenoh the key of a message has its type, so a topic
may carry raw or compressed images, of any distribution. Subscriptions are announced, because
drivers may send nothing without subscribers.
"""

from __future__ import annotations

import zenoh

from edge.bus.ros2.node import Ros2Subscription, open_node
from edge.bus.ros2.topics import LATCHED, accepted_types
from edge.bus.topics import Topic
from edge.config import Config
from edge.sources.polled import PolledSource
from edge.sources.tf import RobotFrames

_TF_MESSAGES = 256  # buffered between two polls


class Ros2Source(PolledSource):
    """Source of the sensors in `ros2.topics`."""

    def __init__(self, config: Config, session: zenoh.Session) -> None:
        self._settings, self._frames = config.ros2, RobotFrames(config)
        super().__init__(config, session, self._frames)
        self._node = open_node(config, session, "source")
        # Process tf first: frames of a sensor without a known mount are dropped.
        self._transforms = {n: self._subscribe(n, _TF_MESSAGES) for n in ("tf_static", "tf")}
        for name in ("tf", "tf_static"):
            self._synchronizer.inputs.add(name, "tf", needed=self._frames.by_tf)
            self._synchronizer.inputs.listen(name, self._settings.topic(name))
        self._sensors = {
            topic: self._subscribe(topic.key, n) for topic, n in self._capacities.items()
        }

    def _subscribe(self, name: str, capacity: int) -> Ros2Subscription:
        ros_name = self._settings.topic(name)
        types = accepted_types(name, ros_name)
        return self._node.subscription(ros_name, types, capacity, latched=name in LATCHED)

    def close(self) -> None:
        self._node.close()
        super().close()

    def _where(self, topic: Topic) -> str:
        return self._settings.topic(topic.key)

    def _drain(self) -> int:
        self._node.update()
        n = 0
        for name, subscription in self._transforms.items():
            for _, payload in subscription.take():
                n += 1
                self._take_transforms(
                    subscription.topic, payload, self._frames, name == "tf_static"
                )
        for topic, subscription in self._sensors.items():
            for type_name, payload in subscription.take():
                n += 1
                self._offer(topic, subscription, type_name, payload)
        self._decoder.convert_waiting_poses()
        subscriptions = (*self._transforms.values(), *self._sensors.values())
        self.counters["overrun"] = sum(subscription.overruns for subscription in subscriptions)
        return n

    def _offer(
        self, topic: Topic, subscription: Ros2Subscription, type_name: str, payload: zenoh.ZBytes
    ) -> None:
        """Pass a message to the decoder, or count it if its type is wrong."""
        if self._is_too_large(topic.key, payload):
            return
        if type_name not in subscription.types:
            self._synchronizer.inputs.on_message(topic.key)
            expected = " or ".join(subscription.types)
            self._synchronizer.count(
                topic.key, "malformed",
                f"{subscription.topic} has type {type_name or 'unknown'}, expected {expected}",
            )  # fmt: skip
        else:
            self._decoder.offer(topic, payload.to_bytes(), type_name.replace("/msg/", "/"))
