"""Matching of a recording's topics to sensors, and of its tf frames to base and map.

Names come from `ros2.topics`. If a recording lacks a topic of that name, the topic is guessed by
type, content and words in its name: each candidate topic gets points, and the most points win.
Every choice is reported to the user in a line. `edge.sources.contents` explains "our name".
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

from edge.bus import topics
from edge.bus.ros2.topics import COMPRESSED, COMPRESSED_ENDINGS, accepted_types
from edge.config import Config
from edge.config.ros2 import DEFAULT_TOPICS
from edge.sources.contents import (
    CLOUD,
    DEPTH,
    INFO,
    ODOMETRY,
    RGB,
    SCAN,
    TF,
    TF_STATIC,
    RecordingContents,
    TopicFacts,
    is_static,
)
from edge.text import format_table, one_line

SECOND = tuple(topic.key for topic in (topics.DEPTH2, topics.RGB2, topics.CAMERA_INFO2))
"""Topics of the second camera, which are found by name only."""
# Usual names of base and world frames, the most likely first.
_BASES = ("base_link", "base_footprint", "base", "base_frame")
_WORLDS = ("map", "odom", "world")

_MIN_SCORE = -5.0
"""A topic is guessed only if its points are above this."""

Words = dict[str, float]
"""Word in the name of a topic → points."""
_DIRECTIONS: Words = {"front": 1, "rear": -2, "back": -2}
_NO_PICTURES: Words = {
    "ir": -4, "infra": -4, "mask": -6, "label": -6, "labels": -6, "segmentation": -6,
    "semantic": -6, "disparity": -6, "confidence": -6,
}  # fmt: skip
_WORDS: dict[str, Words] = {
    RGB: {
        "rgb": 4, "color": 4, "colour": 4, "image": 1, "raw": 0.5, "infra1": -4, "infra2": -4,
        "thermal": -4, "debug": -3, "overlay": -3, "annotated": -3, **_NO_PICTURES, **_DIRECTIONS,
    },
    DEPTH: {
        "depth": 4, "stereo": 2, "aligned": 3, "registered": 3, "raw": 0.5, **_NO_PICTURES,
        **_DIRECTIONS,
    },
    CLOUD: {
        "lidar": 3, "velodyne": 3, "ouster": 3, "livox": 3, "points": 2, "map": -4, "camera": -2,
        "depth": -2, "costmap": -6, "obstacles": -4, "ground": -3, "octomap": -6, **_DIRECTIONS,
    },
    SCAN: {"scan": 2, "camera": -2, "depth": -2, **_DIRECTIONS},
    ODOMETRY: {"odom": 2, "odometry": 2, "filtered": 1, "wheel": -1, "gps": -2, "gt": -1},
}  # fmt: skip
"""Points by our name of the topic."""


@dataclass(frozen=True)
class TopicMatching:
    """The topics of a recording, and the sensor as which each is played.

    Attributes:
        topics: topic of the recording by our name (`camera/rgb`), for those that were found.
        config: the configuration with the frames of this recording in `ros2`.
        by_tf: True if the recording has tf.
        moving_frame: the tf frame whose transforms are the poses; "": odometry has them.
        lines: one line per choice, for the user.
    """

    topics: dict[str, str]
    config: Config
    by_tf: bool
    moving_frame: str
    lines: tuple[str, ...]


def match_topics(
    config: Config, contents: RecordingContents, wanted: Collection[str]
) -> TopicMatching:
    """Find the topics of a recording that a configuration needs."""
    chooser = _TopicChooser(config, contents)
    for name in (DEPTH, RGB, INFO, *SECOND, CLOUD, SCAN, ODOMETRY):
        if name in wanted:
            chooser.choose(name)
    for name in (TF, TF_STATIC):
        chooser.choose(name)
    found, how = chooser.found, chooser.how  # both by our name
    frames = _FrameMatcher(config, contents)
    frames.resolve(found)
    if frames.drops_odometry:
        del found[ODOMETRY]
    if frames.moving_frame:
        how[ODOMETRY] = f"tf, of {frames.moving_frame}"
    rows = [(name, found.get(name, "-"), how[name]) for name in how]
    rows = [(name, one_line(topic, 80), one_line(words, 200)) for name, topic, words in rows]
    lines = (
        *format_table(rows, left=3).splitlines(),
        *(one_line(line, 300) for line in frames.lines),
    )
    return TopicMatching(found, frames.config, frames.by_tf, frames.moving_frame, lines)


class _TopicChooser:
    """Chooses the topic of each sensor. Topics chosen before help to choose later ones.

    Attributes:
        found: topic of the recording by our name.
        how: a few words about each choice, by our name.
    """

    def __init__(self, config: Config, contents: RecordingContents) -> None:
        self._config, self._contents = config, contents
        self.found: dict[str, str] = {}
        self.how: dict[str, str] = {}

    def choose(self, name: str) -> None:
        """Choose the topic for one of our names."""
        present = {
            topic: facts
            for topic, facts in self._contents.topics.items()
            if facts.encoding == "cdr" and facts.type in accepted_types(name, topic)
        }
        topic, how = self._find_by_name(name, present)
        if not topic:
            scores = {
                t: self._score(name, t, facts)
                for t, facts in present.items()
                if name not in SECOND and self._may_be(name, t, facts)
            }
            likely = (t for t, score in scores.items() if score[0] > _MIN_SCORE)
            topic = max(likely, key=scores.get, default="")
            how = f"guessed{how}" if topic else f"not there{how}"
        if topic:
            self.found[name] = topic
            facts = present[topic]
            how = f"{facts.count} {facts.type}, {how}" if how else f"{facts.count} {facts.type}"
        self.how[name] = how

    def _find_by_name(self, name: str, present: dict[str, TopicFacts]) -> tuple[str, str]:
        """Return the topic with the configured, our own or the usual name, and a description.

        Without such a topic, return "" and the text to append to "guessed" or "not there".
        """
        configured = self._config.ros2.topics.get(name)
        if configured is not None:
            if topic := next((t for t in _with_compressed(configured) if t in present), ""):
                return topic, "ros2.topics"
            other = self._contents.topics.get(configured)
            has = "" if other is None else f", which has {other.encoding} {other.type}"
            return "", f": ros2.topics has {configured}{has}"
        for usual in (f"/{name}", DEFAULT_TOPICS[name]):
            for topic in _with_compressed(usual):
                if topic in present and self._may_be(name, topic, present[topic]):
                    return topic, ""
        return "", ""

    def _may_be(self, name: str, topic: str, facts: TopicFacts) -> bool:
        """Return True if a topic may be played as this sensor, going by its content."""
        if name in (RGB, DEPTH):
            return facts.is_depth == (name == DEPTH)
        if name in (TF, TF_STATIC):
            return is_static(topic) == (name == TF_STATIC)
        # Only one LiDAR is mapped, and a cloud has more information than a scan.
        return name != SCAN or CLOUD not in self.found

    def _score(self, name: str, topic: str, facts: TopicFacts) -> tuple:
        """Return the sort key of a candidate topic; the largest wins. It begins with the points."""
        words = set(re.split(r"[^a-z0-9]+", topic.lower()))
        points = sum(_WORDS.get(name, {}).get(word, 0.0) for word in words)
        ros2 = self._config.ros2
        if name == RGB:
            points += 2 * _n_shared_parts(topic, self.found.get(DEPTH, ""))
        elif name == INFO:
            points += self._camera_info_score(topic)
        elif name == CLOUD:  # a cloud in a world frame is a map, not a sweep
            points -= 6 * (facts.frame_id in (ros2.map_frame, *_WORLDS))
        elif name == ODOMETRY:
            points += 2 * (facts.child == ros2.base_frame) + (facts.child in _BASES)
            points += facts.frame_id == ros2.map_frame
        is_raw = facts.type != COMPRESSED
        # With equal points, raw images win, then more messages, then the last name.
        return points, is_raw, facts.count, topic

    def _camera_info_score(self, topic: str) -> float:
        """Return the points of a camera info topic, which usually is next to its image topic."""
        points = 0.0
        for weight, image in ((4, RGB), (2, DEPTH)):
            image_topic = self.found.get(image, "")
            for end in COMPRESSED_ENDINGS:
                image_topic = image_topic.removesuffix(end)
            namespace = topic.rpartition("/")[0]
            if namespace and namespace == image_topic.rpartition("/")[0]:
                points += weight
            points += 0.1 * weight * _n_shared_parts(topic, image_topic)
        return points


def _with_compressed(topic: str) -> list[str]:
    """Return an image topic and its names when image_transport compresses it."""
    return [topic, *(f"{topic}{end}" for end in COMPRESSED_ENDINGS)]


def _n_shared_parts(topic: str, other: str) -> int:
    """Return the number of name parts that two topics have in common at the start."""
    n = 0
    for a, b in zip(topic.split("/")[1:], other.split("/")[1:], strict=False):
        if a != b:
            break
        n += 1
    return n


class _FrameMatcher:
    """Finds the frames of a recording, and where its poses and mounts come from.

    Attributes:
        by_tf: True if the recording has tf.
        drops_odometry: True if poses come from tf, although the recording has odometry.
        moving_frame: see `TopicMatching`.
        config: the configuration with the frames that `resolve` found.
        lines: one line per choice, for the user.
    """

    def __init__(self, config: Config, contents: RecordingContents) -> None:
        self._contents = contents
        self.config = config
        self.by_tf, self.drops_odometry, self.moving_frame = bool(contents.parents), False, ""
        self.lines: list[str] = []

    def resolve(self, found: dict[str, str]) -> None:
        """Find the frames, given the topics of the recording by our name; set the attributes."""
        config, contents = self.config, self._contents
        if not self.by_tf:
            self.lines.append(
                "frames: no tf in the recording: mounts come from `sensors`, odometry is in map"
            )
            return
        ros2, odom = config.ros2, contents.topics.get(found.get(ODOMETRY, ""))
        sensors = [contents.topics[found[n]].frame_id for n in (RGB, CLOUD, SCAN) if n in found]
        base = self._find_base(ros2.base_frame, odom, sensors)
        if odom is not None and self._odometry_is_apart(odom, base):
            self.lines.append(
                f"odom: tf does not connect {one_line(odom.frame_id)} with {ros2.map_frame}, but "
                f"{base}: poses come from tf"
            )
            self.drops_odometry, odom = True, None
        if odom is None:
            self.moving_frame = contents.moving_frame(base)
        world = self._find_map(ros2.map_frame, base, odom)
        frames = {"base_frame": base, "map_frame": world}
        if ros2.mounts == "tf" and not any(contents.connected(base, name) for name in sensors):
            frames["mounts"] = "config"
            named = one_line(" or ".join(dict.fromkeys(sensors)), 200)
            self.lines.append(
                f"mounts: tf does not connect {base} with {named}: mounts come from `sensors`"
            )
        self.config = config.model_copy(update={"ros2": ros2.model_copy(update=frames)})
        self.lines.append(f"frames: {base} in {world}, by tf")

    def _odometry_is_apart(self, odom: TopicFacts, base: str) -> bool:
        """Return True if tf has the base in the map, but not the odometry frame."""
        connected, world = self._contents.connected, self.config.ros2.map_frame
        has_base = connected(base, world) and bool(self._contents.moving_frame(base))
        return has_base and bool(odom.frame_id) and not connected(odom.frame_id, world)

    def _find_base(self, configured: str, odom: TopicFacts | None, sensors: list[str]) -> str:
        """Return the base frame: the configured one, or a frame that moves."""
        base = configured
        if odom is not None:
            # Odometry is the pose of its child frame, so the base must be connected with it.
            if odom.child and not self._contents.connected(configured, odom.child):
                base = odom.child
        elif configured not in self._contents.parents:
            # tf lacks the configured frame: take a usual name, or a moving frame of a sensor.
            movers = filter(None, map(self._contents.moving_frame, sensors))
            usual = (name for name in _BASES if name in self._contents.parents)
            base = next(iter((*usual, *movers, configured)))
        if base != configured:
            self.lines.append(f"base: {one_line(base)} instead of ros2.base_frame ({configured})")
        return base

    def _find_map(self, configured: str, base: str, odom: TopicFacts | None) -> str:
        """Return the map frame: the configured one, or the frame of the poses."""
        frame = self._contents.root(base) if odom is None else odom.frame_id
        if self._contents.connected(configured, frame) or not frame:
            return configured
        self.lines.append(
            f"map: {one_line(frame)} instead of ros2.map_frame ({configured}), which is not in tf"
        )
        return frame
