"""Section of a report with a few answers of the choice model, and the value maps.

A choice model chooses among the frontiers, which are marks (letters) in the image. A value map has
the value V of each cell, as the model's answers gave it (ViTL eq. 6).
"""

from __future__ import annotations

import cv2
import numpy as np

from edge.geometry import Grid
from edge.lab.report import raster
from edge.lab.report.document import image_figure
from edge.lab.report.keyframes import MAX_FRAME_PX
from edge.lab.report.record import ChoiceFrame, RunRecord
from edge.loop.result import TickResult
from edge.perception.scoring.choice.picture import draw, visible_marks
from edge.perception.scoring.choice.question import LETTERS
from edge.policies.base import FRONTIER

MAX_VALUE_PX = 640  # longest side of a drawn value map
_FIRST_INTERVAL_NS = 2_000_000_000  # least time between two kept answers; it grows in long runs


class ChoiceFrameBuffer:
    """Keeps at most `capacity` answers of the choice model, spread over the run.

    If the buffer is full, every second answer is dropped, and the least time between two kept
    answers doubles.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._kept: list[ChoiceFrame] = []
        self._interval_ns, self._last_ns = _FIRST_INTERVAL_NS, 0

    def offer(self, result: TickResult) -> None:
        """Keep the newest answer with its image, unless it or one shortly before it was kept."""
        choice, observation = result.choice, result.observation
        if self._capacity == 0 or choice is None or observation is None or observation.rgb is None:
            return
        if choice.stamp_ns == self._last_ns or (
            self._kept and 0 <= choice.stamp_ns - self._last_ns < self._interval_ns
        ):
            return
        candidates = result.candidates()
        # The frontiers that the model could choose, as far as they still exist.
        asked = np.isin(candidates.id, choice.ids) & (candidates.kind == FRONTIER)
        marks = visible_marks(observation, candidates.xy_m[asked], candidates.id[asked])
        if not marks:  # the robot has turned away since then
            return
        # `shown`: marks that got a letter, in the order of the letters.
        image, shown = draw(observation.rgb, marks, MAX_FRAME_PX)
        p = dict(zip(choice.ids, choice.p.tolist(), strict=True))  # probability by candidate
        letters = tuple((a, p[m.id]) for a, m in zip(LETTERS, shown, strict=False))
        self._last_ns = choice.stamp_ns
        self._kept.append(
            ChoiceFrame(
                choice.stamp_ns, image, choice.target, letters, choice.elsewhere, choice.scene
            )
        )
        if len(self._kept) > self._capacity:
            del self._kept[1::2]
            self._interval_ns *= 2

    def frames(self) -> tuple[ChoiceFrame, ...]:
        """Return the kept answers in order of time."""
        return tuple(self._kept)


def section(record: RunRecord) -> str:
    """Return the section as HTML; empty if no model was asked and there is no value map."""
    if not record.asked and not record.values:
        return ""
    figures = "".join(_figure(frame, record) for frame in record.asked)
    figures += "".join(_value_map(name, grid) for name, grid in record.values.items())
    return (
        f"<section><h2>Directions: questions to the model, and the final value map</h2>"
        f'<div class="frames">{figures}</div><p class="note">Letters: the frontiers in view; '
        "V = S · P of ViTL eq. 6. Brighter cells of the value map have higher values.</p></section>"
    )


def _figure(frame: ChoiceFrame, record: RunRecord) -> str:
    """Return an answer as HTML: the image with its letters, and their probabilities below."""
    shares = " · ".join(f"{letter} {p:.2f}" for letter, p in frame.letters)
    caption = (
        f"{record.seconds(frame.stamp_ns):.1f} s, {frame.target}: {shares} · elsewhere "
        f"{frame.elsewhere:.2f}; scene {frame.scene:.2f}"
    )
    return image_figure(frame.rgb, caption)


def _value_map(name: str, grid: Grid) -> str:
    """Return the known part of a value map as HTML; the highest value is brightest."""
    known = grid.cells > 0
    if not known.any():
        return ""
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    cells = grid.cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    step = -(-max(cells.shape) // MAX_VALUE_PX)  # rounded up
    cells = cells[::step, ::step][::-1]  # y points up
    # Unknown cells (0) get the map's colour for unknown (-1).
    shown = cv2.applyColorMap(np.ascontiguousarray(cells), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    shown = np.where((cells > 0)[..., None], shown, raster.colour(np.array([-1]))[0])
    return image_figure(np.ascontiguousarray(shown, np.uint8), name)
