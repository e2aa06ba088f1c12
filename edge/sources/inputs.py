"""Table of inputs: rate, age and reasons of drops for each topic that a source receives.

The time synchronizer owns it, because every message and every drop passes there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from edge.config import Config
from edge.loop.source import InputState, InputStatus
from edge.sources.messages import (
    CameraInfo,
    CameraInfo2,
    Cloud,
    DepthImage,
    DepthImage2,
    Image,
    Image2,
    LaserScanFrame,
    Odometry,
)
from edge.sources.streams import Stream

SILENT_S = 1.0
"""An input is silent after this time, or after three periods if that is longer."""
_WINDOW_NS = 2_000_000_000  # for measuring rates
_NO_FAULT = ("superseded",)
"""Reasons that are no fault: a newer message was used instead."""


@dataclass(slots=True, eq=False)
class _Input:
    """Counters of one input.

    Attributes:
        name: the topic in `edge/bus/topics.py`.
        where: key, ROS topic or address of the input.
        group: inputs of one group can replace each other.
        needed: True if the robot cannot work without the group.
        expected_hz: configured rate; 0 for topics on events, which are never silent.
        silent_ns: an input without messages for this time is silent.
        came_ns: arrival of the newest message; None: never.
        used_ns: when a message was last used; None: never.
        received: number of messages.
        warning: warning about messages that are used.
        warned_ns: when the warning was last set.
        dropped: number of dropped messages by reason.
        reason: reason of the drops since a message was last used; "": none was dropped.
        detail: more about that reason.
        hz: rate over the last window.
        since_ns: when the current window began.
        in_window: number of messages in the current window.
    """

    name: str
    where: str
    group: str
    needed: bool
    expected_hz: float
    silent_ns: float = field(init=False)
    came_ns: int | None = None
    used_ns: int | None = None
    received: int = 0
    warning: str = ""
    warned_ns: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    reason: str = ""
    detail: str = ""
    hz: float = 0.0
    since_ns: int = 0
    in_window: int = 0

    def __post_init__(self) -> None:
        hz = self.expected_hz
        self.silent_ns = max(SILENT_S, 3.0 / hz) * 1e9 if hz else math.inf

    def on_message(self, now_ns: int) -> None:
        """Count a message, and measure the rate once a window."""
        if self.came_ns is None or now_ns - self.came_ns > self.silent_ns:
            self.since_ns, self.in_window, self.hz = now_ns, 0, 0.0
        elif now_ns - self.since_ns >= _WINDOW_NS:
            self.hz = self.in_window * 1e9 / (now_ns - self.since_ns)
            self.since_ns, self.in_window = now_ns, 0
        self.received += 1
        self.in_window += 1
        self.came_ns = now_ns

    def current_warning(self, now_ns: int) -> str:
        """Return the warning, "" if it is old."""
        return self.warning if now_ns - self.warned_ns <= _WINDOW_NS else ""

    def state(self, now_ns: int) -> InputState:
        """Return the state of the input without regard to its group."""
        if self.came_ns is None:
            return "missing"
        if now_ns - self.came_ns > self.silent_ns:
            return "silent"
        unused = self.used_ns is None or now_ns - self.used_ns > self.silent_ns
        return "dropped" if self.reason and unused else "ok"


def group_of(field: str, camera_index: int) -> str:
    """Return the group of the inputs of a field of an observation."""
    return f"{field}2" if camera_index else field


class InputTable:
    """State of all inputs; a row of the table is one input.

    One thread writes; any thread may read `rows`.
    """

    def __init__(
        self, config: Config, streams: dict[str, Stream], clock: Callable[[], int]
    ) -> None:
        self._clock = clock
        self._inputs: list[_Input] = []
        self._by_name: dict[str, list[_Input]] = {}  # by name, and by `where`
        sensors = config.sensors
        lidar_hz = 0.0 if sensors.lidar is None else sensors.lidar.rate_hz
        # Objects are detected in images, whatever the map is made of.
        needed = {field for field, stream in streams.items() if stream.required} | {"rgb"}
        kinds = [(kind, sensors.camera.rate_hz) for kind in (Image, DepthImage)]
        kinds += [(kind, lidar_hz) for kind in (Cloud, LaserScanFrame)]
        infos = [CameraInfo]
        if sensors.second_camera is not None:
            kinds += [(kind, sensors.second_camera.rate_hz) for kind in (Image2, DepthImage2)]
            infos.append(CameraInfo2)
        for kind, hz in kinds:
            if kind.field in streams:
                group = group_of(kind.field, kind.camera_index)
                self.add(kind.topic, group, kind.field in needed, hz)
        for info in infos:
            group = group_of("camera", info.camera_index)
            self.add(info.topic, group, needed={"rgb", "depth_m"} & needed != set())
        self.add(Odometry.topic, "pose", needed=True, expected_hz=sensors.odometry_hz)

    def add(self, name: str, group: str, needed: bool, expected_hz: float = 0.0) -> None:
        """Add an input; for the arguments see `_Input`."""
        row = _Input(name, name, group, needed, expected_hz)
        self._inputs.append(row)
        self._by_name.setdefault(name, []).append(row)

    def listen(self, name: str, where: str) -> None:
        """Set where an input comes from; drops reported under that place count for the input."""
        for row in self._by_name.get(name, ()):
            row.where = where
            self._by_name.setdefault(where, []).append(row)

    def where(self, name: str) -> str:
        """Return the place an input comes from; its name if unknown."""
        return next((row.where for row in self._by_name.get(name, ())), name)

    # -- events, by name or place; those of unknown inputs are ignored ---------------------------

    def on_message(self, name: str) -> None:
        """Count a message."""
        now_ns = self._clock()
        for row in self._by_name.get(name, ()):
            row.on_message(now_ns)

    def on_used(self, name: str) -> None:
        """Record that a message was used."""
        for row in self._by_name.get(name, ()):
            row.used_ns, row.reason = self._clock(), ""

    def on_dropped(self, name: str, reason: str, detail: str = "") -> None:
        """Count a drop.

        For repeated drops with one reason the first detail is kept, so that the text does not
        flicker. The detail of missing transforms is updated, because it changes only with tf.
        """
        for row in self._by_name.get(name, ()):
            row.dropped[reason] = row.dropped.get(reason, 0) + 1
            if reason not in _NO_FAULT and (reason != row.reason or reason == "no_transform"):
                row.reason, row.detail = reason, detail

    def warn(self, name: str, warning: str) -> None:
        """Record a warning about messages that are used. The first of a series is kept."""
        now_ns = self._clock()
        for row in self._by_name.get(name, ()):
            if not row.current_warning(now_ns):
                row.warning = warning
            row.warned_ns = now_ns

    def on_unpaired(self, group: str, detail: str) -> None:
        """Record that an observation was made without these optional inputs."""
        for row in self._inputs:
            if row.group == group and not row.reason:
                row.reason, row.detail = "unpaired", detail

    # -- for any thread ---------------------------------------------------------------------------

    def rows(self) -> tuple[InputStatus, ...]:
        """Return the current table."""
        now_ns = self._clock()
        states = [row.state(now_ns) for row in self._inputs]
        # A missing input whose group has another one is not missing, but unused.
        active = {
            row.group for row, state in zip(self._inputs, states, strict=True) if state != "missing"
        }
        return tuple(
            _make_status(
                row, "unused" if state == "missing" and row.group in active else state, now_ns
            )
            for row, state in zip(self._inputs, states, strict=True)
        )


def _make_status(row: _Input, state: InputState, now_ns: int) -> InputStatus:
    """Return the row of the table for an input."""
    came_ns, hz = row.came_ns, row.hz
    if not hz and came_ns is not None and came_ns > row.since_ns:  # still in the first window
        # n messages have n - 1 periods between them.
        hz = (row.in_window - 1) * 1e9 / (came_ns - row.since_ns)
    why = row.current_warning(now_ns) if state == "ok" else ""
    if state == "dropped":
        why = f"{row.reason}{row.detail and f' ({row.detail})'}"  # no brackets without a detail
    if hz and now_ns - came_ns > max(SILENT_S, 3.0 / hz) * 1e9:
        hz = 0.0
    return InputStatus(
        name=row.name,
        where=row.where,
        group=row.group,
        needed=row.needed,
        state=state,
        why=why,
        hz=round(hz, 1),
        expected_hz=row.expected_hz,
        age_s=None if came_ns is None else round(max(now_ns - came_ns, 0) * 1e-9, 2),
        received=row.received,
        dropped=dict(row.dropped),
    )
