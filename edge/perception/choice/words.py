"""A view in words, for a language model without eyes (as ESC and L3MVN ask theirs)."""

from __future__ import annotations

from edge.perception.choice.question import LETTERS, MAX_MARKS, View

AHEAD_RAD = 0.2


def describe(view: View) -> str:
    """What was detected, and where the lettered frontiers lie.

    >>> import numpy as np
    >>> from edge.perception.choice.question import Mark, Sighting
    >>> from edge.types import Observation
    >>> seen = (Sighting("bed", 0.5, 2.14),)
    >>> print(describe(View(Observation(0, 0, np.eye(4)), "lamp", (Mark(7, 0, 0, 0, 3),), seen)))
    The robot sees:
    - bed, left, 2.1 m
    It can go on in these directions:
    - A: ahead, 3.0 m
    """
    seen = [f"- {s.label}, {_where(s.bearing_rad, s.distance_m)}" for s in view.sightings]
    ways = [
        f"- {letter}: {_where(mark.bearing_rad, mark.distance_m)}"
        for letter, mark in zip(LETTERS, view.marks[:MAX_MARKS], strict=False)
    ]
    heads = ("The robot sees:", "It can go on in these directions:")
    return "\n".join([heads[0], *(seen or ["- nothing that it knows"]), heads[1], *ways])


def _where(bearing_rad: float, distance_m: float) -> str:
    side = "ahead" if abs(bearing_rad) <= AHEAD_RAD else "left" if bearing_rad > 0 else "right"
    return f"{side}, {distance_m:.1f} m"
