"""`edge mission explain`: what a mission means, before any robot moves."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from edge.errors import UserError
from edge.host import resources
from edge.text import one_line

if TYPE_CHECKING:
    from edge.mission.automaton import Automaton

_DRAWINGS = (".svg", ".png", ".dot")
_LIST_CHARS = 1000


def run(args: argparse.Namespace) -> int:
    """Handle `edge mission explain`.

    Raises:
        UserError: the mission is refused, or the drawing cannot be written.
    """
    from edge.config import load
    from edge.mission.brief import prepare
    from edge.mission.planner import make_planner
    from edge.mission.planning.plan import Knowledge

    drawing = resources.expand(args.draw) if args.draw else None
    if drawing is not None and drawing.suffix not in _DRAWINGS:
        raise UserError(f"--draw: {drawing}: unknown ending (choices: {', '.join(_DRAWINGS)})")
    mission = load(args.config).mission
    text, formula = (None, args.text) if args.formula else (args.text, None)
    brief = prepare(mission, text, formula)
    translation = brief.translation
    planner = make_planner(mission.planner, brief.automaton, translation.instruction)
    plan = planner.plan(0, Knowledge())
    print(f"understood:  {translation.understood}")
    print(f"formula:     {one_line(translation.formula)}")
    print(f"by:          {translation.backend}, {translation.seconds:.2f} s")
    print(f"targets:     {one_line(', '.join(brief.targets), _LIST_CHARS)}")
    print(f"automaton:   {brief.automaton.n_states} states")
    steps = ", then ".join(step or "nothing" for step in plan.steps)
    print(f"first plan:  {one_line(steps, _LIST_CHARS)}")
    for warning in brief.warnings:
        print(f"warning:     {warning}")
    if drawing is not None:
        _draw(drawing, brief.automaton, plan.steps)
        print(drawing)
    return 0


def _draw(path: Path, automaton: Automaton, steps: tuple[str, ...]) -> None:
    from edge.host.files import save
    from edge.report import canvas, dot
    from edge.report.drawing import draw
    from edge.report.scene import make_scene

    content = {
        ".svg": lambda: canvas.svg(draw(make_scene(automaton, 0, steps))),
        ".png": lambda: canvas.png(draw(make_scene(automaton, 0, steps))),
        ".dot": lambda: dot.to_dot(automaton, 0, steps).encode(),
    }[path.suffix]()
    save(path, content)
