"""Builds the self-contained page of a comparison: tables, and every trail on its map.

The maps are static. A short script sorts and filters them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files

import numpy as np

from edge.lab.eval.comparison import tables, trails
from edge.lab.eval.comparison.statistics import Comparison, spl_of
from edge.lab.eval.comparison.trails import TrailBackground
from edge.lab.eval.comparison.worlds import FloorPlanDrawing
from edge.lab.eval.outcome import FAILURES
from edge.lab.report.document import document
from edge.text import one_line


def html(
    comparison: Comparison, drawings: Mapping[str, FloorPlanDrawing], title: str, machine: str
) -> str:
    """Build the page."""
    outcomes = comparison.outcomes
    n, worlds = len(outcomes.episodes), len(set(outcomes.world.tolist()))
    words = f"{n} episodes in {worlds} worlds, {len(outcomes.arms)} arms"
    body = (
        f'<header><h1>{escape(title)}</h1><p class="reason">{words}</p></header>',
        *(tables.html(table) for table in tables.tables(comparison)),
        _trails(comparison, drawings),
    )
    script = files(__package__).joinpath("page.js").read_text(encoding="utf-8")
    style = files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    style += "".join(f".t{k}{{stroke:{colour}}}" for k, colour in enumerate(trails.RAMP))
    style += "".join(f'.hide{a} [data-c="{a}"]{{display:none}}' for a in range(len(outcomes.arms)))
    return document(title, "".join(body), machine, style, script)


def _trails(comparison: Comparison, drawings: Mapping[str, FloorPlanDrawing]) -> str:
    outcomes = comparison.outcomes
    spl = spl_of(outcomes)
    grounds = trails.backgrounds_of(drawings)
    rows = "".join(
        _episode_row(comparison, e, spl[:, e], grounds) for e in range(len(outcomes.episodes))
    )
    listed = f'<div id="episodes" style="--n:{len(outcomes.arms)}">{rows}</div>'
    return (
        f'{trails.symbols(grounds)}<section id="trails"><h2>Every trail</h2>{_legend()}'
        f"{_controls(comparison)}{listed}</section>"
    )


def _episode_row(
    comparison: Comparison, e: int, spl: np.ndarray, grounds: Mapping[str, TrailBackground]
) -> str:
    """Build the row of an episode: its target, and a map for each arm."""
    outcomes = comparison.outcomes
    arms = range(len(outcomes.arms))
    ran = {a: outcomes.at[a, e] for a in arms if outcomes.ran[a, e]}
    target, world = str(outcomes.target[e]), str(outcomes.world[e])
    facts = [world, f"{outcomes.shortest_m[e]:.1f} m away", outcomes.episodes[e]]
    ground = grounds.get(world) or trails.empty_background(list(ran.values()))
    maps = "".join(
        trails.figure(ground, target, outcomes.arms[a], a, ran.get(a), float(spl[a])) for a in arms
    )
    instruction = next(iter(ran.values())).instruction
    paths = [outcomes["path_m"][a, e] for a in arms]
    return (
        f'<article data-i="{e}" data-target="{escape(target)}" '
        f'data-kinds="{escape("|".join(outcomes.failure[:, e].tolist()))}" '
        f'data-spl="{_numbers(spl)}" data-path="{_numbers(paths)}" '
        f'data-shortest="{outcomes.shortest_m[e]:.2f}">'
        f"<h3>{escape(one_line(target or instruction or 'mission'))} "
        f"<span>{escape(one_line(' · '.join(facts)))}</span></h3>"
        f'<div class="maps">{maps}</div></article>'
    )


def _numbers(values: Sequence[float]) -> str:
    """Join numbers with commas; NaN gives an empty text."""
    return ",".join("" if math.isnan(v) else f"{v:.4g}" for v in values)


def _legend() -> str:
    ramp = ", ".join(trails.RAMP)
    return (
        '<p class="note legend"><svg viewBox="-8 -8 16 16"><circle class="start" r="5"/></svg>'
        f'start <i style="background:linear-gradient(90deg,{ramp})"></i> path from start to end '
        '<svg viewBox="-8 -8 16 16"><circle class="seen" r="5"/></svg>target first in view '
        '<svg viewBox="-8 -8 16 16"><path class="g f" d="M0 0h0"/></svg>frontier goal '
        '<svg viewBox="-8 -8 16 16"><path class="g i" d="M0 0h0"/></svg>goal at an object '
        '<svg viewBox="-8 -8 16 16"><rect class="thing" x="-6" y="-5" width="12" height="10"/>'
        "</svg>target. Click a map to enlarge it.</p>"
    )


def _controls(comparison: Comparison) -> str:
    """Build the form that sorts and filters the episodes. A and B are two arms to choose."""
    outcomes = comparison.outcomes
    names = [one_line(name, 40) for name in outcomes.arms]
    targets = sorted({t for t in outcomes.target.tolist() if t})
    kinds = [k for k in FAILURES if any(f[k] for f in comparison.failures.values())]
    # (value for the script, text) of each choice.
    order_options = (
        ("", "as planned"), ("difference", "SPL of A minus B"), ("spl", "SPL of A"),
        ("path", "path of A"), ("shortest", "shortest path"),
    )  # fmt: skip
    outcome_options = (
        ("", "any"), ("failed", "A failed"), ("reached", "A succeeded"),
        ("lost", "A failed, B succeeded"), ("some", "some failed"), ("all", "all failed"),
        *((f"kind:{kind}", f"A: {kind}") for kind in kinds),
    )  # fmt: skip
    numbered = [(str(a), name) for a, name in enumerate(names)]
    base = comparison.baseline
    other = next((a for a in range(len(names)) if a != base), base)
    shown = "".join(
        f'<label class="column"><input type="checkbox" data-hide="{a}" checked>{escape(name)}'
        "</label>"
        for a, name in enumerate(names)
    )
    return (
        '<form id="controls">'
        f"{_select('a', 'A', numbered, other)}{_select('b', 'B', numbered, base)}"
        f"{_select('order', 'sort by', order_options)}"
        '<label><input type="checkbox" id="reverse">largest first</label>'
        f"{_select('target', 'target', [('', 'any'), *((t, one_line(t, 40)) for t in targets)])}"
        f"{_select('outcome', 'outcome', outcome_options)}"
        f'<output id="count"></output><span class="break"></span>{shown}</form>'
    )


def _select(
    name: str, label: str, options: Sequence[tuple[str, str]], chosen: int | None = None
) -> str:
    """Build a menu. Options are (value, text); `chosen` is the index of the one at first."""
    inner = "".join(
        f'<option value="{escape(value)}"{" selected" if k == chosen else ""}>{escape(words)}'
        "</option>"
        for k, (value, words) in enumerate(options)
    )
    return f'<label>{escape(label)} <select id="{name}">{inner}</select></label>'
