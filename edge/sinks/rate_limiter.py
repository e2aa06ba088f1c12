"""Rate limits of the messages that a sink sends."""

from __future__ import annotations


class RateLimiter:
    """Limits the rate of several kinds of messages.

    Example:
        >>> limiter = RateLimiter(map=2.0)
        >>> limiter.take_turn("map", 0), limiter.take_turn("map", 100_000_000)
        (True, False)
    """

    def __init__(self, **hz: float) -> None:
        self._period_ns = {name: int(1e9 / rate) for name, rate in hz.items()}
        self._last_ns: dict[str, int] = {}

    def take_turn(self, name: str, now_ns: int) -> bool:
        """Return True if a message is due, and record that it was sent at `now_ns`."""
        last_ns = self._last_ns.get(name)
        # A clock that was set back must not silence the sink.
        if last_ns is not None and 0 <= now_ns - last_ns < self._period_ns[name]:
            return False
        self._last_ns[name] = now_ns
        return True
