"""Frames whose holders are counted."""

from __future__ import annotations


class Slot:
    """Counts holds as a frame pool does.

    Args:
        holds: how many there are to begin with; a source gives its frames out held once.
    """

    def __init__(self, holds: int = 0) -> None:
        self.holds = holds

    def hold(self) -> None:
        self.holds += 1

    def release(self) -> None:
        assert self.holds > 0
        self.holds -= 1
