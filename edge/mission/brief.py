"""From an instruction to a mission that can be run, or to one line that says why not."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from edge import names
from edge.config import Mission, TranslatorLtl
from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Site
from edge.mission.language.english import describe
from edge.mission.language.places import EXPLORED, HERE, START, quote_places
from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.diagnosis import Diagnosis, diagnose
from edge.mission.logic.ltl import Formula
from edge.mission.planning.planner import make_planner
from edge.mission.task_step import TaskStep
from edge.mission.translate import Translation, make_translator
from edge.text import one_line

_NO_SITE = Site()
_IN_ENGLISH = {
    START: "the start", HERE: "the place where this mission begins",
    EXPLORED: "the end of exploring",
}  # fmt: skip
_MOST_SHOWN = 600  # of the parts of a contradiction


class MissionError(UserError):
    """A mission that is refused before it begins; one line."""


@dataclass(frozen=True, slots=True, eq=False)
class Brief:
    """A mission, ready to be run.

    Attributes:
        automaton: over the targets; letters that do not matter are left out. Of a task its state
            is the number of steps that were driven, one with each step in which nothing is reached.
        targets: the propositions that matter, in order of first appearance: what the detector
            is asked for, one VL channel each.
        prompts: what the detector looks for: the targets that are things, or else the target of
            the configuration.
        steps: of a task (`edge.tasks`), at least one. None: it is no task.
    """

    translation: Translation
    automaton: Automaton
    diagnosis: Diagnosis
    targets: tuple[str, ...]
    prompts: tuple[str, ...]
    steps: tuple[TaskStep, ...] | None = None

    def prompt_for(self, target: str) -> str:
        """Return the prompt to score frontiers for while this target is pursued."""
        return target if target in self.prompts else self.prompts[0]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a person should know before the robot drives."""
        unused = one_line(", ".join(self.diagnosis.unused))
        told = [f"does not matter to the mission: {unused}"] if unused else []
        if self.translation.implied:
            ways = len(self.translation.readings)
            told.append(
                f"it can be read in {ways} ways: nobody was there to choose, so reading "
                f"{self.translation.reading} was taken, which fulfils all of them"
            )
        return tuple(told)


def prepare(
    config: Mission,
    instruction: str | None = None,
    formula: str | None = None,
    reading: int | None = None,
    site: Site = _NO_SITE,
) -> Brief:
    """Translate, compile and check a mission; may take as long as its translator does.

    Args:
        instruction: read by the configured translator. Whoever gives it can be asked; of the
            configuration's own, which nobody may be there to choose for, the safer reading is
            taken (see `Translator.translate`).
        formula: linear temporal logic, in place of an instruction. With neither, the
            configuration's own instruction or target is taken.
        reading: which of the given instruction's readings is meant, counted from 1; of the
            configuration's own, `config.reading` tells.
        site: its places are targets that need no search.

    Raises:
        AmbiguousError: the instruction can be read in several ways, and none was chosen.
        UserError: the instruction was not understood, the formula is malformed, too large, a
            contradiction (the parts that conflict are named), asks for nothing, or is too large for
            the configured planner.
    """
    names_of_places = [place.name for place in site.places]
    if formula is not None:
        translation = make_translator(TranslatorLtl()).translate(formula)
    elif instruction is not None or config.instruction is not None:
        translator = make_translator(config.translator)
        if instruction is not None:
            said = quote_places(instruction, names_of_places)
            translation = translator.translate(said, reading)
        else:
            instruction = config.instruction
            said = quote_places(instruction, names_of_places)
            translation = translator.translate(said, config.reading, ask=False)
        english = translation.english
        for name, plain in _IN_ENGLISH.items():
            english = english.replace(f'"{name}"', plain)
        translation = replace(translation, instruction=instruction, english=english)
    else:
        reach = ltl.eventually(ltl.ap(config.target))
        translation = Translation(config.target, reach, describe(reach), "target")
    return brief_of(config, located(translation, site))


def located(translation: Translation, site: Site) -> Translation:
    """Return a translation in which propositions with the name of a place mean that place."""
    found: dict[str, SE2 | None] = {}
    for letter in ltl.propositions(translation.formula):
        place = site.place(letter)
        if place is not None or letter in (START, HERE, EXPLORED):
            found[letter] = None if place is None else place.pose
    return replace(translation, places=found)


def brief_of(config: Mission, translation: Translation) -> Brief:
    """Compile and check what was translated, and that the planner can take it on; see `prepare`."""
    formula = _unified(translation.formula, translation.places)
    translation = replace(translation, formula=formula)
    letters = ltl.propositions(formula)
    _check_number(config, len(letters))
    limits = (config.max_states, config.compile_limit_steps)
    automaton = compile_formula(formula, *limits, config.compiler)
    diagnosis = diagnose(automaton, *limits)
    if diagnosis.contradiction:
        shown = ((one_line(part), one_line(describe(part))) for part in diagnosis.contradiction)
        parts = one_line("; ".join(f"{part} ({english})" for part, english in shown), _MOST_SHOWN)
        what = "these conflict" if len(diagnosis.contradiction) > 1 else "this cannot be done"
        raise MissionError(f"mission: a contradiction, {what}: {parts}")
    if automaton.steps_left[0] == 0:
        always = ", whatever is reached" if diagnosis.tautology else ""
        raise MissionError(
            f"mission: fulfilled by doing nothing{always}; name something to reach: "
            f"{one_line(formula)} ({one_line(translation.english)})"
        )
    targets = tuple(letter for letter in letters if letter not in diagnosis.unused)
    automaton = _narrowed(automaton, targets)
    make_planner(
        config.planner, automaton, translation.instruction
    )  # refuses what it cannot take on
    things = tuple(letter for letter in targets if letter not in translation.places)
    return Brief(translation, automaton, diagnosis, targets, things or (config.target,))


def brief_of_task(
    config: Mission, translation: Translation, targets: tuple[str, ...], steps: tuple[TaskStep, ...]
) -> Brief:
    """A task: what is to be reached is a trajectory's end, so no formula says anything of it.

    Args:
        targets: what the detector is to look for, at least one name.
        steps: at least one.

    Raises:
        MissionError: there are more targets than are allowed.
    """
    _check_number(config, len(targets))
    states = np.arange(len(steps) + 1, dtype=np.int32)
    delta = np.repeat(states[:, None], len(targets) + 1, axis=1)
    delta[:-1, -1] += 1
    chain = Automaton(ltl.TRUE, targets, delta, states == len(steps), np.zeros_like(states))
    return Brief(translation, chain, Diagnosis((), True, ()), targets, targets, steps)


def task_of(brief: Brief) -> dict[str, Any] | None:
    """What makes a task of a mission, beside its translation: the arguments of `brief_of_task`."""
    if brief.steps is None:
        return None
    return {"targets": brief.targets, "steps": [asdict(step) for step in brief.steps]}


def brief_again(config: Mission, translation: Translation, task: dict[str, Any] | None) -> Brief:
    """A mission or a task again, from what `task_of` gave."""
    if task is None:
        return brief_of(config, translation)
    steps = tuple(TaskStep(s["said"], tuple(s["names"]), s["joined"]) for s in task["steps"])
    return brief_of_task(config, translation, tuple(task["targets"]), steps)


def _check_number(config: Mission, targets: int) -> None:
    if targets > config.max_targets:
        raise MissionError(
            f"mission: {targets} targets, at most {config.max_targets} are allowed "
            "(mission.max_targets)"
        )


def _narrowed(automaton: Automaton, letters: tuple[str, ...]) -> Automaton:
    """Without the letters that do not matter: no planner is to send the robot looking for them."""
    if letters == automaton.letters:
        return automaton
    columns = [automaton.letters.index(letter) for letter in letters]
    delta = np.ascontiguousarray(automaton.delta[:, [*columns, len(automaton.letters)]])
    return replace(automaton, letters=letters, delta=delta)


def _unified(formula: Formula, places: Collection[str]) -> Formula:
    """Return the formula with one word for one thing: of synonyms, the one that came first.

    A place keeps its name: what a person calls a place is no synonym of a thing.
    """
    first: dict[str, str] = {}

    def key(name: str) -> str:
        return f"place {name}" if name in places else names.canonical(name)

    for name in ltl.propositions(formula):
        first.setdefault(key(name), name)
    return ltl.renamed(formula, lambda name: first[key(name)])
