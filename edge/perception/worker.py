"""Models beside the loop: the detector, and scorers that may take long to answer."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar

from edge.errors import UserError
from edge.host.worker import Worker
from edge.perception.detection.detector import Detector
from edge.perception.masks.masker import Masker
from edge.types import Detections, Observation

log = logging.getLogger(__name__)

PAUSE_S = 1.0


class Closable(Protocol):
    """A model that a worker runs.

    Attributes:
        name: what it is, for people.
    """

    @property
    def name(self) -> str: ...

    def close(self) -> None: ...


Model = TypeVar("Model", bound=Closable)
Item = TypeVar("Item")
Result = TypeVar("Result")


class ModelWorker(Worker[Item, Result], Generic[Item, Result, Model]):
    """Runs a model that another one may take the place of.

    Args:
        model: runs on the next item.
        what, work, more: see `Worker`; `work` runs the model that it gets from `_use`.

    Attributes:
        model: runs on the next item.
        watch: called with the model, the item and what came of it (a result, None or an
            exception), on the worker's thread; what it raises is only logged.
    """

    def __init__(
        self, what: str, work: Callable[[Item], Result | None], model: Model, **more: Any
    ) -> None:
        self.model = model
        self.watch: Callable[[Model, Item, Any], object] | None = None
        self._using: Model | None = None
        self._hand = threading.Lock()
        super().__init__(what, work, **more)

    def exchange(self, model: Model) -> Model:
        """Have another model run on the next item; return the one before, still open."""
        with self._hand:
            before, self.model = self.model, model
        return before

    def uses(self, model: Model) -> bool:
        """Whether it may be running now, or will be: such a one must not be closed yet."""
        with self._hand:
            return model is self.model or model is self._using

    def _use(self) -> Model:
        """Return the model to run on the item at hand, until `_used` is called."""
        with self._hand:
            self._using = self.model
        return self._using

    def _used(self, item: Item, outcome: object) -> None:
        """Tell `watch` what came of the item."""
        model, self._using = self._using, None
        if (watch := self.watch) is not None:
            try:
                watch(model, item, outcome)
            except Exception:
                log.exception("watching %s failed", model.name)


class DetectorWorker(ModelWorker[Observation, Detections, Detector]):
    """Runs a detector, and a segmenter on what it finds; lets another detector take its place.

    Observations are held (`Observation.hold`) while they wait and while they are detected in.
    Whoever polls detections owns that hold: call `detections.observation.release()` when done.

    Args:
        inline: see `Worker`.
        masker: makes masks; None: there are none.

    Attributes:
        spare: the one before, kept until the present one has proved itself; None otherwise.
    """

    def __init__(
        self,
        detector: Detector,
        inline: bool = False,
        masker: Masker | None = None,
    ) -> None:
        self.masker = masker
        self.spare: Detector | None = None
        super().__init__(
            "detector", self._detect, detector, inline=inline, drop=Observation.release,
            drop_result=lambda unread: unread.observation.release(),
        )  # fmt: skip

    @property
    def detector(self) -> Detector:
        """Runs on the next image."""
        return self.model

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
        """What the detector finds; a failure lets the observation go."""
        detector = self._use()
        outcome: Detections | Exception
        try:
            outcome = detector.detect(observation)
        except Exception as error:
            outcome = error
        self._used(observation, outcome)
        if isinstance(outcome, Exception):
            observation.release()
            raise outcome
        return outcome if self.masker is None else self.masker.add(outcome)

    def _failed(self, error: Exception, excused: bool = False) -> None:
        """See `Worker`; excused is a detector that itself says that it is not `ok`."""
        self._what = f"detector {self.detector.name}"
        super()._failed(error, excused=self.detector.health().state != "ok")


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


class ScorerWorker(ModelWorker[Q, A, Scorer[Q, A]]):
    """Puts questions to a scorer, one at a time, and leaves it alone for a while after a failure:
    a server that refuses at once must not be asked at the loop's rate.

    Args:
        kind: what the scorer is for, in messages.
        inline, rest_s, pause_s: see `Worker`.
    """

    def __init__(
        self,
        kind: str,
        scorer: Scorer[Q, A],
        rest_s: float = 0.0,
        inline: bool = False,
        pause_s: float = PAUSE_S,
    ) -> None:
        super().__init__(
            kind, self._put, scorer, inline=inline, rest_s=rest_s, pause_s=pause_s,
            drop=lambda question: question.observation.release(),
        )  # fmt: skip

    @property
    def name(self) -> str:
        """Of the scorer that is asked next."""
        return self.model.name

    def submit(self, question: Q) -> None:
        """Answer this, unless another is being answered, or rested from."""
        if self.idle:
            question.observation.hold()
            super().submit(question)

    def close(self) -> None:
        """Give up what is being answered."""
        self.stop()
        self.model.close()
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
        scorer = self._use()
        outcome: A | Exception | None = None
        try:
            try:
                looked = scorer.look(question)
            finally:
                question.observation.release()
            outcome = scorer.answer(looked)
        except Exception as error:
            outcome = error
            raise
        finally:
            self._used(question, outcome)
        return outcome

    def _failed(self, error: Exception, excused: bool = False) -> None:
        """See `Worker`; what is given up has not failed."""
        if not self._closed:
            super()._failed(error, excused)
