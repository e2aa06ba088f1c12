"""Pauses before a failed action is tried again."""


def pause_after(failures: int, first: float, longest: float) -> float:
    """Return the pause after a number of failures in a row: it doubles from the second on.

    >>> [pause_after(n, 0.5, 3.0) for n in (1, 2, 3, 4)]
    [0.5, 1.0, 2.0, 3.0]
    """
    return min(first * 2.0 ** min(max(failures - 1, 0), 30), longest)
