"""How often a sink sends what."""

from __future__ import annotations


class Pace:
    """Says when each of several things is due.

    Args:
        hz: by name, how often it is due at most.
    """

    def __init__(self, **hz: float) -> None:
        self._period_ns = {name: int(1e9 / rate) for name, rate in hz.items()}
        self._last_ns: dict[str, int] = {}

    def is_due(self, name: str, now_ns: int) -> bool:
        """Whether it is; from then on it was sent at `now_ns`."""
        last_ns = self._last_ns.get(name)
        # A clock that was set back must not silence the sink.
        if last_ns is not None and 0 <= now_ns - last_ns < self._period_ns[name]:
            return False
        self._last_ns[name] = now_ns
        return True
