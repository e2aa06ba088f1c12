"""HTML page about a run, in one file: no script, nothing fetched, all text escaped.

`write_report` writes it, together with the map as a PNG.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import NamedTuple

import yaml

from edge.errors import FileError
from edge.host import resources
from edge.host.files import make_writable, write_atomically
from edge.lab.report import choices, palette, picture, story, tasks
from edge.lab.report.document import data_url, document, image_figure, pairs_section
from edge.lab.report.record import Keyframe, RunRecord
from edge.loop.latency import LatencyReport, StageLatency

PNG_NAME = "report.png"
HTML_NAME = "report.html"
EMPHASISED = ("target", "reached", "failed")  # kinds of events that stand out in the timeline
MAX_SEEN = 4  # targets named under a frame


class ReportError(FileError):
    """Error of a report that cannot be written; the message is one line."""


class ReportPaths(NamedTuple):
    """Paths of a report; `scene` is the 3-D view of a task's trajectory, or None without one."""

    html: Path
    png: Path
    scene: Path | None = None


def prepare(directory: Path | str) -> Path:
    """Make the report's directory and check that it is writable, before the run starts.

    Raises:
        ReportError: the directory cannot be made or written to.
    """
    directory = resources.expand(directory)
    try:
        make_writable(directory)
    except OSError as error:
        raise _unwritable(directory, error) from None
    return directory


def write_report(record: RunRecord, directory: Path | str) -> ReportPaths:
    """Write `report.png` and `report.html` into `directory`; makes it if needed.

    A task also gets the 3-D page that the report links to.

    Raises:
        ReportError: the directory cannot be made or written to.
    """
    directory = prepare(directory)
    scene = tasks.page(record)
    scene_path = None if scene is None else directory / tasks.SCENE_NAME
    paths = ReportPaths(directory / HTML_NAME, directory / PNG_NAME, scene_path)
    png = picture.png(record)
    page = html(record, png, linked=scene is not None)
    try:
        write_atomically(paths.png, png)
        if paths.scene is not None and scene is not None:
            write_atomically(paths.scene, scene.encode("utf-8", errors="replace"))
        write_atomically(paths.html, page.encode("utf-8", errors="replace"))
    except OSError as error:
        raise _unwritable(directory, error) from None
    return paths


def _unwritable(directory: Path, error: OSError) -> ReportError:
    """Return the error to raise if the report cannot be written."""
    why = error.strerror or error
    return ReportError(f"{directory}: cannot write the report: {why} (name another with --report)")


def html(record: RunRecord, png: bytes, linked: bool = False) -> str:
    """Return the page as text, with `png` as its picture."""
    mission = record.mission
    colour = palette.outcome_colour(mission.phase)
    reason = f'<p class="reason">{escape(mission.reason)}</p>' if mission.reason else ""
    body = (
        f'<header><span class="badge" style="background:{colour}">{escape(mission.phase)}</span>'
        f"<h1>{escape(record.title)}</h1>{reason}</header>",
        _tiles(record),
        f'<section class="picture"><img alt="map of the run" src="{data_url("png", png)}">'
        "</section>",
        story.section(record) if record.task is None else tasks.section(record, linked),
        _latency(record.latency),
        _frames(record),
        choices.section(record),
        f'<div class="columns">{_timeline(record)}<div>{_facts(record)}</div></div>',
        _configuration(record),
    )
    return document(f"{mission.phase}: {record.title}", "".join(body), record.machine)


def _tiles(record: RunRecord) -> str:
    """Return the row of large figures."""
    latency, mission = record.latency, record.mission
    detect = latency.stage("detect")
    tiles = [
        (f"{mission.elapsed_s:.1f} s", "time"),
        (f"{mission.path_m:.1f} m", "driven"),
        (f"{record.map.known_m2:.0f} m²" if record.map is not None else "–", "mapped"),
        *_reached(record),
        (f"{len(record.goals)}", "goals"),
        (f"{len(record.instances)}", "instances"),
        (_ms(latency.tick.p95_ms, latency.tick.n), "tick p95"),
        (_ms(detect.p50_ms, detect.n), "detector p50"),
    ]
    cells = (
        f'<div class="tile"><b>{escape(v)}</b><span>{escape(k)}</span></div>' for v, k in tiles
    )
    return f'<div class="tiles">{"".join(cells)}</div>'


def _reached(record: RunRecord) -> list[tuple[str, str]]:
    """Return the figure of reached targets, unless there is only one target."""
    if record.has_single_target:
        return []
    return [(f"{len(record.reached)}", "reached")]


def _ms(value_ms: float, n: int) -> str:
    return f"{value_ms:.1f} ms" if n else "–"


def _latency(report: LatencyReport) -> str:
    """Return the table of latencies."""
    limit = report.limit
    names = ("stage", "n", "p50", "p95", "p99", "max", limit, "over", "drops")
    head = "".join(f"<th>{name}</th>" for name in names)
    head += f'<th class="bar">against the {limit}</th>'
    rows = "".join(_latency_row(row) for row in report.rows)
    tick = report.tick
    return (
        f'<section><h2>Latency, ms</h2><div class="scroll"><table><tr>{head}</tr>{rows}</table>'
        '</div><p class="note">Bars: p50 dark, p95 light, thin line = max, dashed line = the '
        f"{limit} that p95 is held to. The tick's deadline of {report.deadline_ms:g} ms was missed "
        f"{tick.overruns} of {tick.count} times. * runs outside the tick. "
        f"{escape(report.computer[:1].upper() + report.computer[1:])}.</p></section>"
    )


def _latency_row(row: StageLatency) -> str:
    """Return the table row of one stage."""
    times = (row.p50_ms, row.p95_ms, row.p99_ms, row.max_ms)
    texts = [f"{value:.2f}" if row.n else "–" for value in times]
    verdict = row.verdict if row.verdict in ("ok", "over") else ""
    texts[1] = f'<span class="{verdict}">{texts[1]}</span>'  # p95 is held to the limit
    has_limit = row.budget_ms is not None
    limit = (f"{row.budget_ms:.3g}", f"{row.overruns}") if has_limit else ("–", "–")
    name = escape(row.name if row.in_tick else f"{row.name}*")
    cells = (name, f"{row.count}", *texts, *limit, f"{row.drops}")
    css_class = "" if row.name != "tick" else ' class="tick"'
    tds = "".join(f"<td>{cell}</td>" for cell in cells)
    return f'<tr{css_class}>{tds}<td class="bar">{_bar(row)}</td></tr>'


def _bar(row: StageLatency) -> str:
    """Return p50 and p95 as SVG bars on a track of 1.5 budgets; longer bars are cut off."""
    budget_ms = row.budget_ms
    if budget_ms is None:
        return ""

    def x(value_ms: float) -> str:
        """Return a time as a position on the track, 0 to 100."""
        return f"{min(100.0, 100.0 * value_ms / (1.5 * budget_ms)):.2f}"

    over = " over" if row.verdict == "over" else ""
    share = f"p95 is {100 * row.p95_ms / budget_ms:.0f} % of {budget_ms:.3g} ms"
    words = share if row.n else "not run"
    return (
        f'<svg viewBox="0 0 100 8" preserveAspectRatio="none" role="img" aria-label="{words}">'
        f'<title>{words}</title><rect class="track" width="100" height="8" rx="1"/>'
        f'<rect class="p95{over}" width="{x(row.p95_ms)}" height="8" rx="1"/>'
        f'<rect class="p50{over}" width="{x(row.p50_ms)}" height="8" rx="1"/>'
        f'<path class="max" d="M{x(row.max_ms)} 0V8"/><path class="budget" d="M66.67 0V8"/></svg>'
    )


def _frames(record: RunRecord) -> str:
    """Return the section with the camera images."""
    if not record.frames:
        return '<section><h2>Frames</h2><p class="note">No frame was kept.</p></section>'
    figures = "".join(_figure(frame, record) for frame in record.frames)
    plural = "s" if len(record.targets) > 1 else ""
    return (
        f"<section><h2>Frames: best views of the target{plural}, and the last</h2>"
        f'<div class="frames">{figures}</div>'
        f'<p class="note">Detector: {escape(record.detector)}.</p></section>'
    )


def _figure(frame: Keyframe, record: RunRecord) -> str:
    """Return the image as JPEG, with boxes and labels as SVG, which stay sharp at any size."""
    h, w = frame.rgb.shape[:2]
    # The target's boxes come last, so that they are on top.
    order = sorted(range(len(frame.labels)), key=lambda i: (frame.is_target[i], frame.score[i]))
    boxes = "".join(_svg_box(frame, i, w, h, record.targets) for i in order)
    seen = [f"{label} {score:.2f}" for label, score in frame.best.items() if score > 0]
    caption = ", ".join([f"{record.seconds(frame.stamp_ns):.1f} s", *seen[:MAX_SEEN]])
    caption += "" if seen else ", target not seen"
    return image_figure(frame.rgb, caption, boxes)


def _svg_box(frame: Keyframe, i: int, w: int, h: int, targets: Mapping[str, str]) -> str:
    """Return box `i` of a frame of size (w, h), with its label, as SVG."""
    x0, y0, x1, y1 = (float(v) for v in frame.xyxy_px[i])
    if not all(map(math.isfinite, (x0, y0, x1, y1))):
        return ""
    colour = palette.OBJECT
    if frame.is_target[i]:
        colour = palette.target_colour(frame.labels[i], targets)
    words = f"{frame.labels[i]} {frame.score[i]:.2f}"
    size = w / 26  # of the font
    width, top = 0.56 * size * len(words) + 6, min(max(0.0, y0 - 1.3 * size), h - 1.3 * size)
    left = min(max(0.0, x0), max(0.0, w - width))
    return (
        f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}" '
        f'fill="none" stroke="{colour}" stroke-width="{w / 160:.1f}"/>'
        f'<rect x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{1.3 * size:.1f}" '
        f'fill="{colour}"/><text x="{left + 3:.1f}" y="{top + size:.1f}" fill="#fff" '
        f'font-size="{size:.1f}" font-family="sans-serif">{escape(words)}</text>'
    )


def _timeline(record: RunRecord) -> str:
    """Return events and goals in order of time; the mission's main steps stand out."""
    kinds = {step.text: step.kind for step in record.steps if step.kind in EMPHASISED}
    goals = [
        (record.seconds(g.stamp_ns), f"goal {i}: {g.kind} {g.candidate_id} at "
         f"({g.candidate_xy_m[0]:.1f}, {g.candidate_xy_m[1]:.1f}), score {g.score:.2f}")
        for i, g in enumerate(record.goals, start=1)
    ]  # fmt: skip
    lines = sorted([*record.events, *goals], key=lambda line: line[0])
    rows = "".join(
        f"<dt>{t_s:.1f} s</dt><dd{_class(kinds.get(text))}>{escape(text)}</dd>"
        for t_s, text in lines
    )
    content = f'<dl class="time">{rows}</dl>' if rows else '<p class="note">Nothing happened.</p>'
    return f"<section><h2>Timeline</h2>{content}</section>"


def _class(kind: str | None) -> str:
    return f' class="{kind}"' if kind else ""


def _facts(record: RunRecord) -> str:
    """Return the tables about the run, its counters and its instances."""
    run = [
        ("target" if len(record.targets) == 1 else "targets", ", ".join(record.targets)),
        ("robot", record.robot),
        ("detector", record.detector),
        ("configuration", record.config_path),
    ]
    counters = [(name, f"{value:g}") for name, value in record.counters.items() if value]
    if zero := [name for name, value in record.counters.items() if not value]:
        counters.append((", ".join(zero), "0"))  # one line for all of them
    instances = [
        (f"{i.label} {i.id} ({i.state}, {i.hits} hits)", f"{i.score:.2f}") for i in record.instances
    ]
    sections = (("Run", run), ("Counters", counters), ("Instances", instances))
    return "".join(pairs_section(title, pairs) for title, pairs in sections if pairs)


def _configuration(record: RunRecord) -> str:
    """Return the section with the configuration, folded."""
    if not record.config:
        return ""
    text = yaml.safe_dump(dict(record.config), sort_keys=False, allow_unicode=True)
    return (
        "<section><details><summary>The entire configuration</summary>"
        f"<pre>{escape(text)}</pre></details></section>"
    )
