"""Contents of a recording: its topics and tf frames.

"Our name" of a topic is its key in `edge.bus.topics`, such as `camera/rgb`.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from edge.bus import topics
from edge.bus.ros2.topics import COMPRESSED, SUBSCRIBED, accepted_types
from edge.bus.wire import DecodeError, compressed, messages
from edge.bus.wire.transforms import decode_transforms
from edge.config import Config
from edge.host.interruptible import raise_if_stopped
from edge.recording.bag import WINDOW_NS, Bag
from edge.recording.file import RecordedMessage
from edge.sources.decoder import KINDS
from edge.sources.synchronizer import streams_of
from edge.text import one_line

# Our names of the topics.
RGB, DEPTH, INFO, CLOUD, SCAN, ODOMETRY = (
    topic.key
    for topic in (
        topics.RGB, topics.DEPTH, topics.CAMERA_INFO, topics.CLOUD, topics.SCAN, topics.ODOMETRY,
    )
)  # fmt: skip
TF, TF_STATIC = "tf", "tf_static"
_DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")
_MAX_TOPICS = 10_000
_MAX_STATIC_BYTES = 1 << 23  # of tf_static messages that are kept
_MAX_FRAMES = 4096  # of tf
_MAX_LISTED = 12  # topics in a message

_TYPES = {kind for name in SUBSCRIBED for kind in accepted_types(name, "")}
"""Message types that can be played."""


@dataclass(slots=True)
class TopicFacts:
    """One topic of a recording.

    Attributes:
        type: such as `sensor_msgs/msg/Image`.
        encoding: encoding of the messages; only `cdr` can be played.
        count: number of messages.
        frame_id: `frame_id` of the first message; "" if it has none.
        child: `child_frame_id` of the first odometry message; "" for other types.
        is_depth: True if its first image is depth.
    """

    type: str
    encoding: str
    count: int = 0
    frame_id: str = ""
    child: str = ""
    is_depth: bool = False


@dataclass
class RecordingContents:
    """The contents of a recording, from one pass over all its messages.

    Attributes:
        first_ns: log time of the first message.
        last_ns: log time of the last message.
        nearly_sorted: True if the messages are nearly sorted by log time; see `Bag.by_time`.
        static: payloads of the `tf_static` messages, by topic. Playback processes all of them at
            its start, as a late subscriber would.
        static_bytes: size of all `tf_static` messages, also of those that are not in `static`.
        parents: parent of each tf frame.
        moving: frames with a transform on `tf`, which is published repeatedly.
    """

    topics: dict[str, TopicFacts] = field(default_factory=dict)
    first_ns: int = 0
    last_ns: int = 0
    nearly_sorted: bool = True
    static: dict[str, list[bytes]] = field(default_factory=dict)
    static_bytes: int = 0
    parents: dict[str, str] = field(default_factory=dict)
    moving: set[str] = field(default_factory=set)

    @property
    def seconds(self) -> float:
        return (self.last_ns - self.first_ns) * 1e-9

    def _lineage(self, frame: str) -> Iterator[str]:
        """Yield a frame and its ancestors, nearest first."""
        yield frame
        for _ in range(len(self.parents)):  # a limit, since a damaged tree may have a cycle
            if frame not in self.parents:
                break
            frame = self.parents[frame]
            yield frame

    def root(self, frame: str) -> str:
        """Return the topmost ancestor of a frame."""
        return list(self._lineage(frame))[-1]

    def connected(self, frame: str, other: str) -> bool:
        """Return True if tf connects two frames."""
        return self.root(frame) == self.root(other)

    def moving_frame(self, base: str) -> str:
        """Return the frame whose transform moves the robot; "" if there is none.

        This is `base` or its nearest ancestor that is not fixed.
        """
        return next((frame for frame in self._lineage(base) if frame in self.moving), "")

    def topic_list(self) -> str:
        """List the topics in one line."""
        shown = [
            f"{one_line(name, 80)} ({_type_text(facts)}, {facts.count})"
            for name, facts in sorted(self.topics.items())
        ]
        if len(shown) > _MAX_LISTED:
            shown[_MAX_LISTED:] = [f"{len(shown) - _MAX_LISTED} more"]
        return ", ".join(shown) or "no topics"


def _type_text(facts: TopicFacts) -> str:
    note = "" if facts.encoding == "cdr" else f" as {facts.encoding}"
    return one_line(f"{facts.type}{note}", 60)


def read_contents(bag: Bag, stop: threading.Event) -> RecordingContents:
    """Read a recording once.

    Raises:
        RecordingError: see `Bag`.
        Stopped: `stop` was set.
    """
    found = RecordingContents()
    latest_ns = 0
    for message in bag:
        raise_if_stopped(stop)
        facts = found.topics.get(message.topic)
        if facts is None:
            if len(found.topics) >= _MAX_TOPICS:
                continue
            if not found.topics:
                found.first_ns = message.log_ns
            facts = TopicFacts(_type_name(message.schema), message.encoding)
            found.topics[message.topic] = facts
            _set_facts(facts, message)
        facts.count += 1
        found.first_ns = min(found.first_ns, message.log_ns)
        latest_ns = max(latest_ns, message.log_ns)
        found.nearly_sorted &= latest_ns - message.log_ns <= WINDOW_NS
        if facts.type == SUBSCRIBED[TF] and facts.encoding == "cdr":
            _add_frames(found, message)
    found.last_ns = max(latest_ns, found.first_ns)
    return found


def _type_name(schema: str) -> str:
    """Return the ROS 2 name of a type, such as `sensor_msgs/msg/Image` for `sensor_msgs/Image`."""
    return re.sub(r"^(\w+)/(\w+)$", r"\1/msg/\2", schema)


def _set_facts(facts: TopicFacts, message: RecordedMessage) -> None:
    """Set facts from the first message. A damaged message is counted later, during playback."""
    if facts.encoding != "cdr" or facts.type not in _TYPES or facts.type == SUBSCRIBED[TF]:
        return
    facts.is_depth = "depth" in message.topic.lower()
    try:
        _, facts.frame_id = messages.peek_header(message.payload)
        if facts.type == SUBSCRIBED[ODOMETRY]:
            facts.child = messages.decode_odometry(message.payload).child_frame_id
        elif facts.type == SUBSCRIBED[RGB]:
            encoding = messages.decode_image_header(message.payload).encoding
            facts.is_depth = encoding in _DEPTH_ENCODINGS
        elif facts.type == COMPRESSED:
            header = compressed.decode_compressed_header(message.payload)
            facts.is_depth = header.content != "colour"
    except DecodeError:
        return
    finally:
        facts.frame_id, facts.child = facts.frame_id.lstrip("/"), facts.child.lstrip("/")


def _add_frames(found: RecordingContents, message: RecordedMessage) -> None:
    """Add the frames of a tf message to the contents."""
    static = is_static(message.topic)
    if static:
        found.static_bytes += len(message.payload)
        if found.static_bytes <= _MAX_STATIC_BYTES:
            found.static.setdefault(message.topic, []).append(message.payload)
    try:
        transforms, _ = decode_transforms(message.payload)
    except DecodeError:
        return
    for transform in transforms:
        if len(found.parents) < _MAX_FRAMES and transform.child != transform.parent:
            found.parents[transform.child] = transform.parent
            if not static:
                found.moving.add(transform.child)


def is_static(topic: str) -> bool:
    """Return True for a topic of fixed transforms."""
    return topic.endswith("tf_static")


def missing_inputs(config: Config, present: Collection[str]) -> Iterator[str]:
    """Yield the inputs that an observation needs and that are not present."""
    required = {field for field, stream in streams_of(config).items() if stream.required}
    groups = [
        [
            topic.key
            for topic, kind in KINDS.items()
            if kind.field == field and not kind.camera_index
        ]
        for field in sorted(required)
    ]
    if required & {"rgb", "depth_m"}:
        groups.append([INFO])
    groups.append([ODOMETRY])
    yield from (" or ".join(names) for names in groups if not set(present).intersection(names))
