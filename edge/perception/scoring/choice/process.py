"""Models for VLM frontier selection in their own process, which is restarted when it ends."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

import numpy as np

from edge import config
from edge.host.children import python_module
from edge.perception.process.supervised import RestartDelay, SupervisedProcess
from edge.perception.process.wire import ModelProcessError
from edge.perception.runtime.card_types import ChoiceCard, DirectionsCard
from edge.perception.runtime.health import log_progress
from edge.perception.scoring.vlm.answers import YES_NO, MultipleChoice
from edge.text import bounded_repr

log = logging.getLogger(__name__)

PROGRAM = python_module("edge.perception.scoring.choice.serve")
LIMIT = "perception.choice.time_limit_s and perception.process.timeout_s"
"""Configuration keys of the time limit, for messages."""
_SUM_ERROR = 1e-3  # tolerance of the sum of probabilities, which is 1


class _Process(SupervisedProcess):
    """The process of a card's model, which answers questions; see `edge.perception.process`.

    While no process is ready, each question raises at once.

    Raises:
        ModelError, PromptError: the model cannot be loaded, or its process cannot be started.
    """

    def __init__(
        self, card: DirectionsCard, choice: config.ChoiceOnnx, process: config.ModelProcessConfig
    ) -> None:
        super().__init__(card.name, process)
        self._request = {"choice": choice.model_dump(mode="json")}
        self._not_ready = f"model {self.name}: its process is not ready"
        self._begin("choice-model")

    def _ask(
        self, request: dict[str, Any], rgb: np.ndarray | None, sizes: Sequence[int], limit_s: float
    ) -> list[np.ndarray]:
        """Send a request; return the probabilities of the answers of each question.

        A process that exceeds `limit_s` by `timeout_s` is killed.

        Args:
            request: header fields for the program (`serve.py`).
            rgb: (h, w, 3) uint8; None: no image.
            sizes: number of answers of each question.
            limit_s: time limit of the model.

        Raises:
            ModelError: no process is ready, it ended or was killed, or the model failed.
        """
        link = self._link
        if link is None:
            raise ModelProcessError(self._not_ready)
        patience_s = limit_s + self._rules.timeout_s
        request = {**request, "limit_s": limit_s}
        return link.ask(request, rgb, patience_s, LIMIT, partial(_decode, sizes))

    def _run_once(self, first: Future[None]) -> tuple[float, str]:
        return self._run_link(first, self._request, log_progress, PROGRAM)

    def _ready(self, again: bool) -> None:
        if again:
            log.info("model %s: its process runs again", self.name)

    def _ended(self, why: str, failed: Exception | None, pause: RestartDelay) -> None:
        self._not_ready = f"{why}; {pause}"
        self._link = None
        log.warning("%s", self._not_ready)


class ProcessModel(_Process):
    """A `LanguageModel` in its own process.

    Attributes:
        name: the model's card.
        takes_images: see `LanguageModel`.
    """

    def __init__(
        self, card: ChoiceCard, choice: config.ChoiceOnnx, process: config.ModelProcessConfig
    ) -> None:
        self.takes_images = card.vision_encoder is not None
        super().__init__(card, choice, process)

    def ask(
        self,
        rules: str,
        view: np.ndarray | str,
        questions: Sequence[MultipleChoice],
        limit_s: float,
    ) -> list[np.ndarray]:
        """See `LanguageModel.ask` and `_ask`."""
        words, rgb = (view, None) if isinstance(view, str) else (None, view)
        request = {"rules": rules, "view": words, "asked": list(questions)}
        return self._ask(request, rgb, [len(question.answers) for question in questions], limit_s)


class ProcessMarks(_Process):
    """A `MarkNetwork` in its own process.

    Attributes:
        name: the model's card.
    """

    def ask(
        self, image: np.ndarray, marks: np.ndarray, others: np.ndarray, target: str, limit_s: float
    ) -> list[np.ndarray]:
        """See `MarkNetwork.ask` and `_ask`."""
        request = {"marks": marks.tolist(), "others": others.tolist(), "target": target}
        return self._ask(request, image, (len(marks) + 1, len(YES_NO)), limit_s)


def _decode(
    sizes: Sequence[int], seq: int, header: dict[str, Any], block: bytes
) -> list[np.ndarray]:
    """Check and unpack the probabilities of the answers."""
    if header.get("seq") != seq:
        raise ValueError(f"seq: expected {seq}, got {bounded_repr(header.get('seq'), 40)}")
    values = header.get("p")
    if not isinstance(values, list) or len(values) != len(sizes):
        raise ValueError(f"p: expected {len(sizes)} lists, got {bounded_repr(values, 40)}")
    try:
        found = [np.array(p, np.float32) for p in values]
    except (TypeError, ValueError):
        raise ValueError(f"p: expected lists of numbers, got {bounded_repr(values, 40)}") from None
    for p, size in zip(found, sizes, strict=True):
        if p.shape != (size,) or not (p >= 0).all() or abs(float(p.sum()) - 1.0) > _SUM_ERROR:
            raise ValueError(
                f"p: expected {size} probabilities with the sum 1, got {p.size} with the sum "
                f"{float(p.sum()):g}: {bounded_repr(p.tolist(), 40)}"
            )
    return found
