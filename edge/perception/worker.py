"""Models beside the loop: the detector, and scorers that may take long to answer."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from edge.errors import UserError
from edge.host.worker import Worker
from edge.perception.detection.detector import Detector
from edge.perception.masks.masker import Masker
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

PAUSE_S = 1.0

Watch = Callable[[Detector, Observation, "Detections | Exception"], None]
"""Called with every image that a detector was run on, held meanwhile, and with what came of it."""


class DetectorWorker(Worker[Observation, Detections]):
    """Runs a detector, and a segmenter on what it finds; lets another detector take its place.

    Observations are held (`Observation.hold`) while they wait and while they are detected in.
    Whoever polls detections owns that hold: call `detections.observation.release()` when done.

    Args:
        inline: see `Worker`.
        masker: makes masks; None: there are none.

    Attributes:
        detector: runs on the next image.
        spare: the one before, kept until the present one has proved itself; None otherwise.
        watch: told of every image, on the thread that detects; what it raises is only logged.
    """

    def __init__(
        self,
        detector: Detector,
        inline: bool = False,
        masker: Masker | None = None,
    ) -> None:
        self.detector, self.masker = detector, masker
        self.spare: Detector | None = None
        self.watch: Watch | None = None
        self._using: Detector | None = None
        self._hand = threading.Lock()
        super().__init__(
            "detector", self._detect, inline=inline, drop=Observation.release,
            drop_result=lambda unread: unread.observation.release(),
        )  # fmt: skip

    def submit(self, observation: Observation) -> None:
        """Detect in this next. Never blocks, unless inline.

        An observation without a picture, as a LiDAR's sweeps between two of them, is left out.
        """
        if getattr(observation, getattr(self.detector, "looks_at", "rgb")) is not None:
            observation.hold()
            super().submit(observation)

    def close(self) -> None:
        """Finish the image at hand, release every observation still held."""
        super().close()
        self.detector.close()
        if self.masker is not None:
            self.masker.close()

    def exchange(self, detector: Detector) -> Detector:
        """Have another detector run on the next image; the one before, still open."""
        with self._hand:
            before, self.detector = self.detector, detector
        return before

    def uses(self, detector: Detector) -> bool:
        """Whether it may be detecting now: such a one must not be closed yet."""
        with self._hand:
            return detector is self.detector or detector is self._using

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """Look for something else from the next image on; see `Detector.set_prompts`.

        Raises:
            PromptError, ModelError: the detector, or the spare one, cannot; nothing has changed
                then.
        """
        spare = self.spare
        if spare is None:
            self.detector.set_prompts(prompts)
            return
        # First the one that does not detect: where it fails, nothing at work need be undone.
        before = spare.prompts
        try:
            spare.set_prompts(prompts)
        except UserError as error:
            raise type(error)(
                f"{spare.name}, kept until {self.detector.name} has proved itself: {error}; "
                "try again after that"
            ) from None
        try:
            self.detector.set_prompts(prompts)
        except Exception:
            spare.set_prompts(before)
            raise

    def _detect(self, observation: Observation) -> Detections:
        """What the detector finds, after `watch` was told; a failure lets the observation go."""
        with self._hand:
            detector = self._using = self.detector
        outcome: Detections | Exception
        try:
            outcome = detector.detect(observation)
        except Exception as error:
            outcome = error
        if (watch := self.watch) is not None:
            try:
                watch(detector, observation, outcome)
            except Exception:
                log.exception("whoever watches the detector failed")
        self._using = None
        if isinstance(outcome, Exception):
            observation.release()
            raise outcome
        return outcome if self.masker is None else self.masker.add(outcome)

    def _failed(self, error: Exception, excused: bool = False) -> None:
        """See `Worker`; excused is a detector that itself says that it is not `ok`."""
        self._what = f"detector {self.detector.name}"
        super()._failed(error, excused=self.detector.health().state != "ok")


ScorerWatch = Callable[["Scorer", "Question", object], None]
"""Called with every question that a scorer was put, and with the answer, or the exception that came
of it."""


class Question(Protocol):
    """What a scorer is asked; its observation is held until the scorer has looked at it."""

    @property
    def observation(self) -> Observation: ...


Q = TypeVar("Q", bound=Question)
A = TypeVar("A")


class Scorer(Protocol[Q, A]):
    """A model beside the loop, in two steps so that a frame is not held while a server thinks.

    Attributes:
        name: what it is, for people.
    """

    name: str

    def look(self, question: Q) -> Any:
        """Everything that needs the observation's arrays; may raise anything."""
        ...

    def answer(self, looked: Any) -> A | None:
        """The rest, which may take long but not for ever; may raise anything."""
        ...

    def close(self) -> None:
        """Give up at once, if that can be, what is being answered in another thread."""
        ...


class ScorerWorker(Worker[Q, A]):
    """Puts questions to a scorer, one at a time, and leaves it alone for a while after a failure:
    a server that refuses at once must not be asked at the loop's rate.

    Args:
        kind: what the scorer is for, in messages.
        inline, rest_s, pause_s: see `Worker`.

    Attributes:
        watch: told of every answer, on the thread that asks.
    """

    def __init__(
        self,
        kind: str,
        scorer: Scorer[Q, A],
        rest_s: float = 0.0,
        inline: bool = False,
        pause_s: float = PAUSE_S,
    ) -> None:
        self._scorer, self._using = scorer, None
        self.watch: ScorerWatch | None = None
        self._hand = threading.Lock()
        super().__init__(
            kind, self._put, inline=inline, rest_s=rest_s, pause_s=pause_s,
            drop=lambda question: question.observation.release(),
        )  # fmt: skip

    @property
    def name(self) -> str:
        """Of the scorer that is asked next."""
        return self._scorer.name

    def exchange(self, scorer: Scorer[Q, A]) -> Scorer[Q, A]:
        """Ask another scorer from the next question on; the one before, still open."""
        with self._hand:
            before, self._scorer = self._scorer, scorer
        return before

    def uses(self, scorer: Scorer[Q, A]) -> bool:
        """Whether it is asked now, or will be: such a one must not be closed yet."""
        with self._hand:
            return scorer is self._scorer or scorer is self._using

    def submit(self, question: Q) -> None:
        """Answer this, unless another is being answered, or rested from."""
        if self.idle:
            question.observation.hold()
            super().submit(question)

    def close(self) -> None:
        """Give up what is being answered."""
        self.stop()
        self._scorer.close()
        super().close()

    def counts(self) -> dict[str, object]:
        """For the status message."""
        s = self.stats
        return {
            "model": self.name, "asked": s.submitted, "answered": s.done, "failed": s.failed,
            "in_a_row": s.in_a_row, "last_latency_ns": s.last_latency_ns,
            "last_error": s.last_error,
        }  # fmt: skip

    def _put(self, question: Q) -> A | None:
        with self._hand:
            scorer = self._using = self._scorer
        answer: A | None = None
        outcome: object = None
        try:
            try:
                looked = scorer.look(question)
            finally:
                question.observation.release()
            outcome = answer = scorer.answer(looked)
        except Exception as error:
            outcome = error
            raise
        finally:
            self._using = None
            if (watch := self.watch) is not None:
                watch(scorer, question, outcome)
        return answer

    def _failed(self, error: Exception, excused: bool = False) -> None:
        """See `Worker`; what is given up has not failed."""
        if not self._closed:
            super()._failed(error, excused)
