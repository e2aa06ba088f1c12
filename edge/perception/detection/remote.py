"""A detector whose model runs on a server; it keeps running while the server does not answer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from edge import config
from edge.host.backoff import pause_after
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import check_prompts
from edge.perception.runtime.card_types import DetectCard
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import ModelHealth, ProgressCallback, log_progress
from edge.perception.runtime.kserve import KServeSession
from edge.types import Detections, Observation

PAUSE_S = 0.2  # pause after the first failure
MAX_PAUSE_S = 5.0  # longest pause

T = TypeVar("T")


class RemoteDetector:
    """A detector (`Detector`) that encodes prompts and selects boxes; a server runs the network.

    If the server gives no usable answer, `detect` fails for this image. The server is asked again
    after `PAUSE_S`; the pause doubles after each failure in a row, up to `MAX_PAUSE_S`. Images
    during a pause fail at once. The constructor does not ask the server, because the robot may
    start before the server does.

    Raises:
        PromptError, ModelError: see `OnnxDetector`; server errors are raised by `detect` instead.
    """

    def __init__(
        self,
        detector: config.DetectorOnnx,
        card: DetectCard,
        prompts: Sequence[str],
        progress: ProgressCallback = log_progress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = card.name
        self._config, self._progress, self._clock = detector, progress, clock
        self._text = make_text_encoder(card, detector.vocabulary)
        self._session = KServeSession(card)
        self._inner: OnnxDetector | None = None  # once the server has answered
        self._invalid_before = 0  # invalid boxes of earlier models
        self._health = ModelHealth()
        self._last_error: ModelError | None = None
        self._failures, self._next_s = 0, 0.0  # failures in a row, end of the pause
        self._asking = threading.Lock()
        self.prompts: tuple[str, ...] = ()
        self.set_prompts(prompts)

    @property
    def invalid_boxes(self) -> int:
        inner = self._inner
        return self._invalid_before + (0 if inner is None else inner.invalid_boxes)

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """See `Detector.set_prompts`; the server is not asked."""
        prompts = check_prompts(prompts)
        self._text.embed(prompts)
        self.prompts = prompts

    def detect(self, observation: Observation) -> Detections:
        """See `Detector.detect`; takes at most the card's `server.time_limit_s`.

        The first image may take a few times as long.

        Raises:
            ModelError: the server gave no usable answer, or is in a pause after a failure.
        """
        return self._with_model(lambda model: model.detect(observation))

    def best_scores(self, rgb: np.ndarray) -> np.ndarray:
        """See `OnnxDetector.best_scores`; raises like `detect`."""
        return self._with_model(lambda model: model.best_scores(rgb))

    def health(self) -> ModelHealth:
        """See `Detector.health`: `degraded` while the server gives no usable answers."""
        return self._health

    def close(self) -> None:
        """Abort the current request; do not call `detect` afterwards."""
        self._session.close()

    def _with_model(self, work: Callable[[OnnxDetector], T]) -> T:
        """Call `work` with the detector, and record a failure.

        Raises:
            ModelError: the last error during a pause; else the error of `work`.
        """
        with self._asking:
            if self._last_error is not None and self._clock() < self._next_s:
                raise self._last_error.with_traceback(None)
            try:
                found = work(self._detector())
            except ModelError as error:
                self._record_failure(error)
                raise
            self._last_error, self._failures, self._health = None, 0, ModelHealth()
            return found

    def _detector(self) -> OnnxDetector:
        """Return the detector that uses the server's network, with the current prompts."""
        wanted = self.prompts
        if self._inner is None:
            self._inner = OnnxDetector(
                self._config, wanted, self._progress, self._session, self._text
            )
        elif self._inner.prompts != wanted:
            self._inner.set_prompts(wanted)
        return self._inner

    def _record_failure(self, error: ModelError) -> None:
        """Begin a pause, and set the health."""
        self._last_error = error
        self._failures += 1
        self._next_s = self._clock() + pause_after(self._failures, PAUSE_S, MAX_PAUSE_S)
        self._health = ModelHealth("degraded", str(error))
        # An error without a kind is of the answer's content.
        if getattr(error, "kind", "invalid answer") == "invalid answer":
            # The server may run another model by now: make a new detector for it.
            self._invalid_before, self._inner = self.invalid_boxes, None
