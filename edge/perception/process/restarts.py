"""When a process that ended may be started again."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from edge.config import ModelProcess


class Pause(NamedTuple):
    """How long to wait, and whether that is because the limit was reached."""

    seconds: float
    limit: bool


class Restarts:
    """Backoff and limit of `config.ModelProcess`.

    A process that ran for longer than `backoff_max_s` was well: the backoff begins anew.
    """

    def __init__(self, config: ModelProcess) -> None:
        self._config = config
        self._starts_s: deque[float] = deque()
        self._backoff_s = config.backoff_s

    def after(self, ran_s: float, now_s: float) -> Pause:
        """What a process's end calls for; its next start is counted.

        Args:
            ran_s: how long it was ready; 0 if it never was.
            now_s: on any clock that goes on evenly.

        Returns:
            The pause; infinite where no restart is allowed at all.
        """
        c = self._config
        if ran_s > c.backoff_max_s:
            self._backoff_s = c.backoff_s
        seconds, self._backoff_s = self._backoff_s, min(2 * self._backoff_s, c.backoff_max_s)
        if c.restarts == 0:
            return Pause(math.inf, True)
        limit = False
        if len(self._starts_s) == c.restarts:
            room_s = self._starts_s.popleft() + c.window_s - now_s
            limit, seconds = room_s > seconds, max(room_s, seconds)
        self._starts_s.append(now_s + seconds)
        return Pause(seconds, limit)
