"""Task section of a report's page: the instruction and its trajectories (OpenNav III-A).

It also draws the trajectories on the map, and makes their 3-D page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from edge.geometry import SE2, Grid
from edge.lab.report import palette, raster
from edge.lab.report.record import RunRecord
from edge.lab.report.view3d import Line, coarse_and_refined, scene_page
from edge.tasks.facts import TaskStatus, lengths_m
from edge.tasks.scene.objects import box_around
from edge.tasks.scene.scene import Region, Scene, SceneObject
from edge.tasks.write import PlanAttempt
from edge.text import bounded_lines, one_line, shorten
from edge.types import Instance

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCENE_NAME = "trajectory.html"  # file of the 3-D page
COARSE, REFINED = "#b35309", "#7048e8"  # colours of the trajectories
MAX_TEXT, MAX_CODE, MAX_PROMPT = 4000, 20_000, 100_000  # characters
_TOO_CLOSE = (1, 99)  # least and largest map value of free cells too near to an obstacle


def section(record: RunRecord, linked: bool) -> str:
    """Return the task's HTML: instruction, writer, answers and trajectories; "" without a task."""
    task = record.task
    if task is None:
        return ""
    pairs = [("asked", task.instruction), ("written by", task.writer), ("outcome", task.phase)]
    trajectories = _by_coarse_trajectory(record)
    if task.understood and len(trajectories) < 2:
        pairs.append(("understood as", task.understood))
    if len(task.steps) > 1:
        pairs += [(step.state, step.said) for step in task.steps]
    if task.missing:
        pairs.append(("not seen", ", ".join(task.missing)))
    pairs += _descriptions(trajectories)
    rows = "".join(
        f"<dt>{escape(k)}</dt><dd>{escape(one_line(v, MAX_TEXT))}</dd>" for k, v in pairs
    )
    link = f'<p><a href="{SCENE_NAME}">The trajectory in three dimensions</a></p>' if linked else ""
    attempts = "".join(
        _attempt(number, attempt) for number, attempt in enumerate(task.rounds, start=1)
    )
    prompt = ""
    if task.prompt:
        prompt = _details("Prompt", f"<pre>{escape(bounded_lines(task.prompt, MAX_PROMPT))}</pre>")
    return (
        f'<section><h2>Task</h2><dl class="story">{rows}</dl>{link}{attempts}{prompt}</section>'
    )  # fmt: skip


def _by_coarse_trajectory(record: RunRecord) -> list[list[TaskStatus]]:
    """Group the statuses by coarse trajectory, in order of time.

    Each group has one coarse trajectory with all its refinements.
    """
    groups: list[list[TaskStatus]] = []
    for status in record.trajectories:
        if groups and groups[-1][-1].coarse_m is status.coarse_m:
            groups[-1].append(status)
        else:
            groups.append([status])
    return groups


def _descriptions(groups: Sequence[Sequence[TaskStatus]]) -> list[tuple[str, str]]:
    """Return each coarse trajectory as text, and its notes, as (name, text)."""
    pairs = []
    for number, group in enumerate(groups, start=1):
        name, words = "trajectory", _in_words(group)
        if len(groups) > 1:
            name, words = f"trajectory {number}", f"{group[0].understood}: {words}"
        notes = dict.fromkeys(note for status in group for note in status.notes)
        pairs += [(name, words), *(("note", note) for note in notes)]
    return pairs


def _in_words(group: Sequence[TaskStatus]) -> str:
    """Return a trajectory's length at first, and how often the rest of it was refined again."""
    first, last = group[0], group[-1]
    assert first.refined is not None
    assert last.refined is not None
    length_m, driven_m = lengths_m(first.refined, first.index)
    words = f"{length_m:.1f} m in {first.refined.times_s[-1]:.1f} s"
    if first is last and driven_m:
        words += f", {driven_m:.1f} m of it driven"
    # The report may have missed refinements; the status counts them.
    if times := (len(group) - 1 or last.refinements - 1):
        length_m, driven_m = lengths_m(last.refined, last.index)
        words += f"; the rest refined again {times} times"
        words += f", {driven_m:.1f} of the last {length_m:.1f} m driven"
    return words


def _attempt(number: int, attempt: PlanAttempt) -> str:
    """Return one answer (attempt) of a model as HTML: its code, or its text without code."""
    outcome = (
        '<span class="over">refused</span>' if attempt.error else '<span class="ok">used</span>'
    )
    parts = []
    if attempt.error:
        parts.append(f'<p class="over">{escape(one_line(attempt.error, MAX_TEXT))}</p>')
    text = attempt.code or attempt.answer
    parts.append(
        f"<pre>{escape(bounded_lines(text, MAX_CODE if attempt.code else MAX_TEXT))}</pre>"
    )
    if attempt.printed:
        printed = escape(bounded_lines(attempt.printed, MAX_TEXT))
        parts.append(f'<p class="note">printed</p><pre>{printed}</pre>')
    return _details(f"Answer {number}: {outcome}", "".join(parts))


def _details(summary: str, body: str) -> str:
    return f"<details><summary>{summary}</summary>{body}</details>"


def points_m(record: RunRecord) -> list[np.ndarray]:
    """Return the points of all trajectories, (n, 2 or more) each, in `map`."""
    lines = [
        line
        for status in record.trajectories
        for line in (status.coarse_m, status.refined and status.refined.poses)
    ]
    return [line for line in lines if line is not None]


def draw(axes: Axes, record: RunRecord) -> None:
    """Draw the coarse and the refined trajectories on the map, under the robot's path."""
    for status in record.trajectories:
        if status.refined is not None:
            x_m, y_m = status.refined.poses[:, :2].T
            style = {"solid_capstyle": "round", "solid_joinstyle": "round"}
            axes.plot(x_m, y_m, color=REFINED, lw=7.5, alpha=0.45, zorder=2.6, **style)
    for status, *_ in _by_coarse_trajectory(record):
        if status.coarse_m is not None:
            axes.plot(*status.coarse_m.T, color=COARSE, lw=1.6, ls=(0, (1.2, 1.6)), zorder=4.5)


def page(record: RunRecord) -> str | None:
    """Return the 3-D page with map, objects and trajectories.

    None if there is no trajectory or no map.
    """
    task, known = record.task, None if record.map is None else raster.crop(record.map)
    trajectories = [
        group for group in _by_coarse_trajectory(record) if group[0].coarse_m is not None
    ]
    if task is None or not trajectories or known is None:
        return None
    lines: list[Line] = []
    for number, (status, *_) in enumerate(trajectories, start=1):
        pair = coarse_and_refined(status.coarse_m, status.refined)
        many = len(trajectories) > 1
        lines += [replace(line, name=f"{line.name} {number}") if many else line for line in pair]
    driven = Line("driven", record.trajectory[:, :2], palette.START, 3.0)
    facts = [
        (name, one_line(text, MAX_TEXT))
        for name, text in (
            ("asked", task.instruction), ("understood", task.understood), ("by", task.writer),
            *_descriptions(trajectories),
        )
        if text
    ]  # fmt: skip
    return scene_page(
        record.title, _scene(record, known), (*lines, driven), record.machine,
        refined=trajectories[-1][0].refined, facts=facts,
    )  # fmt: skip


def _scene(record: RunRecord, known: Grid) -> Scene:
    """Return the scene at the end of the run; the robot stands at its start."""
    cells = known.cells
    # Such cells count as free.
    near = (cells >= _TOO_CLOSE[0]) & (cells <= _TOO_CLOSE[1])
    occupancy = Grid(
        np.where(near, 0, cells).astype(np.int8), known.origin_xy_m, known.resolution_m
    )
    floor = Grid((occupancy.cells == 0).astype(np.uint8), known.origin_xy_m, known.resolution_m)
    area_m2 = float(np.count_nonzero(floor.cells)) * known.resolution_m**2
    start = SE2(*record.trajectory[0].tolist()) if len(record.trajectory) else SE2(0.0, 0.0, 0.0)
    found = [i for i in record.instances if len(i.points_m) and i.state != "rejected"]
    # Without an image: no camera, no pose of a camera, no outlines.
    return Scene(
        record.start_ns, start, {instance.id: _scene_object(instance) for instance in found},
        {1: Region(1, "floor", area_m2)}, occupancy, floor, None, None, None, {},
    )  # fmt: skip


def _scene_object(found: Instance) -> SceneObject:
    """Return an instance as an object of the scene, with the box around its points."""
    position_m, size_m, heading_rad = box_around(found.points_m)
    label = shorten(found.label, 60)
    caption = f"{found.state}, score {found.score:.2f}"
    return SceneObject(
        found.id, label, caption, position_m, size_m, heading_rad, found.points_m, {}
    )  # fmt: skip
