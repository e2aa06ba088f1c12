"""One step of a task, an instruction about the manner of driving; see `edge.tasks`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TaskStep:
    """One step of a task.

    Attributes:
        said: its part of the instruction.
        names: targets that must be detected before the step is driven.
        joined: True if the step refers to the object of the previous step, or depends on the
            heading at its end; both are driven together.
    """

    said: str
    names: tuple[str, ...] = ()
    joined: bool = False
