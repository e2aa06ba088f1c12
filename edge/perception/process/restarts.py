"""When a process that ended may be started again."""

from __future__ import annotations

import math
from typing import NamedTuple

from edge.config import ModelProcess


class Pause(NamedTuple):
    """How long to wait, and whether that is because the limit was reached."""

    seconds: float
    limit: bool


class Restarts:
    """Backoff and limit of `config.ModelProcess`.

    Ends count in a row, however long each start takes: one after a run of over `window_s` is the
    first again. The backoff begins anew after a run of over `backoff_max_s`.
    """

    def __init__(self, config: ModelProcess) -> None:
        self._config = config
        self._ends = 0
        self._backoff_s = config.backoff_s

    def after(self, ran_s: float) -> Pause:
        """What a process's end calls for.

        Args:
            ran_s: how long it was ready; 0 if it never was.

        Returns:
            The pause; infinite where no restart is allowed at all.
        """
        c = self._config
        self._ends = 1 if ran_s > c.window_s else self._ends + 1
        if ran_s > c.backoff_max_s:
            self._backoff_s = c.backoff_s
        seconds, self._backoff_s = self._backoff_s, min(2 * self._backoff_s, c.backoff_max_s)
        if c.restarts == 0:
            return Pause(math.inf, True)
        if self._ends > c.restarts:
            return Pause(max(seconds, c.window_s), True)
        return Pause(seconds, False)
