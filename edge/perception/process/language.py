"""A language model that lives in a process of its own, and is brought back when that ends."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

import numpy as np

from edge import config
from edge.host.children import python_module
from edge.perception.card_types import ChoiceCard
from edge.perception.detector import log_progress
from edge.perception.model_file import ModelError
from edge.perception.process.detector import Restarts
from edge.perception.process.link import Link
from edge.perception.process.wire import FrameFile, ModelProcessError
from edge.perception.vlm.model import Asked

log = logging.getLogger(__name__)

PROGRAM = python_module("edge.perception.process.serve_language")
LIMIT = "perception.choice.time_limit_s and perception.process.timeout_s"
_CLOSE_S = 10.0
_SUM_ERROR = 1e-3


class ProcessModel:
    """Asked like `LanguageModel`; `edge.perception.process` says how it works.

    A thread of its own starts the process, waits for its end, and starts it again by the rules of
    `config.ModelProcess`. While there is no process `ask` raises at once.

    Attributes:
        name: the model's card.
        sees: see `LanguageModel`.
    """

    def __init__(
        self, card: ChoiceCard, choice: config.ChoiceOnnx, rules: config.ModelProcess
    ) -> None:
        """
        Raises:
            ModelError: what keeps the model from loading, or its process from starting.
        """
        self.name, self.sees = card.name, card.vision_encoder is not None
        self._told, self._rules = {"choice": choice.model_dump(mode="json")}, rules
        self._frames = FrameFile()
        self._link: Link | None = None
        self._why = f"model {self.name}: its process is not ready"
        self._closing = threading.Event()
        first: Future[None] = Future()
        self._thread = threading.Thread(
            target=self._run, args=(first,), name="language-model", daemon=True
        )
        self._thread.start()
        try:
            first.result()
        except BaseException:
            self.close()
            raise

    def ask(
        self, rules: str, view: np.ndarray | str, asked: Sequence[Asked], limit_s: float
    ) -> list[np.ndarray]:
        """See `LanguageModel.ask`. A process that does not keep the limit itself is killed.

        Raises:
            ModelError: also where there is no process, or it ended over this.
        """
        link = self._link
        if link is None:
            raise ModelProcessError(self._why)
        words, rgb = (view, None) if isinstance(view, str) else (None, view)
        request = {"rules": rules, "view": words, "asked": list(asked), "limit_s": limit_s}
        patience_s = limit_s + self._rules.timeout_s
        decode = partial(_decode, [len(one.answers) for one in asked])
        return link.ask(request, rgb, patience_s, LIMIT, decode)

    def close(self) -> None:
        """End the process, whatever it does; may be called from another thread."""
        self._closing.set()
        if (link := self._link) is not None:
            link.stop()
        if self._thread is not threading.current_thread():
            self._thread.join(_CLOSE_S)
        self._frames.close()

    def _run(self, first: Future[None]) -> None:
        """Keep a process running until `close`; how its first start went goes to `first`."""
        restarts = Restarts(self._rules)
        while not self._closing.is_set():
            ran_s = 0.0
            try:
                ran_s, why = self._run_once(first)
            except ModelError as error:
                why = str(error)
                if not first.done():
                    first.set_exception(error)
                    return
            pause = restarts.after(ran_s)
            if self._closing.is_set():
                return
            often = " (perception.process.restarts)" if pause.limit else ""
            self._why = f"{why}; started again after {pause.seconds:.1f} s{often}"
            log.warning("%s", self._why)
            self._closing.wait(None if math.isinf(pause.seconds) else pause.seconds)

    def _run_once(self, first: Future[None]) -> tuple[float, str]:
        """One process, from its start to its end: seconds that it was ready, and how it ended."""
        link = Link(self._told, self.name, self._frames, PROGRAM)
        try:
            link.wait_ready(self._rules.start_timeout_s, self._closing.is_set, log_progress)
            ready_s, self._link = time.monotonic(), link
            if first.done():
                log.info("model %s: its process runs", self.name)
            else:
                first.set_result(None)
            if not self._closing.is_set():  # else `close` may not have found this link
                link.join()
            return time.monotonic() - ready_s, link.fault
        finally:
            self._link = None
            link.close()


def _decode(
    sizes: Sequence[int], seq: int, header: dict[str, Any], block: bytes
) -> list[np.ndarray]:
    """Check and unpack the shares of the answers.

    Args:
        sizes: how many answers each question has.

    Raises:
        ValueError: with one line that says what is wrong.
    """
    if header.get("seq") != seq:
        raise ValueError(f"seq {header.get('seq')!r:.40}, expected {seq}")
    told = header.get("p")
    if not isinstance(told, list) or len(told) != len(sizes):
        raise ValueError(f"p {told!r:.40}")
    try:
        found = [np.array(p, np.float32) for p in told]
    except (TypeError, ValueError):
        raise ValueError(f"p {told!r:.40}") from None
    for p, size in zip(found, sizes, strict=True):
        if p.shape != (size,) or not (p >= 0).all() or abs(float(p.sum()) - 1.0) > _SUM_ERROR:
            raise ValueError(f"shares {p.tolist()!r:.40} for {size} answers")
    return found
