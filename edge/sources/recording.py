"""Recordings of bus messages as MCAP: writing them, and playing them over Zenoh.

Messages are stored as on the wire (CDR with `ros2msg` schemas, JSON), so Foxglove and the ROS 2
tools can open them. They have our own names (`/camera/rgb`), from whichever source they come.
"""

from __future__ import annotations

import argparse
import logging
import os
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple, Protocol

import zenoh

from edge.bus import topics
from edge.bus.ros2.node import open_node
from edge.bus.ros2.topics import COMPRESSED, COMPRESSED_ENDINGS, LATCHED, SUBSCRIBED, accepted_types
from edge.bus.session import BusError, Ring, declare_publisher, open_session, zenoh_session
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError
from edge.bus.wire.cdr import HEADER, STAMP
from edge.bus.wire.messages import peek_stamp_ns
from edge.config import Config, ZenohConfig, load
from edge.errors import FAILED, ConfigError, UnavailableError, UserError
from edge.host.children import python_module
from edge.host.signals import stop_on_signals
from edge.recording.bag import by_log_time
from edge.recording.channels import Channel, ros_channel, topic_channel
from edge.recording.file import McapReader, McapWriter, RecordingError, has_end
from edge.sources.contents import ODOMETRY, TF, TF_STATIC, missing_inputs

log = logging.getLogger("edge.sources.recording")

_ENDINGS = ("", *COMPRESSED_ENDINGS)  # suffixes of a recorded topic
# Channels whose messages do not begin with a std_msgs/Header.
_WITHOUT_HEADER = (f"/{TF}", f"/{TF_STATIC}")
_RING = 64  # messages of a topic between two polls
_PAUSE_S = 0.002  # between two polls
_SYNC_S = 2.0  # period of writing to the disk
_SERVICE_S = 60.0  # longest wait for the service to play to
_TOPICS = {f"/{topic.key}": topic for topic in topics.ALL}  # by name of the channel


def record_messages(
    path: str | os.PathLike[str], messages: Iterable[tuple[Topic, int, bytes]]
) -> int:
    """Write (topic, stamp_ns, payload) messages without Zenoh or real time.

    Returns:
        The number of messages written.

    Example:
        >>> from edge.bus.wire.messages import encode_pose_stamped
        >>> from edge.geometry import SE2
        >>> goal = encode_pose_stamped(0, SE2(1.0, 2.0, 0.0))
        >>> record_messages("example.mcap", [(topics.GOAL, 0, goal)])
        1
        >>> [message.topic.key for message in read("example.mcap")]
        ['goal']
    """
    with McapWriter(path, "zstd") as file:
        for topic, stamp_ns, payload in messages:
            file.add(topic_channel(topic), stamp_ns, stamp_ns, payload)
    return file.messages


def record(
    session: zenoh.Session,
    config: Config,
    path: str | os.PathLike[str],
    duration_s: float,
    stop: threading.Event | None = None,
) -> Counter[str]:
    """Record all that the configured source receives and all Zenoh topics.

    Ends after `duration_s`, or when `stop` is set.

    Returns:
        The number of messages written, by channel.

    Raises:
        RecordingError: the file cannot be written. The messages so far are in `NAME.partial`. They
            are there, too, if this process is killed.
    """
    stop = stop or threading.Event()
    taps = _taps(session, config)
    written: Counter[str] = Counter()
    deadline_s = time.monotonic() + duration_s
    sync_s = time.monotonic() + _SYNC_S
    file = McapWriter(path, "zstd")
    try:
        file.open()
        while not stop.is_set() and time.monotonic() < deadline_s:
            for tap in taps:
                for channel, payload in tap.take():
                    now_ns = time.time_ns()
                    file.add(channel, now_ns, _stamp_or(channel, payload, now_ns), payload)
                    written[channel.topic] += 1
            if time.monotonic() >= sync_s:
                sync_s = time.monotonic() + _SYNC_S
                file.sync()
            stop.wait(_PAUSE_S)
        file.finish()
        return written
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        for tap in taps:
            tap.close()


class _Tap(Protocol):
    """Receives the messages of a source for the recording."""

    def take(self) -> Iterator[tuple[Channel, bytes]]:
        """Yield the messages since the last poll."""

    def close(self) -> None: ...


def _taps(session: zenoh.Session, config: Config) -> list[_Tap]:
    """Return taps of everything that the configured source receives."""
    taps: list[_Tap] = [_ZenohTap(session, config)]
    if config.source.kind == "ros2":
        taps.append(_Ros2Tap(session, config))
    elif config.source.kind == "zmq":
        from edge.sources.zmq import ZmqTap

        taps.append(ZmqTap(config))
    elif config.source.kind == "camera":
        from edge.sources.camera import CameraTap

        taps.append(CameraTap(config))
    return taps


class _ZenohTap:
    """Receives all Zenoh topics."""

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        self._rings = [
            (topic, Ring(session, config.zenoh.key(topic.key), _RING)) for topic in topics.ALL
        ]

    def take(self) -> Iterator[tuple[Channel, bytes]]:
        for topic, ring in self._rings:
            for sample in ring.take():
                yield topic_channel(topic), sample.payload.to_bytes()

    def close(self) -> None:
        for _, ring in self._rings:
            ring.close()


class _Ros2Tap:
    """Receives the sensors and tf of a ROS 2 graph, named in `ros2.topics`."""

    def __init__(self, session: zenoh.Session, config: Config) -> None:
        self._node = open_node(config, session, "record")
        self._subscriptions = {
            name: self._node.subscription(
                config.ros2.topic(name), accepted_types(name, config.ros2.topic(name)), _RING,
                latched=name in LATCHED,
            )
            for name in SUBSCRIBED
        }  # fmt: skip
        self._warned: set[str] = set()

    def take(self) -> Iterator[tuple[Channel, bytes]]:
        self._node.update()
        for name, subscription in self._subscriptions.items():
            for type_name, payload in subscription.take():
                if type_name in subscription.types:
                    yield _channel_of(name, subscription.topic, type_name), payload.to_bytes()
                elif name not in self._warned:
                    self._warned.add(name)
                    log.warning(
                        "%s: messages are not recorded: their type is %s, expected %s",
                    subscription.topic,
                        type_name or "unknown", " or ".join(subscription.types),
                    )  # fmt: skip

    def close(self) -> None:
        self._node.close()


@cache
def _channel_of(name: str, ros_name: str, type_name: str) -> Channel:
    """Return the channel of a ROS 2 topic: our name, with a suffix if images are compressed."""
    ending = ""
    if type_name == COMPRESSED:
        ending = next((end for end in COMPRESSED_ENDINGS if ros_name.endswith(end)), "/compressed")
    return ros_channel(f"/{name}{ending}", type_name.replace("/msg/", "/"))


def _stamp_or(channel: Channel, payload: bytes, otherwise_ns: int) -> int:
    """Return the stamp of a message's header, else `otherwise_ns`."""
    if channel.encoding != "cdr" or channel.topic in _WITHOUT_HEADER:
        return otherwise_ns
    try:
        return max(0, peek_stamp_ns(payload))
    except DecodeError:
        return otherwise_ns


class BusMessage(NamedTuple):
    """A recorded message of the bus; `log_ns` is the time at which it was recorded."""

    topic: Topic
    log_ns: int
    payload: bytes


def read(path: str | os.PathLike[str]) -> Iterator[BusMessage]:
    """Yield the messages of a recording in the order of their log times.

    Raises:
        RecordingError: no such file, or not a complete MCAP file.
    """
    reader = McapReader(path)
    if has_end(path):  # an incomplete file is not played at all
        for message in by_log_time(reader):
            topic = _TOPICS.get(message.topic)
            if topic is not None:
                yield BusMessage(topic, message.log_ns, message.payload)
        if not reader.truncation:
            return
    why = reader.truncation or "the end is missing"
    raise RecordingError(
        f"{path}: not a complete MCAP file: {why}; repair it with `edge replay --recover`"
    )


def play(
    session: zenoh.Session, settings: ZenohConfig, path: str, stop: threading.Event
) -> tuple[int, float, int]:
    """Publish the sensor messages of a recording, again and again until `stop` is set.

    They come at the times at which they were recorded, counted from the start, so delays do not add
    up. The stamps are shifted to the current time. Messages of the service and the controller are
    left out.

    Returns:
        Number of messages that were sent, the largest delay of one in seconds, and the number of
        messages that were left out because they have no valid stamp.
    """
    publishers: dict[str, zenoh.Publisher] = {}
    sent, max_late_s, damaged = 0, 0.0, 0
    while not stop.is_set():
        first_ns: int | None = None
        for topic, log_ns, payload in read(path):
            if topic not in topics.PLAYED:
                continue
            if first_ns is None:
                first_ns, begin_s, begin_ns = log_ns, time.monotonic(), time.time_ns()
            late_s = _sleep_until(begin_s + (log_ns - first_ns) * 1e-9, stop)
            if stop.is_set():
                break
            if topic.type != "json":
                try:
                    payload = _shift_stamp(payload, begin_ns - first_ns)
                except (DecodeError, struct.error):  # too short, or a stamp out of range
                    damaged += 1
                    continue
            if topic.key not in publishers:
                publishers[topic.key] = declare_publisher(session, topic, settings)
            publishers[topic.key].put(payload)
            sent, max_late_s = sent + 1, max(max_late_s, late_s)
        if first_ns is None:
            raise RecordingError(f"{path}: holds no message of a sensor")
    for publisher in publishers.values():
        publisher.undeclare()
    return sent, max_late_s, damaged


def _sleep_until(deadline_s: float, stop: threading.Event) -> float:
    """Sleep until a time of the monotonic clock; return the delay in seconds."""
    rest_s = deadline_s - time.monotonic()
    if rest_s > 0.2:
        stop.wait(rest_s)
    elif rest_s > 0:
        time.sleep(rest_s)  # more accurate than Event.wait
    return max(0.0, time.monotonic() - deadline_s)


def _shift_stamp(payload: bytes, by_ns: int) -> bytes:
    """Return the payload, CDR that begins with a std_msgs/Header, with its stamp shifted."""
    stamp = STAMP.pack(*divmod(peek_stamp_ns(payload) + by_ns, 1_000_000_000))
    at = len(HEADER)
    return b"".join((payload[:at], stamp, memoryview(payload)[at + STAMP.size :]))


def wait_for_service(
    session: zenoh.Session, settings: ZenohConfig, timeout_s: float, stop: threading.Event
) -> bool:
    """Return True once a service subscribes to odometry, as each one does; False if none came."""
    deadline_s = time.monotonic() + timeout_s
    publisher = declare_publisher(session, topics.ODOMETRY, settings)
    try:
        while not publisher.matching_status.matching:
            if time.monotonic() >= deadline_s or stop.wait(0.05):
                return False
        return True
    finally:
        publisher.undeclare()


@contextmanager
def player(config: Config, path: str | os.PathLike[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Play a recording in another process. It waits for the service, and ends with the block.

    Raises:
        RecordingError: no such file (the process reports other errors on stderr).
    """
    if not Path(path).is_file():
        raise RecordingError(f"{path}: no such file")
    command = [*python_module("edge.sources.recording"), str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE)
    try:
        # Not as arguments: every user of this computer can read those.
        with suppress(BrokenPipeError), process.stdin as settings:  # it reports why it failed
            settings.write(config.zenoh.model_dump_json().encode() + b"\n")
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


# -- commands -----------------------------------------------------------------------------------


def run(args: argparse.Namespace) -> int:
    """Run `edge record`; return 1 if a sensor that the map needs sent nothing."""
    config = load(args.config)
    stop = stop_on_signals()
    with _session(config, stop) as session:
        written = record(session, config, args.out, args.seconds, stop)
    print(f"{args.out}: {written.total()} messages")
    for topic, n in sorted(written.items()):
        print(f"{n:8} {topic}")
    if not written:
        print(f"nothing received at {config.zenoh.address}: does the robot send its sensors there?")
        return FAILED
    # Our names of the topics of which there is a message, compressed or not.
    received = {name for name in SUBSCRIBED if any(f"/{name}{end}" in written for end in _ENDINGS)}
    if TF in received:  # tf can replace odometry
        received.add(ODOMETRY)
    missing = list(missing_inputs(config, received))
    if missing:
        print(f"nothing received from {', '.join(missing)} (source.kind: {config.source.kind}): no "
              "map can be built from this recording")  # fmt: skip
    return FAILED if missing else os.EX_OK


@contextmanager
def _session(config: Config, stop: threading.Event) -> Iterator[zenoh.Session]:
    """Open a session; if no service runs, listen in its place, so that the robot can connect."""
    with ExitStack() as stack:
        session = None
        if config.zenoh.mode == "peer":
            with suppress(BusError, ConfigError):  # in use, or only the service may listen here
                session = stack.enter_context(zenoh_session(config.zenoh, "listen", stop))
                log.warning(
                    "no service runs at %s: the recording listens in its place; end it before you "
                    "start `edge run`", config.zenoh.address,
                )  # fmt: skip
        if session is None:
            session = stack.enter_context(zenoh_session(config.zenoh, "connect", stop))
        yield session


def main(path: str) -> int:
    """Run `python -m edge.sources.recording FILE`, which `player` starts.

    The first line of standard input is the section `zenoh` of a configuration, as JSON.
    """
    settings = ZenohConfig.model_validate_json(sys.stdin.readline())
    stop = stop_on_signals()
    try:
        with open_session(settings, "connect", stop) as session:
            if not wait_for_service(session, settings, _SERVICE_S, stop):
                raise UnavailableError(
                    f"{settings.address}: no service within {_SERVICE_S:g} s; start one with "
                    "`edge run`"
                )
            sent, max_late_s, damaged = play(session, settings, path, stop)
    except UserError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    ending = f"; {damaged} damaged ones were left out" if damaged else ""
    print(f"{path}: {sent} messages, at most {max_late_s * 1e3:.1f} ms late{ending}")
    return os.EX_OK


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
