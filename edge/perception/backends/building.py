"""Tells of a long build while it goes on, so that it does not look like a hang."""

from __future__ import annotations

import threading
import time

from edge.perception.detector import Health, Progress

EVERY_S = 5.0


class Building:
    """Within the block, `progress` hears at once and then every few seconds.

    Args:
        model: what is built an engine for.
        progress: told the time taken, and how far it is where the builder says so.
    """

    def __init__(self, model: str, progress: Progress, every_s: float = EVERY_S) -> None:
        self._model, self._progress, self._every_s = model, progress, every_s
        self._note = ""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._tell, name="building", daemon=True)

    def note(self, text: str) -> None:
        """How far it is, told with the next beat; from any thread."""
        self._note = text

    def __enter__(self) -> Building:
        self._start_s = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _tell(self) -> None:
        while True:
            took_s = time.monotonic() - self._start_s
            how_far = self._note or "this takes minutes the first time"
            self._progress(Health("building engine", f"{self._model}: {took_s:.0f} s, {how_far}"))
            if self._over.wait(self._every_s):
                return
