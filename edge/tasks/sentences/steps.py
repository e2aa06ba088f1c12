"""Steps of an instruction, as `reading` reads them and `edge.tasks.rules` plans them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from edge.tasks.scene.scene import SceneObject

OF_SUFFIX = {"left": " of", "right": " of"}
"""Side → word after it: "left of the van", but "behind the van"."""
OTHER_SIDE = {"left": "right", "right": "left"}
"""Side → the opposite one."""

Kind = Literal[
    "to", "past", "along", "around", "circle", "next to", "between", "straight", "halfway", "turn",
    "onto", "across", "stop",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class RouteLimits:
    """Restrictions of the entire path.

    Attributes:
        avoid: objects to stay away from.
        avoid_ground: kinds of ground to stay off; see `edge.tasks.sentences.phrases.GROUNDS`.
        keep_to: kinds of ground that the path prefers; empty: any.
    """

    avoid: tuple[SceneObject, ...] = ()
    avoid_ground: tuple[str, ...] = ()
    keep_to: tuple[str, ...] = ()

    def __str__(self) -> str:
        avoided = (*(f"{obj.label} {obj.id}" for obj in self.avoid), *self.avoid_ground)
        return "; ".join(
            f"{what} {' and '.join(listed)}"
            for what, listed in (("avoid", avoided), ("keep to", self.keep_to))
            if listed
        )


@dataclass(frozen=True, slots=True)
class InstructionStep:
    """One step of an instruction.

    Attributes:
        kind: the sort of motion.
        objects: two objects for "between", none for "turn", "onto", "across", a "straight" with a
            distance and a bare "stop", else one.
        side: one of `edge.tasks.functions.SIDES_RAD`; "" if none is given.
        distance_m: length of "straight"; gap to the object for "to" and "next to"; 0.0 if none is
            given.
        turn_rad: angle of "turn", counter-clockwise.
        ground: kind of ground of "onto" and "across"; see `edge.tasks.sentences.phrases.GROUNDS`.
        limits: restrictions of the path, the same for all steps.
        said: the part of the instruction that is this step.
    """

    kind: Kind
    objects: tuple[SceneObject, ...] = ()
    side: str = ""
    distance_m: float = 0.0
    turn_rad: float = 0.0
    ground: str = ""
    limits: RouteLimits = RouteLimits()
    said: str = ""

    def __str__(self) -> str:
        listed = " and ".join(f"{obj.label} {obj.id}" for obj in self.objects)
        gap = f", {self.distance_m:g} m before it" if self.distance_m else ""
        match self.kind:
            case "straight" if self.objects:
                return f"straight on until level with {listed}"
            case "straight":
                return f"straight on for {self.distance_m:g} m"
            case "turn":
                return _turn_text(self.turn_rad)
            case "onto" | "across":
                return f"{self.kind} {self.ground}"
            case "circle":
                sense = {"left": ", clockwise", "right": ", counterclockwise"}.get(self.side, "")
                return f"once around {listed}{sense}"
            case "halfway":
                return f"halfway to {listed}"
            case "past" | "along" | "around" if self.side:
                return f"{self.kind} the {self.side} of {listed}"
            case "next to":
                away = f"{self.distance_m:g} m " if self.distance_m else ""
                return f"{away}{self.side}{OF_SUFFIX.get(self.side, '')} {listed}"
        return f"{self.kind} {listed}{gap}".strip()


def _turn_text(turn_rad: float) -> str:
    degrees = round(abs(math.degrees(turn_rad)))
    if degrees == 180:
        return "turn around"
    by = "" if degrees == 90 else f" by {degrees} degrees"
    return f"turn {'left' if turn_rad > 0 else 'right'}{by}"


def describe_steps(steps: Sequence[InstructionStep]) -> str:
    """Return the steps in words, with the restrictions of the path first."""
    return "; ".join(filter(None, (str(steps[0].limits), *map(str, steps))))
