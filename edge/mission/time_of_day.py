"""Times of day, such as "09:00", in the local time of the robot's computer."""

from __future__ import annotations

from datetime import datetime, timedelta

_S = 1_000_000_000


def next_ns(time_of_day: str, after_ns: int) -> int:
    """Return the next time [ns] at which the clock shows a time of day.

    A time that the change to summer time leaves out comes an hour later. One that the change back
    brings twice counts once: the first, or the second if `after_ns` is in the repeated hour.

    Args:
        time_of_day: hours and minutes, as "09:00".
        after_ns: Unix time before the result. At 09:00 itself, the result is on the next day.
    """
    hour, minute = map(int, time_of_day.split(":"))
    before = datetime.fromtimestamp(after_ns // _S)  # its `fold` says which of two equal hours
    on_this_day = before.replace(hour=hour, minute=minute, second=0)
    ends_ns = int(on_this_day.timestamp()) * _S
    if ends_ns > after_ns:
        return ends_ns
    return int((on_this_day + timedelta(days=1)).timestamp()) * _S
