"""A step of a task."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TaskStep:
    """A step of a task.

    Attributes:
        said: its part of the instruction.
        names: those of the targets that have to be seen before it is driven.
        joined: it speaks of the thing of the step before it, and is driven together with that.
    """

    said: str
    names: tuple[str, ...] = ()
    joined: bool = False
