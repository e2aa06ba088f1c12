"""Sink that keeps the data of the live page while a person views the page.

A mark is a letter that the page draws at a candidate in the image, if the choice scorer was asked
about the candidate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from edge import names
from edge.geometry import Grid
from edge.live.trail import DrivenPath
from edge.loop.result import Event, TickResult
from edge.memory import KnownObject, MappedRoom, Site
from edge.perception.scoring.choice.picture import visible_marks
from edge.perception.scoring.choice.question import LETTERS, FrontierChoice
from edge.policies.base import FRONTIER
from edge.tasks.facts import TaskStatus, same_text
from edge.types import Detections, Observation

WATCHED_S = 10.0
"""Time after the last request in which the page counts as viewed."""
PERIOD_S = 0.2
"""Period of the page's data and of images."""
OBJECTS_S = 1.0
"""Period of the lists of remembered objects, rooms and layers, and of the parts' status."""
MAX_EVENTS = 400
MAX_SHOT_PX = 960  # longer side of an image
MAX_BOXES = 60  # of targets, and of other objects
_WINDOW_S = 1.0  # over which ticks are counted
_UNBOXED_S = 0.5  # after this time without detections, images are shown without boxes
_TRAIL_POSES = 2048


@dataclass(frozen=True, slots=True, eq=False)
class LiveSnapshot:
    """State of the service in one tick.

    Attributes:
        result: the result of the tick, of which mission, task, instances, candidates and path are
            computed. Of the other functions, use only those that other threads may call.
        n_tasks: version of the task: increases when it changes, except for progress along it.
        site: places and zones.
        n_sites: version of `site`.
        layers: name of a layer → function that returns the grid to draw.
        parts: see `edge.loop.result.TickResult`.
        mark_letters: candidate id → letter of its mark, and its probability by the model.
        trail: (n, 3) float64 poses of the driven path: x and y in metres, yaw in radians.
        tick_hz: ticks with an observation per second.
        proposals: proposals of agents that wait for a person.
        n_events: number of events since the start.
    """

    result: TickResult
    n_tasks: int
    objects: Sequence[KnownObject]
    rooms: Sequence[MappedRoom]
    site: Site
    n_sites: int
    layers: dict[str, Callable[[], Grid]]
    parts: dict[str, Any]
    mark_letters: dict[int, tuple[str, float]]
    trail: np.ndarray
    tick_hz: float
    proposals: list[dict[str, object]]
    events: tuple[Event, ...]
    n_events: int


class Box(NamedTuple):
    """A detection in an image.

    Attributes:
        label: class name.
        wanted: True if the class is a target.
        xyxy: left, top, right, bottom, in fractions of the image's width and height.
    """

    label: str
    score: float
    wanted: bool
    xyxy: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CameraShot:
    """A camera image.

    Attributes:
        rgb: (h, w, 3) uint8, a copy, subsampled if it was large.
        boxes: detections of targets and of other objects.
        marks: (letter, u, v) of the marks in view; u and v in fractions of the image's width and
            height.
    """

    seq: int
    rgb: np.ndarray
    boxes: tuple[Box, ...]
    marks: tuple[tuple[str, float, float], ...]


class LiveSink:
    """A sink that costs almost nothing while no person views the page.

    Attributes:
        snapshot: the newest state; None while no person views the page.
        shots: the newest image of each camera, by `camera_index`; empty without a viewer.
        ticked_s: time of the loop's last tick, on the clock; None: never.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.snapshot: LiveSnapshot | None = None
        self.shots: Mapping[int, CameraShot] = {}
        self.ticked_s: float | None = None
        self._viewed_s = self._due_s = self._objects_due_s = -math.inf
        self._boxed_s: dict[int, float] = {}  # by camera: time of the last image with boxes
        self._shot_due_s: dict[int, float] = {}
        self._trail = DrivenPath(_TRAIL_POSES)
        self._events: tuple[Event, ...] = ()
        self._site = Site()
        self._task: TaskStatus | None = None
        self._n_events = self._n_shots = self._n_tasks = self._n_sites = 0
        self._window_s, self._n_ticks = 0.0, 0  # start of the window, ticks in it
        self._tick_hz = 0.0  # rate in the last window

    # -- for any thread ------------------------------------------------------------------------

    def mark_watched(self) -> float:
        """Record that a person views the page; return the time on the sink's clock."""
        self._viewed_s = self._clock()
        return self._viewed_s

    # -- on the loop's thread ------------------------------------------------------------------

    def tick(self, result: TickResult) -> None:
        """Keep the state if the page is viewed; see `edge.loop.result.Sink`."""
        now_s = self.ticked_s = self._clock()
        if result.events:
            self._n_events += len(result.events)
            self._events = (*self._events, *result.events)[-MAX_EVENTS:]
        if result.observation is not None:
            self._n_ticks += 1
            if result.pose is not None:
                self._trail.append(result.now_ns, result.pose)
        if now_s - self._window_s >= _WINDOW_S:
            self._tick_hz = self._n_ticks / (now_s - self._window_s)
            self._window_s, self._n_ticks = now_s, 0
        if now_s - self._viewed_s > WATCHED_S:
            self._drop()
            return
        if now_s >= self._due_s:
            self._due_s = now_s + PERIOD_S
            self._keep(result, now_s)
        if (detections := result.detections) is not None:
            self._boxed_s[detections.observation.camera_index] = now_s
            self._copy_image(detections.observation, result, now_s)
        if (newest := result.observation) is not None:
            boxed_s = self._boxed_s.get(newest.camera_index, -math.inf)
            if now_s - boxed_s > _UNBOXED_S:
                self._copy_image(newest, result, now_s)

    def close(self) -> None:
        """Do nothing; see `edge.loop.result.Sink`."""

    def _drop(self) -> None:
        """Free the map that a snapshot holds."""
        self.snapshot, self.shots = None, {}

    def _keep(self, result: TickResult, now_s: float) -> None:
        """Collect the state of the service; what is expensive only once a second."""
        choice, task = result.choice, result.task()
        self._n_tasks += not same_text(task, self._task)
        self._task = task
        self._n_sites += result.site is not self._site
        self._site = result.site
        if (before := self.snapshot) is None or now_s >= self._objects_due_s:
            self._objects_due_s = now_s + OBJECTS_S
            slow = result.objects(), result.rooms, result.layers(), result.parts()
        else:
            slow = before.objects, before.rooms, before.layers, before.parts
        objects, rooms, layers, parts = slow
        for compute in (result.mission, result.instances, result.candidates, result.path):
            compute()
        self.snapshot = LiveSnapshot(
            result=result,
            n_tasks=self._n_tasks,
            objects=objects,
            rooms=rooms,
            site=self._site,
            n_sites=self._n_sites,
            layers=layers,
            parts=parts,
            mark_letters={} if choice is None else _letters_by_candidate(choice),
            trail=self._trail.arrays()[0],
            tick_hz=self._tick_hz,
            proposals=result.proposals(),
            events=self._events,
            n_events=self._n_events,
        )

    def _copy_image(self, observation: Observation, result: TickResult, now_s: float) -> None:
        """Copy an image, with the boxes that were found in it, if its camera's next one is due."""
        index = observation.camera_index
        if observation.rgb is None or now_s < self._shot_due_s.get(index, -math.inf):
            return
        self._shot_due_s[index] = now_s + PERIOD_S
        detections, boxes = result.detections, ()
        if detections is not None and detections.observation is observation:
            boxes = _boxes(detections, result.targets.values())
        stride = math.ceil(max(observation.rgb.shape[:2]) / MAX_SHOT_PX)
        self._n_shots += 1
        shot = CameraShot(
            self._n_shots,
            np.array(observation.rgb[::stride, ::stride]),
            boxes,
            _visible_letters(observation, result),
        )
        self.shots = {**self.shots, index: shot}  # a new one: other threads read the old one


def _letters_by_candidate(choice: FrontierChoice) -> dict[int, tuple[str, float]]:
    """Return (letter, probability) of each candidate that the model was asked about, by id."""
    entries = zip(choice.ids, LETTERS, choice.p.tolist(), strict=False)
    return {candidate: (letter, p) for candidate, letter, p in entries}


def _boxes(detections: Detections, targets: Collection[str]) -> tuple[Box, ...]:
    """Return the boxes of the targets, then those of other objects."""
    rgb, boxes = detections.observation.rgb, []
    if rgb is None:
        return ()
    height, width = rgb.shape[:2]
    for entries in (detections, detections.context_detections()):
        if entries is not None:
            shares = (entries.xyxy_px / np.float32([width, height, width, height])).tolist()
            rows = zip(entries.class_id.tolist(), entries.score.tolist(), shares, strict=True)
            boxes += [
                (entries.prompts[i], score, xyxy) for i, score, xyxy in list(rows)[:MAX_BOXES]
            ]
    return tuple(
        Box(label, score, names.same_as_any(label, targets), tuple(xyxy))
        for label, score, xyxy in boxes
    )


def _visible_letters(
    observation: Observation, result: TickResult
) -> tuple[tuple[str, float, float], ...]:
    """Return letters and image positions of frontiers that still exist and are in view."""
    camera, choice = observation.camera, result.choice
    if camera is None or choice is None:
        return ()
    letters, candidates = _letters_by_candidate(choice), result.candidates()
    has_letter = np.isin(candidates.id, choice.ids) & (candidates.kind == FRONTIER)
    marks = visible_marks(observation, candidates.xy_m[has_letter], candidates.id[has_letter])
    return tuple(
        (letters[m.id][0], (m.u_px + 0.5) / camera.width_px, (m.v_px + 0.5) / camera.height_px)
        for m in marks
    )
