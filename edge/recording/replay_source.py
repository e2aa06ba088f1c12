"""Replay source: stand-ins for the loop's workers, which give the recorded answers in time.

The loop gives a worker a question (an item), and polls its answer in a later tick.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from edge.loop.behaviours.plan_worker import PlanResult
from edge.loop.input_log import InputLog, LoopInput
from edge.perception.runtime.health import ModelHealth
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies.base import ImageSimilarity
from edge.recording import journal
from edge.recording.file import RecordingError
from edge.types import Detections, Observation

_MAX_FRAMES = 256  # frames that wait for their detections
_MAX_FRAMES_BYTES = 1 << 30  # a recording of 1 MB may hold 256 frames of 100 MB


class NullModel:
    """A stand-in for a model, whose answers are in the recording."""

    prompts: tuple[str, ...] = ()
    invalid_boxes = 0

    def __init__(self, name: str) -> None:
        self.name = name

    def set_prompts(self, prompts: Sequence[str]) -> None:
        self.prompts = tuple(prompts)

    def detect(self, observation: Observation) -> Detections:
        raise AssertionError("a model is not called in a replay")

    prepare = answer = score = detect  # other models' methods, which are not called either

    def health(self) -> ModelHealth:
        return ModelHealth()

    def close(self) -> None:
        """Do nothing."""


@dataclass
class ReplayTick:
    """Recorded worker events and decisions of the replayed tick, and frames of earlier ticks.

    Attributes:
        asked: names of the workers that got a question in this tick.
        found: answers of this tick, by worker, as JSON.
        frames: observations that may still get detections, by number.
        pictures: numbers of the frames with a recorded image.
    """

    asked: set[str] = field(default_factory=set)
    found: dict[str, dict[str, Any]] = field(default_factory=dict)
    decided: dict[str, str] = field(default_factory=dict)
    frames: dict[int, Observation] = field(default_factory=dict)
    pictures: set[int] = field(default_factory=set)

    def begin(self, entries: Sequence[LoopInput]) -> None:
        """Set the events and decisions of the next tick."""
        self.asked = {e.fields["worker"] for e in entries if e.kind == "request"}
        self.found = {e.fields["worker"]: e.fields["result"] for e in entries if e.kind == "result"}
        self.decided = {
            e.fields["name"]: e.fields["value"] for e in entries if e.kind == "decision"
        }

    def add_frame(self, observation: Observation, picture: bool) -> None:
        """Keep a frame for later detections, and forget the oldest above the limits."""
        self.frames[observation.seq] = observation
        if picture:
            self.pictures.add(observation.seq)
        while len(self.frames) > 1 and (
            len(self.frames) > _MAX_FRAMES
            or sum(map(_bytes_of, self.frames.values())) > _MAX_FRAMES_BYTES
        ):
            self._forget(next(iter(self.frames)))

    def frame(self, seq: int) -> Observation:
        """Return the frame of this number and forget older ones; detections come in order."""
        for old in [old for old in self.frames if old < seq]:
            self._forget(old)
        if seq not in self.frames:
            raise RecordingError(f"damaged: there are detections of frame {seq}, but no such frame")
        return self.frames[seq]

    def _forget(self, seq: int) -> None:
        del self.frames[seq]
        self.pictures.discard(seq)


def _bytes_of(observation: Observation) -> int:
    arrays = (getattr(observation, f.name) for f in fields(observation))
    return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


class _ReplayedWorker:
    """A stand-in for a worker: it gets questions and gives answers in the recorded ticks."""

    def __init__(
        self, name: str, worker: Any, now: ReplayTick, decode: Callable[[dict[str, Any], Any], Any]
    ) -> None:
        self._name, self._worker, self._now, self._decode = name, worker, now, decode
        # In one tick an answer may come after the next question.
        self._questions: deque[Any] = deque(maxlen=2)

    def __getattr__(self, name: str) -> Any:  # other attributes are the worker's
        return getattr(self._worker, name)

    @property
    def idle(self) -> bool:
        """True in the recorded ticks with a question: the loop asks only an idle worker."""
        return self._name in self._now.asked

    def submit(self, item: Any) -> None:
        self._questions.append(item)

    def poll(self) -> Any:
        answer = self._now.found.get(self._name)
        return None if answer is None else self._decode(answer, self._questions)

    def discard_all(self) -> None:
        self._questions.clear()


class ReplaySource(InputLog):
    """Replaces the loop's workers by the recorded answers.

    Args:
        now: recorded events of the current tick.
        detect: runs a detector on the recorded images; None: recorded detections are used.
        real_workers: names of workers that run for real.

    Attributes:
        n_unrecorded: number of images for `detect` that were not recorded.
    """

    def __init__(
        self,
        now: ReplayTick,
        detect: Callable[[Observation], Detections] | None,
        real_workers: Sequence[str],
    ) -> None:
        super().__init__()
        self.n_unrecorded = 0
        self._now, self._detect, self._real_workers = now, detect, real_workers
        # Worker → function (answer as JSON, questions that wait) that returns its result.
        self._decode: dict[str, Callable[[dict[str, Any], Any], Any]] = {
            "detector": self._decode_detections,
            "travel_cost": lambda answer, _: journal.decoded(np.ndarray, answer["distance_m"]),
            "rooms": lambda answer, _: journal.rooms_of(answer),
            "similarity": self._decode_similarity,
            "choice": self._decode_choice,
            "task": lambda answer, _: journal.decoded(PlanResult, answer),
        }

    def record_decision(
        self, what: str, decide: Callable[[], str], usual: str | None = None
    ) -> str:
        """Return the recorded decision; if there is none, the usual decision.

        Without a usual decision, decide now: other settings may need a decision that was not
        recorded.
        """
        decision = self._now.decided.get(what, usual)
        return decide() if decision is None else decision

    def wrap(self, name: str, worker: Any) -> Any:
        """Return the stand-in for a worker, or the worker if it runs for real."""
        if name in self._real_workers:
            return worker
        return _ReplayedWorker(name, worker, self._now, self._decode[name])

    def _decode_detections(self, answer: dict[str, Any], questions: Any) -> Detections | None:
        """Return the recorded detections, or new ones; None if the image was not recorded."""
        observation = self._now.frame(answer["seq"])
        if self._detect is None:
            return journal.detections_of(answer, observation)
        if answer["seq"] not in self._now.pictures:
            self.n_unrecorded += 1
            return None
        return self._detect(observation)

    def _decode_similarity(self, answer: dict[str, Any], questions: deque[Any]) -> Any:
        similarity = journal.decoded(ImageSimilarity, answer)
        question = _find_question(questions, similarity.stamp_ns)
        return None if question is None else (question, similarity)

    def _decode_choice(self, answer: dict[str, Any], questions: deque[Any]) -> Any:
        """Return the recorded choice; None if other settings led to another question."""
        choice = journal.decoded(FrontierChoice, answer)
        question = _find_question(questions, choice.stamp_ns)
        if question is None or not {m.id for m in question.view.marks} >= set(choice.ids):
            return None
        return question, choice


def _find_question(questions: deque[Any], stamp_ns: int) -> Any:
    """Return the question about the observation of this stamp; None if there was none.

    Questions up to this one are forgotten: answers come in order, and two cameras may have equal
    stamps.
    """
    while questions:
        question = questions.popleft()
        if question.observation.stamp_ns == stamp_ns:
            return question
    return None
