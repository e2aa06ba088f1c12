"""Source that plays a recording of any robot, as if its messages arrived now.

The clock is the log time of the recording: it times waiting frames and rates. So results do not
depend on the speed of playback.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import zenoh

from edge.bus import topics
from edge.bus.topics import Topic
from edge.bus.wire import DecodeError, messages
from edge.bus.wire.schemas import full_name
from edge.bus.wire.transforms import decode_transforms
from edge.config import Config
from edge.loop.source import InputStatus
from edge.recording.bag import Bag
from edge.recording.file import RecordedMessage, RecordingError
from edge.sources.contents import (
    ODOMETRY,
    TF,
    TF_STATIC,
    RecordingContents,
    missing_inputs,
    read_contents,
)
from edge.sources.decoder import KINDS
from edge.sources.polled import PolledSource
from edge.sources.synchronizer import streams_of
from edge.sources.tf import RobotFrames
from edge.sources.topic_matching import match_topics
from edge.text import format_table, one_line
from edge.types import CAMERAS, Observation

log = logging.getLogger("edge.sources.played")

_TOPICS = {topic.key: topic for topic in topics.ALL if topic.writer == "sensors"}
_MAX_GAP_NS = 30_000_000_000  # a longer time without messages is skipped
_REST_NS = 1_000_000_000  # time after the last message in which frames wait for their poses
_AHEAD_BYTES = 1 << 26  # limit of messages that are read in advance
_MAX_BATCH = 256  # messages; between batches the loop handles signals
_ABSENT = "not in the recording"


class PlayedSource(PolledSource):
    """Source of the sensors in a recording.

    Args:
        session: an open session, for goal statuses.
        rate: playback speed, 1.0 = real time; late frames are dropped, as on a robot. None: as fast
            as the loop runs; no frame is late.

    Attributes:
        is_over: True once all messages were played.
    """

    def __init__(
        self, config: Config, session: zenoh.Session, playback: Playback, rate: float | None
    ) -> None:
        contents, matched = playback.contents, playback.matched
        self._matched, self._rate, self.is_over = matched, rate, False
        # Log times: present, of the newest processed message, and of the first one.
        self._now_ns = self._last_ns = self._first_ns = contents.first_ns
        self._tf_frames = RobotFrames(_with_limited_wait(matched.config)) if matched.by_tf else None
        super().__init__(_with_limited_wait(config), session, self._tf_frames, lambda: self._now_ns)
        inputs = self._synchronizer.inputs
        if matched.by_tf:
            for name in (TF, TF_STATIC):
                inputs.add(name, TF, needed=True)
                inputs.listen(name, one_line(matched.topics.get(name, _ABSENT), 80))
        self._process_static(contents)
        self._names = {topic: name for name, topic in matched.topics.items()}  # our names
        self._types = {topic: contents.topics[topic].type for topic in self._names}
        self._messages = playback.bag.by_time(self._names.keys(), contents.nearly_sorted)
        self._ahead = None if rate is None else _ReadAhead(self._messages)
        if self._ahead is not None:
            self._messages = self._ahead
        self._next = next(self._messages, None)
        if self._next is not None:  # other topics may have begun earlier
            self._now_ns = self._last_ns = self._first_ns = self._next.log_ns
        self._began_ns: int | None = None  # monotonic time of the start
        self._skipped_ns = 0  # log time without messages that was skipped

    def _process_static(self, contents: RecordingContents) -> None:
        """Process all of tf_static at once, as a late subscriber would get it."""
        if self._tf_frames is not None:
            for payload in contents.static.get(self._matched.topics.get(TF_STATIC, ""), ()):
                with suppress(DecodeError):  # counted when the message is played
                    self._tf_frames.take(payload, static=True)

    def clock(self) -> int:
        """Return the current log time of the recording, in ns."""
        if self._rate is None:
            return self._now_ns
        if self._began_ns is None:
            self._began_ns = time.monotonic_ns()
        passed_ns = int((time.monotonic_ns() - self._began_ns) * self._rate)
        return self._first_ns + passed_ns + self._skipped_ns

    def close(self) -> None:
        super().close()
        if self._ahead is not None:
            self._ahead.close()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the recording may have messages; see `edge.loop.source.Source`."""
        if self.is_over:
            time.sleep(timeout_s)
        return not self.is_over

    def poll(self) -> Observation | None:
        """Return the newest observation; see `edge.loop.source.Source`."""
        if self._rate is not None:
            return super().poll()
        for _ in range(_MAX_BATCH):
            observation = self._synchronizer.poll()
            if observation is not None or self.is_over:
                return observation
            self._advance()
        return self._synchronizer.poll()

    def _where(self, topic: Topic) -> str:
        if topic.key == ODOMETRY and self._matched.moving_frame:
            return f"{one_line(self._matched.topics.get(TF, _ABSENT), 80)} (poses)"
        return one_line(self._matched.topics.get(topic.key, _ABSENT), 80)

    def _drain(self) -> int:
        """Process the messages up to the present log time; return their number."""
        now_ns, n = self.clock(), 0
        while self._next is not None and self._next.log_ns <= now_ns and n < _MAX_BATCH:
            self._advance()
            n += 1
        if n < _MAX_BATCH:
            self._now_ns = max(self._now_ns, now_ns)
            self.is_over = self._next is None and now_ns - self._last_ns > _REST_NS
        return n

    def _advance(self) -> None:
        """Process the next message; at the end, stop waiting for poses of the last frames."""
        message = self._next
        if message is None:
            self._now_ns += _REST_NS
            self._decoder.convert_waiting_poses()
            self.is_over = True
            return
        self._now_ns = self._last_ns = max(self._now_ns, message.log_ns)
        try:
            self._process(message)
        finally:
            self._next = next(self._messages, None)
            if self._next is not None and self._next.log_ns - self._now_ns > _MAX_GAP_NS:
                gap_ns = self._next.log_ns - self._now_ns
                self._skipped_ns += gap_ns
                log.info("skipping %.0f s without messages in the recording", gap_ns * 1e-9)

    def _process(self, message: RecordedMessage) -> None:
        """Pass one recorded message to the decoder, or to tf."""
        name = self._names[message.topic]
        self._decoder.convert_waiting_poses()
        if name not in (TF, TF_STATIC):
            if not self._is_too_large(name, message.payload):
                type_name = self._types[message.topic].replace("/msg/", "/")
                self._decoder.offer(_TOPICS[name], message.payload, type_name)
        elif self._tf_frames is not None:
            self._take_transforms(name, message.payload, self._tf_frames, name == TF_STATIC)
            if self._matched.moving_frame and name == TF:
                self._process_poses(message.payload)

    def _process_poses(self, payload: bytes) -> None:
        """Process poses from tf, for a recording without odometry."""
        with suppress(DecodeError):  # counted already
            for t in decode_transforms(payload)[0]:
                if t.child == self._matched.moving_frame:
                    self._synchronizer.received(ODOMETRY)
                    sample = messages.OdometryMessage(t.stamp_ns, t.T, 0.0, 0.0, t.parent, t.child)
                    self._decoder.offer_pose(sample)


class _ReadAhead:
    """Iterator that reads messages in advance on a thread.

    So decompressing a large chunk blocks no tick.
    """

    def __init__(self, messages: Iterator[RecordedMessage]) -> None:
        self._read: deque[RecordedMessage] = deque()  # not yet taken
        self._bytes = 0  # of these
        self._over = self._closed = False
        self._error: Exception | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(
            target=self._run, args=(messages,), name="recording", daemon=True
        )
        self._thread.start()

    def __iter__(self) -> Iterator[RecordedMessage]:
        return self

    def __next__(self) -> RecordedMessage:
        with self._changed:
            self._changed.wait_for(lambda: self._read or self._over)
            if not self._read:
                # An error of the thread is raised once; then the iteration is over.
                error, self._error = self._error, None
                raise error or StopIteration
            message = self._read.popleft()
            self._bytes -= len(message.payload)
            self._changed.notify()
            return message

    def close(self) -> None:
        """Stop reading."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self, messages: Iterator[RecordedMessage]) -> None:
        """Read messages until the limit of bytes, then whenever there is room."""
        try:
            for message in messages:
                with self._changed:
                    self._changed.wait_for(lambda: self._bytes < _AHEAD_BYTES or self._closed)
                    if self._closed:
                        return
                    self._read.append(message)
                    self._bytes += len(message.payload)
                    self._changed.notify()
        except Exception as error:
            self._error = error
        finally:
            with self._changed:
                self._over = True
                self._changed.notify()


class Playback:
    """A recording with the configuration that plays it; a context manager.

    Attributes:
        needed_topics: our names of the topics that the configuration needs.
        read_s: duration in seconds of the first pass over the file.
        source: the source, once a service has opened it.

    Raises:
        RecordingError: it cannot be read; one line.
    """

    def __init__(
        self, path: Path, config: Config, rate: float | None, stop: threading.Event | None = None
    ) -> None:
        self.bag, self._config, self._rate = Bag(path), _with_limited_wait(config), rate
        self._stop = stop or threading.Event()
        self.source: PlayedSource | None = None

    def __enter__(self) -> Playback:
        begin_s = time.perf_counter()
        log.info("reading %s", self.bag.path)
        self.bag.__enter__()
        try:
            self.contents = read_contents(self.bag, self._stop)
        except BaseException:
            self.bag.__exit__()
            raise
        self.read_s = time.perf_counter() - begin_s
        used_fields, n_cameras = streams_of(self._config), len(self._config.sensors.cameras)
        self.needed_topics = [
            topic.key
            for topic in _TOPICS.values()
            if (topic not in KINDS or KINDS[topic].field in used_fields)
            and (n_cameras > 1 or not topic.key.startswith(CAMERAS[1]))
        ]
        self.matched = match_topics(self._config, self.contents, self.needed_topics)
        return self

    def __exit__(self, *error: object) -> None:
        self.bag.__exit__(*error)

    def open(self, config: Config, session: zenoh.Session) -> PlayedSource:
        """Open the source; see `edge.sources.find_source`."""
        self.source = PlayedSource(config, session, self, self._rate)
        return self.source

    def clock(self) -> int:
        """Return the log time in ns; see `edge.loop.runner.RunningService`."""
        return self.contents.first_ns if self.source is None else self.source.clock()

    @property
    def has_bus_topics(self) -> bool:
        """True if the messages can be sent on the bus as they are, for the source `zenoh`.

        The file must be undamaged, and each topic must have the name and type of a bus topic.
        """
        found, matched = self.contents.topics, self.matched
        unchanged = (
            topic == f"/{name}" and found[topic].type == full_name(_TOPICS[name].type)
            for name, topic in matched.topics.items()
        )
        return bool(matched.topics) and not (matched.by_tf or self.bag.notes) and all(unchanged)

    @property
    def is_over(self) -> bool:
        """True once all was played."""
        return self.source is not None and self.source.is_over

    def check(self) -> None:
        """Raise an error for a recording that can give no observation.

        Raises:
            RecordingError: one line with what was searched for and what was found.
        """
        if self._missing_inputs():
            raise self._no_observation_error()

    def describe_contents(self) -> Iterator[str]:
        """Yield lines about the contents of the recording and what of it is played."""
        found = self.contents
        n = sum(facts.count for facts in found.topics.values())
        yield f"{self.bag.path}: {found.seconds:.1f} s, {n} messages, {len(found.topics)} topics"
        yield from self.bag.notes
        yield from self.matched.lines
        used = set(self.matched.topics.values())
        unused = RecordingContents({t: facts for t, facts in found.topics.items() if t not in used})
        if unused.topics:
            yield f"not used: {unused.topic_list()}"

    def describe_outcome(self) -> Iterator[str]:
        """Yield lines about what happened to the messages.

        Raises:
            RecordingError: there was no observation.
        """
        rows = () if self.source is None else self.source.input_table()
        n = 0 if self.source is None else self.source.counters["observations"]
        if n == 0:
            raise self._no_observation_error(rows)
        table = [("input", "topic", "messages", "dropped")]
        table += [(row.name, row.where, row.received, _describe_drops(row)) for row in rows]
        yield format_table(table)
        late = self.source.counters["superseded"]
        yield f"{n} observations; {late} frames were replaced by newer ones"

    def _missing_inputs(self) -> list[str]:
        """Return the inputs that an observation needs and the recording lacks."""
        poses = [ODOMETRY] if self.matched.moving_frame else []
        return list(missing_inputs(self._config, [*self.matched.topics, *poses]))

    def _no_observation_error(self, rows: tuple[InputStatus, ...] = ()) -> RecordingError:
        """Return the error of a recording that gives no observation."""
        missing = ", ".join(self._missing_inputs())
        dropped = [
            f"{row.name} ({row.where}): {_describe_drops(row)}" for row in rows if row.dropped
        ]
        parts = [
            f"searched for {', '.join(self.needed_topics)}",
            f"found no {missing}" if missing else "",
            f"dropped {'; '.join(dropped)}" if dropped else "",
            f"the recording has {self.contents.topic_list()}",
            *self.bag.notes,
            "set ros2.topics (names of topics) or mapping.input (what the map is made of)",
        ]
        details = "; ".join(filter(None, parts))
        return RecordingError(f"{self.bag.path}: it gives no observation: {details}")


def _with_limited_wait(config: Config) -> Config:
    """Return the configuration of a source that waits for a limited time, not forever."""
    return config.model_copy(update={"loop": config.loop.model_copy(update={"lockstep": False})})


def _describe_drops(row: InputStatus) -> str:
    """Describe why messages of an input were not used, most frequent reason first."""
    reasons = sorted(row.dropped.items(), key=lambda item: -item[1])
    return ", ".join(f"{n} {reason}" for reason, n in reasons) or "-"
