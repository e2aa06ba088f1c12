"""A detector whose model runs on a server, and which lives on while that does not answer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from edge import config
from edge.perception.detection.onnx import OnnxDetector
from edge.perception.embedding.encoders import make_text_encoder
from edge.perception.embedding.text import check_prompts
from edge.perception.runtime.card_types import DetectCard
from edge.perception.runtime.cards import ModelError
from edge.perception.runtime.health import Health, Tell, log_progress
from edge.perception.runtime.kserve import RemoteSession
from edge.types import Detections, Observation

PAUSE_S, MAX_PAUSE_S = 0.2, 5.0

T = TypeVar("T")


class RemoteDetector:
    """See `Detector`. Prompts are encoded here, boxes picked here; the network runs on the server.

    A server that is dead, slow, lying or refusing costs the image at hand. It is asked again after
    `PAUSE_S`, twice as long after each failure in a row up to `MAX_PAUSE_S`; what comes meanwhile
    is let go at once. Nothing is asked of it when this is made: a robot may start before it.

    Args:
        clock: seconds.

    Raises:
        PromptError, ModelError: see `OnnxDetector`, but for what the server has to do with.
    """

    def __init__(
        self,
        detector: config.DetectorOnnx,
        card: DetectCard,
        prompts: Sequence[str],
        progress: Tell = log_progress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.name = card.name
        self._config, self._progress, self._clock = detector, progress, clock
        self._text = make_text_encoder(card, detector.vocabulary)
        self._session = RemoteSession(card)
        self._inner: OnnxDetector | None = None  # once the server has answered
        self._invalid_before = 0  # of those before the present one
        self._health = Health()
        self._last: ModelError | None = None
        self._failures, self._next_s = 0, 0.0
        self._asking = threading.Lock()
        self._prompts: tuple[str, ...] = ()
        self.set_prompts(prompts)

    @property
    def prompts(self) -> tuple[str, ...]:
        return self._prompts

    @property
    def invalid_boxes(self) -> int:
        inner = self._inner
        return self._invalid_before + (0 if inner is None else inner.invalid_boxes)

    def set_prompts(self, prompts: Sequence[str]) -> None:
        """See `Detector.set_prompts`; the server is not asked."""
        prompts = check_prompts(prompts)
        self._text.embed(prompts)
        self._prompts = prompts

    def detect(self, observation: Observation) -> Detections:
        """See `Detector.detect`; takes at most the card's `server.time_limit_s`, or a few of them
        at the first image.

        Raises:
            ModelError: no usable answer, or none is asked for yet.
        """
        return self._with_model(lambda model: model.detect(observation))

    def best_scores(self, rgb: np.ndarray) -> np.ndarray:
        """See `OnnxDetector.best_scores`; raises as `detect`."""
        return self._with_model(lambda model: model.best_scores(rgb))

    def health(self) -> Health:
        """See `Detector.health`: `degraded` while the server gives no usable answers."""
        return self._health

    def close(self) -> None:
        """Give up what is being asked; no detect afterwards."""
        self._session.close()

    def _with_model(self, work: Callable[[OnnxDetector], T]) -> T:
        with self._asking:
            if self._last is not None and self._clock() < self._next_s:
                raise self._last.with_traceback(None)
            try:
                found = work(self._model())
            except ModelError as error:
                self._failed(error)
                raise
            self._last, self._failures, self._health = None, 0, Health()
            return found

    def _model(self) -> OnnxDetector:
        """What looks with the server's network, for the prompts that are wanted."""
        wanted = self._prompts
        if self._inner is None:
            self._inner = OnnxDetector(
                self._config, wanted, self._progress, self._session, self._text
            )
        elif self._inner.prompts != wanted:
            self._inner.set_prompts(wanted)
        return self._inner

    def _failed(self, error: ModelError) -> None:
        pause_s = min(PAUSE_S * 2.0 ** min(self._failures, 10), MAX_PAUSE_S)
        self._last = error
        self._failures += 1
        self._next_s = self._clock() + pause_s
        self._health = Health("degraded", str(error))
        if getattr(error, "kind", "lying") == "lying":  # perhaps it is another model by now
            self._invalid_before, self._inner = self.invalid_boxes, None
