"""Workers that run models in the background of the loop: the detector, and scorers.

A scorer answers questions about a view, such as which frontier to drive to, and may answer slowly.
"""

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
"""Default pause of a scorer after a failure."""


class Closable(Protocol):
    """A model that a worker runs.

    Attributes:
        name: shown to people.
    """

    @property
    def name(self) -> str: ...

    def close(self) -> None: ...


Model = TypeVar("Model", bound=Closable)
Item = TypeVar("Item")
Result = TypeVar("Result")


class ModelWorker(Worker[Item, Result], Generic[Item, Result, Model]):
    """A worker whose model can be replaced while it runs.

    Args:
        what: name of the work, for the log and the thread.
        work: handles one item, with the model that `_use` returns.
        more: further arguments of `Worker`.
        model: runs on the next item.

    Attributes:
        model: runs on the next item.
        on_result: called with the model, the item and the outcome (a result, None or an exception),
            on the worker's thread. What it raises is logged and ignored.
    """

    def __init__(
        self, what: str, work: Callable[[Item], Result | None], model: Model, **more: Any
    ) -> None:
        self.model = model
        self.on_result: Callable[[Model, Item, Any], object] | None = None
        self._using: Model | None = None  # runs on the current item
        self._exchange_lock = threading.Lock()
        super().__init__(what, work, **more)

    def exchange(self, model: Model) -> Model:
        """Run another model from the next item on; return the model before it, still open."""
        with self._exchange_lock:
            before, self.model = self.model, model
        return before

    def uses(self, model: Model) -> bool:
        """Return True if a model may be running or will run: it must not be closed yet."""
        with self._exchange_lock:
            return model is self.model or model is self._using

    def _use(self) -> Model:
        """Return the model to run on the current item; it stays in use until `_used` is called."""
        with self._exchange_lock:
            self._using = self.model
        return self._using

    def _used(self, item: Item, outcome: object) -> None:
        """Call `on_result` with the outcome of the item."""
        model, self._using = self._using, None
        if (callback := self.on_result) is not None:
            try:
                callback(model, item, outcome)
            except Exception:
                log.exception("model %s: the check of its results failed: a bug in edge; please "
                              "report this traceback", model.name)  # fmt: skip


class DetectorWorker(ModelWorker[Observation, Detections, Detector]):
    """Runs a detector, and a segmenter on its boxes; another detector can replace the first.

    Observations are held (`Observation.hold`) while they wait and while the detector runs. The
    caller that polls detections takes over the hold: call `detections.observation.release()` when
    done.

    Args:
        detector: runs on the next image.
        inline: True: `submit` runs the detector, without a thread, so that a run replays the same.
        masker: adds masks to detections; None: no masks.

    Attributes:
        previous: the detector before a swap, kept open until the new one has passed its probation;
            None otherwise.
    """

    def __init__(
        self, detector: Detector, inline: bool = False, masker: Masker | None = None
    ) -> None:
        self.masker = masker
        self.previous: Detector | None = None
        super().__init__(
            "detector", self._detect, detector, inline=inline, drop=Observation.release,
            drop_result=lambda unread: unread.observation.release(),
        )  # fmt: skip

    @property
    def detector(self) -> Detector:
        """The detector that runs on the next image."""
        return self.model

    def submit(self, observation: Observation) -> None:
        """Detect in this observation next; return at once, unless inline.

        The newest image of each camera waits, and cameras take turns.
        An observation without an image, such as a LiDAR sweep between two images, is skipped.
        """
        if getattr(observation, getattr(self.detector, "looks_at", "rgb")) is not None:
            observation.hold()
            super().submit(observation, observation.camera_index)

    def _take(self) -> list[Observation]:
        """See `Worker`. Images before the one taken are dropped: detections come in order."""
        taken = super()._take()
        with self._changed:
            old = [k for k, o in self._waiting.items() if taken and o.seq < taken[0].seq]
            dropped = [self._waiting.pop(k) for k in old]
            self.stats.replaced += len(dropped)
        for observation in dropped:
            self._drop(observation)
        return taken

    def close(self) -> None:
        """Finish the current image, then release every observation that is still held."""
        super().close()
        self.detector.close()
        if self.masker is not None:
            self.masker.close()

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """Use other prompts from the next image on; see `Detector.set_prompts`.

        Raises:
            PromptError, ModelError: the detector or the previous one cannot use the prompts;
                nothing has changed.
        """
        previous = self.previous
        if previous is None:
            self.detector.set_prompts(prompts)
            return
        # First the previous detector: if it fails, the running detector is unchanged.
        before = previous.prompts
        try:
            previous.set_prompts(prompts)
        except UserError as error:
            raise type(error)(
                f"model {previous.name}, kept until {self.detector.name} passes its probation, "
                f"refuses the prompts: {error}; try again after the probation"
            ) from None
        try:
            self.detector.set_prompts(prompts)
        except Exception:
            previous.set_prompts(before)
            raise

    def _detect(self, observation: Observation) -> Detections:
        """Return the detections; release the observation if the detector fails."""
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
        """See `Worker`; a failure is excused if the detector's own health is not `ok`."""
        self._name = f"detector {self.detector.name}"
        super()._failed(error, excused=self.detector.health().state != "ok")


class Question(Protocol):
    """The input of a scorer; its observation is held until `Scorer.prepare` returns."""

    @property
    def observation(self) -> Observation: ...


Q = TypeVar("Q", bound=Question)
A = TypeVar("A")


class Scorer(Protocol[Q, A]):
    """A model in the background, in two steps: a slow server must not keep an observation's arrays.

    Attributes:
        name: shown to people.
    """

    name: str

    def prepare(self, question: Q) -> Any:
        """Read what needs the observation's arrays, and return it for `answer`.

        May raise anything.
        """
        ...

    def answer(self, prepared: Any) -> A | None:
        """Compute the result from what `prepare` returned. This may take long, but must end.

        May raise anything.
        """
        ...

    def close(self) -> None:
        """Abort an `answer` that runs on another thread, if possible."""
        ...


class ScorerWorker(ModelWorker[Q, tuple[Q, A], Scorer[Any, A]]):
    """Runs a scorer on one question at a time; a result is a question with its answer.

    After a failure it pauses: a server that refuses at once must not be asked at the loop's rate.

    Args:
        kind: name of the work, for the log and the thread.
        scorer: gets the next question.
        rest_s: pause after an answer.
        inline: answer inside `submit`.
        pause_s: pause after the first failure.
        view_of: returns the part of a question that the scorer gets; by default all of it.
    """

    def __init__(
        self,
        kind: str,
        scorer: Scorer[Any, A],
        rest_s: float = 0.0,
        inline: bool = False,
        pause_s: float = PAUSE_S,
        view_of: Callable[[Q], Any] = lambda question: question,
    ) -> None:
        self._view_of = view_of
        super().__init__(
            kind, self._ask, scorer, inline=inline, rest_s=rest_s, pause_s=pause_s,
            drop=lambda question: question.observation.release(),
        )  # fmt: skip

    @property
    def name(self) -> str:
        """Name of the scorer that gets the next question."""
        return self.model.name

    def submit(self, question: Q) -> None:
        """Ask the model this question, unless the worker is busy or pauses."""
        if self.idle:
            question.observation.hold()
            super().submit(question)

    def close(self) -> None:
        """Abort the current answer and stop."""
        self.stop()
        self.model.close()
        super().close()

    def counts(self) -> dict[str, object]:
        """Return counts for the status message."""
        s = self.stats
        return {
            "model": self.name, "asked": s.submitted, "answered": s.done, "failed": s.failed,
            "in_a_row": s.in_a_row, "last_latency_ns": s.last_latency_ns,
            "last_error": s.last_error, "detail": getattr(self.model, "detail", ""),
        }  # fmt: skip

    def _ask(self, question: Q) -> tuple[Q, A] | None:
        """Ask the scorer; release the observation as soon as the question is prepared."""
        scorer = self._use()
        outcome: A | Exception | None = None
        try:
            try:
                prepared = scorer.prepare(self._view_of(question))
            finally:
                question.observation.release()
            outcome = scorer.answer(prepared)
        except Exception as error:
            outcome = error
            raise
        finally:
            self._used(question, outcome)
        return None if outcome is None else (question, outcome)

    def _failed(self, error: Exception, excused: bool = False) -> None:
        """See `Worker`; an answer that `close` aborted is no failure."""
        if not self._closed:
            super()._failed(error, excused)
