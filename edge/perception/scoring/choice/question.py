"""Questions and answers of VLM frontier selection, in the words of ViTL (IV-B1).

A language model that takes no images gets the view in words, as in ESC and L3MVN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from edge.perception.runtime.card_types import MAX_MARKS
from edge.types import Observation

LETTERS = "ABCDEFGHJ"
"""One letter for each mark, and the next one for "explore elsewhere".

There is no I: it often begins a sentence and would pass for an answer."""

# The system message, and the questions of ViTL.
SYSTEM = (
    "You guide a robot that explores a building. Answer each question with one letter or one word."
)
DIRECTION = (
    "Among directions ({letters}), or explore elsewhere ({elsewhere}), which should I choose to "
    "find a {target}? Answer with ONLY a single letter."
)
SCENE = "Does this view show paths or doorways that could lead to a {target}? Answer Yes or No."
AHEAD_RAD = 0.2  # largest bearing that is described as "ahead"


class Mark(NamedTuple):
    """A frontier in the camera's view.

    Attributes:
        u_px: column in the observation's image.
        v_px: row in the observation's image.
        bearing_rad: angle from the robot's heading, positive to the left.
        distance_m: straight distance from the robot.
    """

    id: int
    u_px: float
    v_px: float
    bearing_rad: float
    distance_m: float


class DetectedObject(NamedTuple):
    """An object that was just detected.

    Attributes:
        bearing_rad: angle from the robot's heading, positive to the left.
        distance_m: straight distance from the robot.
    """

    label: str
    bearing_rad: float
    distance_m: float


class MarkCosts(NamedTuple):
    """Path lengths and expected gains of the frontiers, by the robot's map.

    Attributes:
        path_m: (n,) float32, driving distance to each mark, inf if it is unreachable.
        gain_m2: (n,) float32, unknown area that each mark is expected to show.
        others: (3,) float32, about the reachable frontiers without a mark: their number, the least
            driving distance to one [m] (0: there are none), and the largest unknown area that one
            is expected to show [m²].
    """

    path_m: np.ndarray
    gain_m2: np.ndarray
    others: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class MarkedView:
    """The input of VLM frontier selection: an image with marks, and a target.

    Attributes:
        observation: observation with the image, which is read while the caller holds it.
        target: name of the object that the robot looks for.
        marks: from left to right; only the first `MAX_MARKS` get letters.
        objects: objects just detected, for a model that takes no images.
        likelihood_ratio: (n,) float32, P(target near the mark) / P(target near an average place),
            given all objects seen so far; None: there is no prior.
        mark_costs: paths to the marks; None: there is no map.
    """

    observation: Observation
    target: str
    marks: tuple[Mark, ...]
    objects: tuple[DetectedObject, ...] = ()
    likelihood_ratio: np.ndarray | None = None
    mark_costs: MarkCosts | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FrontierChoice:
    """A model's answer for one view.

    Attributes:
        ids: (n,) ids of the candidates whose marks the model could choose; some of the candidates
            may no longer exist.
        p: (n,) float32, P(f_i | I_t, c_k) of ViTL eq. 4, the probability of each mark.
        elsewhere: the probability of "explore elsewhere"; `p` and `elsewhere` sum to 1.
        scene: S_curr of ViTL eq. 5, the probability that the view leads to the target.
    """

    stamp_ns: int
    target: str
    ids: tuple[int, ...]
    p: np.ndarray
    elsewhere: float
    scene: float

    @property
    def value(self) -> np.ndarray:
        """V_curr(f_i) of ViTL eq. 6, the score of each candidate in `ids`, (n,) float32."""
        return np.float32(self.scene) * self.p


def choice_of(
    view: MarkedView, marks: Sequence[Mark], p: np.ndarray, scene: float
) -> FrontierChoice:
    """Build the answer for a view.

    Args:
        view: the input.
        marks: n marks that the model could choose.
        p: (n + 1,) probability of each mark, and of "explore elsewhere".
        scene: probability that the view leads to the target.
    """
    return FrontierChoice(
        view.observation.stamp_ns, view.target, tuple(mark.id for mark in marks),
        p[:-1].astype(np.float32), float(p[-1]), scene,
    )  # fmt: skip


def direction_question(n_marks: int, target: str) -> str:
    """Return the question for one of the first `n_marks` letters, or the next for "elsewhere"."""
    letters, elsewhere = ", ".join(LETTERS[:n_marks]), LETTERS[n_marks]
    return DIRECTION.format(letters=letters, elsewhere=elsewhere, target=target)


def scene_question(target: str) -> str:
    """Return the yes-no question about the entire view."""
    return SCENE.format(target=target)


def describe(view: MarkedView) -> str:
    """Describe detections and lettered frontiers in words.

    >>> import numpy as np
    >>> from edge.types import Observation
    >>> seen = (DetectedObject("bed", 0.5, 2.14),)
    >>> marks = (Mark(7, 0, 0, 0, 3),)
    >>> print(describe(MarkedView(Observation(0, 0, np.eye(4)), "lamp", marks, seen)))
    The robot sees:
    - bed, left, 2.1 m
    It can go on in these directions:
    - A: ahead, 3.0 m
    """
    seen = [f"- {s.label}, {_describe_position(s.bearing_rad, s.distance_m)}" for s in view.objects]
    directions = [
        f"- {letter}: {_describe_position(mark.bearing_rad, mark.distance_m)}"
        for letter, mark in zip(LETTERS, view.marks[:MAX_MARKS], strict=False)
    ]
    headings = ("The robot sees:", "It can go on in these directions:")
    return "\n".join(
        [headings[0], *(seen or ["- nothing that it knows"]), headings[1], *directions]
    )


def _describe_position(bearing_rad: float, distance_m: float) -> str:
    side = "ahead" if abs(bearing_rad) <= AHEAD_RAD else "left" if bearing_rad > 0 else "right"
    return f"{side}, {distance_m:.1f} m"
