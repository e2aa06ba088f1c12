"""`edge mission explain`: shows the meaning and the plan of a mission; no robot is needed."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from edge import names
from edge.cli.options import require_extra
from edge.errors import ConfigError, UserError
from edge.host import resources
from edge.text import one_line

if TYPE_CHECKING:
    from edge.config import Config, DetectorOnnx, DetectorSim
    from edge.mission.logic.automaton import Automaton
    from edge.mission.spec import MissionSpec

_DRAWINGS = (".svg", ".png")
_LIST_CHARS = 1000  # longest line of targets, plan or reading


def run(args: argparse.Namespace) -> int:
    """Handle `edge mission explain`.

    Raises:
        UserError: the mission is refused, or the drawing cannot be written.
    """
    from edge.config import load
    from edge.mission.planning.plan import MissionKnowledge
    from edge.mission.planning.planner import make_planner
    from edge.mission.readings import AmbiguousInstructionError
    from edge.tasks.mission_spec import prepare_mission

    drawing = resources.expand(args.draw) if args.draw else None
    if drawing is not None and drawing.suffix not in _DRAWINGS:
        raise UserError(f"--draw: {drawing}: the name must end in one of {', '.join(_DRAWINGS)}")
    if drawing is not None:
        require_extra("lab")
    config = load(args.config)
    mission = config.mission
    wording = "formula" if args.formula else "instruction"
    try:
        spec = prepare_mission(config, **{wording: args.text}, reading=args.reading)
    except AmbiguousInstructionError as error:
        several = len(error.readings) > 1
        ways = f"it can be read in {len(error.readings)} ways" if several else "it may mean:"
        print(f"{'ambiguous:' if several else 'not sure:':13}{ways}")
        for doubt in error.doubts:
            print(f"word:        {doubt}")
        _print_readings([reading.english for reading in error.readings])
        print(f"choose:      --reading {'N' if several else 1}{_default_reading(error.implied)}")
        return 0
    if spec.steps is not None:
        if drawing is not None:
            raise UserError("--draw: a path in words has no automaton")
        steps = ", then ".join(step.said for step in spec.steps)
        print(f"path:        {one_line(steps, _LIST_CHARS)}")
        print(f"by:          {spec.translation.backend}")
        _print_warnings(config, spec)
        return 0
    translation = spec.translation
    planner = make_planner(mission.planner, spec.automaton, translation.instruction)
    plan = planner.plan(0, MissionKnowledge())
    print(f"understood:  {translation.understood}")
    if translation.readings:
        print(f"reading:     {translation.reading} of {len(translation.readings)}")
        _print_readings(translation.readings)
    print(f"formula:     {one_line(translation.formula)}")
    print(f"by:          {translation.backend}, {translation.seconds:.2f} s")
    print(f"targets:     {one_line(', '.join(spec.targets), _LIST_CHARS)}")
    print(f"automaton:   {spec.automaton.n_states} states")
    steps = ", then ".join(step or "nothing" for step in plan.steps)
    print(f"first plan:  {one_line(steps, _LIST_CHARS)}")
    _print_warnings(config, spec)
    if drawing is not None:
        _draw(drawing, spec.automaton, plan.steps)
        print(drawing)
    return 0


def _print_warnings(config: Config, spec: MissionSpec) -> None:
    for warning in (*spec.warnings, *_unknown_words(config.perception.detector, spec.prompts)):
        print(f"warning:     {one_line(warning, _LIST_CHARS)}")


def _unknown_words(detector: DetectorOnnx | DetectorSim, prompts: Sequence[str]) -> Iterator[str]:
    """Yield a line for each prompt that the detector's vocabulary lacks, also by another word.

    The encoder itself logs each phrase that it reads as its noun. Without an encoder, or a folder
    with models, there are no lines: `edge doctor` reports that.
    """
    from edge.perception.embedding.encoders import make_text_encoder
    from edge.perception.embedding.text import PromptError
    from edge.perception.runtime.cards import ModelError, load_detector_card

    if detector.kind != "onnx":
        return
    try:
        encoder = make_text_encoder(load_detector_card(detector.model), detector.vocabulary)
    except (ModelError, PromptError, ConfigError):
        return
    for prompt in prompts:
        try:
            word = encoder.resolve(prompt)
            if not names.is_kind_of(prompt, word.partition(" (")[0]):
                yield f"{prompt}: searched as {word}"
        except PromptError as error:
            yield f"the detector cannot look for it: {error}"


def _print_readings(readings: Sequence[str]) -> None:
    for number, english in enumerate(readings, start=1):
        print(f"  ({number})        {one_line(english, _LIST_CHARS)}")


def _default_reading(implied: int | None) -> str:
    """Return the reading that is used when no person can be asked, as the end of a sentence."""
    if implied is None:
        return "; without a choice, mission.instruction is refused (key mission.reading)"
    return (
        f"; without a choice, mission.instruction gets ({implied + 1}), which fulfils all the "
        "others"
    )


def _draw(path: Path, automaton: Automaton, steps: tuple[str, ...]) -> None:
    """Draw the automaton to a file; the suffix chooses the format."""
    from edge.host.files import save
    from edge.lab.report import canvas
    from edge.lab.report.automaton_graph import draw
    from edge.live.automaton_graph import make_automaton_graph

    drawing = draw(make_automaton_graph(automaton, 0, steps))
    save(path, canvas.svg(drawing) if path.suffix == ".svg" else canvas.png(drawing))
