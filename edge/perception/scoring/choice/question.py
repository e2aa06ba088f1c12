"""What a choice scorer is asked, in the words of ViTL (IV-B1), and what it answers.

A language model without eyes reads a view in words, as ESC and L3MVN ask theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.perception.runtime.card_types import MAX_MARKS
from edge.types import Observation

LETTERS = "ABCDEFGHJ"
"""One for each mark, and the next for "explore elsewhere". There is no I: as the likely beginning
of a sentence it would pass for an answer."""

SYSTEM = (
    "You guide a robot that explores a building. Answer each question with one letter or one word."
)
DIRECTION = (
    "Among directions ({letters}), or explore elsewhere ({elsewhere}), which should I choose to "
    "find a {target}? Answer with ONLY a single letter."
)
SCENE = "Does this view show paths or doorways that could lead to a {target}? Answer Yes or No."
AHEAD_RAD = 0.2


class Mark(NamedTuple):
    """A frontier in the camera's view.

    Attributes:
        id: of the candidate.
        u_px: column in the observation's image; `v_px` is the row.
        bearing_rad: left of where the robot is heading.
    """

    id: int
    u_px: float
    v_px: float
    bearing_rad: float
    distance_m: float


class Sighting(NamedTuple):
    """A thing that was detected a moment ago, and where it is as seen from the robot."""

    label: str
    bearing_rad: float
    distance_m: float


class Ways(NamedTuple):
    """What the robot's map says of where the directions lead.

    Attributes:
        path_m: (n,) float32, driving distance to each mark, inf where no way leads to it.
        gain_m2: (n,) float32, unknown area that each mark is expected to show.
        others: (3,) float32, of the frontiers without a mark that a way leads to: how many, the
            least driving distance [m] (0: there are none), and the most such area [m²].
    """

    path_m: np.ndarray
    gain_m2: np.ndarray
    others: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What there is to choose from at one instant.

    Attributes:
        observation: its image is read while whoever asks holds it.
        target: what is looked for.
        marks: at most `MAX_MARKS`, from left to right.
        lift: (n,) float32, how much likelier the target is near each mark than near an average
            place, by what was seen so far; None: no prior was asked.
        ways: to the marks; None: there is no map.
    """

    observation: Observation
    target: str
    marks: tuple[Mark, ...]
    sightings: tuple[Sighting, ...] = ()
    lift: np.ndarray | None = None
    ways: Ways | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What the model thinks of the directions in one view.

    Attributes:
        stamp_ns: of the view's observation.
        target: what it was asked about.
        ids: (n,) the candidates whose marks had letters; some may be gone by now.
        p: (n,) float32, P(f_i | I_t, c_k) of ViTL eq. 4.
        elsewhere: the probability of "explore elsewhere"; it and `p` sum to 1.
        scene: S_curr of ViTL eq. 5, in [0, 1].
    """

    stamp_ns: int
    target: str
    ids: tuple[int, ...]
    p: np.ndarray
    elsewhere: float
    scene: float

    @property
    def value(self) -> np.ndarray:
        """(n,) float32, V_curr(f_i) of ViTL eq. 6."""
        return np.float32(self.scene) * self.p


def choice_of(view: View, marks: Sequence[Mark], p: np.ndarray, scene: float) -> Choice:
    """What a model made of a view.

    Args:
        marks: (n) those that it could choose among.
        p: (n + 1,) for each of them, and for "explore elsewhere".
        scene: the probability that the view promises anything.
    """
    return Choice(
        view.observation.stamp_ns, view.target, tuple(mark.id for mark in marks),
        p[:-1].astype(np.float32), float(p[-1]), scene,
    )  # fmt: skip


def direction_question(n_marks: int, target: str) -> str:
    """Which of the first `n_marks` letters, or the next one."""
    letters, elsewhere = ", ".join(LETTERS[:n_marks]), LETTERS[n_marks]
    return DIRECTION.format(letters=letters, elsewhere=elsewhere, target=target)


def scene_question(target: str) -> str:
    """Whether the view as a whole promises anything."""
    return SCENE.format(target=target)


def describe(view: View) -> str:
    """What was detected, and where the lettered frontiers lie.

    >>> import numpy as np
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
