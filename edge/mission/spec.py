"""Preparation of a mission: from an instruction or a formula to a `MissionSpec`, or a one-line
error."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from edge import names
from edge.config import MissionConfig, TranslatorLtl
from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Site
from edge.mission.language.english import describe
from edge.mission.language.errands import CHECK, spell_out
from edge.mission.language.grammar import readings
from edge.mission.language.places import EXPLORED, HERE, START, quote_places
from edge.mission.language.said import MissionOrder, NoMissionError, understand
from edge.mission.language.told_back import told_back
from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.diagnosis import Diagnosis, diagnose
from edge.mission.logic.ltl import Formula
from edge.mission.planning.planner import make_planner
from edge.mission.task_step import TaskStep
from edge.mission.translate import Translation, TranslationError, make_translator
from edge.text import one_line

_NO_SITE = Site()
_MOST_SHOWN = 600  # of the parts of a contradiction


class MissionError(UserError):
    """A mission that is refused before it starts; the message has one line."""


@dataclass(frozen=True, slots=True, eq=False)
class MissionSpec:
    """A mission that is ready to run.

    Attributes:
        translation: the instruction and its formula.
        automaton: over the targets; propositions that make no difference are removed. For a task,
            the state is the number of completed steps: each step without a reached object
            (`NOTHING`) adds one.
        diagnosis: result of checking the formula.
        targets: the propositions that make a difference, in order of first appearance.
        prompts: the targets that are things, or else the target of the configuration. The detector
            searches for them; each has one VL channel.
        steps: steps of a task (`edge.tasks`), at least one; None if this is no task.
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
        """Warnings for the operator before the robot drives."""
        unused = one_line(", ".join(self.diagnosis.unused))
        lines = [f"does not affect the mission: {unused}"] if unused else []
        if self.translation.implied:
            ways = len(self.translation.readings)
            lines.append(
                f"the instruction has {ways} readings and nobody chose one, so reading "
                f"{self.translation.reading} was taken: it fulfils all of them"
            )
        return tuple(lines)


def prepare(
    config: MissionConfig,
    instruction: str | None = None,
    formula: str | None = None,
    reading: int | None = None,
    site: Site = _NO_SITE,
) -> MissionSpec:
    """Translate, compile and check a mission; this can take as long as the translator does.

    Args:
        config: the `mission` section.
        instruction: text for the configured translator. Its sender can choose a reading. Nobody may
            be present to choose a reading of the configuration's own instruction, so the safer one
            is taken (see `Translator.translate`).
        formula: linear temporal logic, instead of an instruction. With neither, the instruction
            or the target of the configuration is used.
        reading: the chosen reading of the given instruction, counted from 1. For the
            configuration's own instruction, `config.reading` applies.
        site: a place of the site is a target that needs no search.

    Raises:
        AmbiguousError: the instruction has several readings, and none was chosen.
        UserError: the instruction was not understood, or the formula cannot be used: it is
            malformed, too large (also for the configured planner), a contradiction (the error
            names the parts in conflict), or asks for nothing.

    Example:
        >>> brief = prepare(Mission(), "Go to the bed, then to the sofa.")
        >>> str(brief.automaton.formula), brief.targets
        ('F (bed & F sofa)', ('bed', 'sofa'))
    """
    if formula is not None:
        translation = make_translator(TranslatorLtl()).translate(formula)
    elif instruction is not None or config.instruction is not None:
        ask = instruction is not None
        text = instruction if ask else config.instruction
        reading = reading if ask else config.reading
        try:
            translation = translate(config, text, site, reading, ask)
        except TranslationError as error:
            raise _placed(error, text) from None
    else:
        reach = ltl.eventually(ltl.ap(config.target))
        translation = Translation(config.target, reach, describe(reach), "target")
    return spec_of(config, located(translation, site))


def translate(
    config: MissionConfig,
    text: str,
    site: Site = _NO_SITE,
    reading: int | None = None,
    ask: bool = True,
) -> Translation:
    """Spell out the everyday words of an instruction and translate it; see `prepare`.

    Raises:
        NoMissionError: it is a question, an order to learn, or about the present mission.
        TranslationError: it is not understood.
    """
    places = [place.name for place in site.places]
    translator = make_translator(config.translator)
    if isinstance(config.translator, TranslatorLtl):
        return translator.translate(quote_places(text, places), reading, ask)
    said = understand(text, [item.name for item in site.items])
    if not isinstance(said, MissionOrder):
        raise NoMissionError(said)
    plain = said.speech.restored(spell_out(said.speech.text, places))
    given = quote_places(text, places)
    # What the grammar reads in the person's own words needs no spelling out. A check is no visit.
    chosen = given if _is_read(given) and f'"{CHECK} ' not in plain else plain
    translation = translator.translate(chosen, reading, ask)
    english = told_back(translation.english, said.speech.reasons)
    return replace(translation, instruction=text, english=english)


def _is_read(instruction: str) -> bool:
    """Return True if the grammar understands an instruction."""
    try:
        return bool(readings(instruction))
    except TranslationError:
        return False


def _placed(error: TranslationError, instruction: str) -> TranslationError:
    """Return the error with the position of its part in the instruction as it was given."""
    at = instruction.find(error.part) + 1 if error.part else 0
    if not at or at == error.position:
        return error
    message = str(error).replace(f"character {error.position}:", f"character {at}:", 1)
    return type(error)(message, error.part, at)


def located(translation: Translation, site: Site) -> Translation:
    """Return a translation in which propositions with the name of a place mean that place."""
    found: dict[str, SE2 | None] = {}
    for letter in ltl.propositions(translation.formula):
        place = site.place(letter)
        if place is not None or letter in (START, HERE, EXPLORED):
            found[letter] = None if place is None else place.pose
    return replace(translation, places=found)


def spec_of(config: MissionConfig, translation: Translation) -> MissionSpec:
    """Compile and check a translated formula for the configured planner; see `prepare`."""
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
        raise MissionError(f"mission: a contradiction, {what}: {parts}; remove or change a part")
    if automaton.steps_left[0] == 0:
        always = ", whatever is reached" if diagnosis.tautology else ""
        raise MissionError(
            f"mission: fulfilled by doing nothing{always}; name something to reach: "
            f"{one_line(formula)} ({one_line(translation.english)})"
        )
    targets = tuple(letter for letter in letters if letter not in diagnosis.unused)
    automaton = _narrowed(automaton, targets)
    # Check now that the planner accepts the mission.
    make_planner(config.planner, automaton, translation.instruction)
    things = tuple(letter for letter in targets if letter not in translation.places)
    return MissionSpec(translation, automaton, diagnosis, targets, things or (config.target,))


def spec_of_task(
    config: MissionConfig,
    translation: Translation,
    targets: tuple[str, ...],
    steps: tuple[TaskStep, ...],
) -> MissionSpec:
    """Return the `MissionSpec` of a task, whose automaton counts completed steps.

    No formula describes a task: its goal is the end of a trajectory.

    Args:
        config: the `mission` section.
        translation: the instruction as it was understood.
        targets: names for the detector, at least one.
        steps: steps of the task, at least one.

    Raises:
        MissionError: more targets than `mission.max_targets`.
    """
    _check_number(config, len(targets))
    states = np.arange(len(steps) + 1, dtype=np.int32)
    delta = np.repeat(states[:, None], len(targets) + 1, axis=1)
    delta[:-1, -1] += 1
    chain = Automaton(ltl.TRUE, targets, delta, states == len(steps), np.zeros_like(states))
    return MissionSpec(translation, chain, Diagnosis((), True, ()), targets, targets, steps)


def task_state(brief: MissionSpec) -> dict[str, Any] | None:
    """Return the arguments of `spec_of_task` that the translation lacks, or None for a mission."""
    if brief.steps is None:
        return None
    return {"targets": brief.targets, "steps": [asdict(step) for step in brief.steps]}


def restore_spec(
    config: MissionConfig, translation: Translation, task: dict[str, Any] | None
) -> MissionSpec:
    """Return the mission or task again from its translation and the result of `task_state`."""
    if task is None:
        return spec_of(config, translation)
    steps = tuple(TaskStep(s["said"], tuple(s["names"]), s["joined"]) for s in task["steps"])
    return spec_of_task(config, translation, tuple(task["targets"]), steps)


def _check_number(config: MissionConfig, targets: int) -> None:
    if targets > config.max_targets:
        raise MissionError(
            f"mission: {targets} targets, at most {config.max_targets} are allowed "
            "(mission.max_targets)"
        )


def _narrowed(automaton: Automaton, letters: tuple[str, ...]) -> Automaton:
    """Remove propositions that make no difference, so that the planner never searches for them."""
    if letters == automaton.letters:
        return automaton
    columns = [automaton.letters.index(letter) for letter in letters]
    delta = np.ascontiguousarray(automaton.delta[:, [*columns, len(automaton.letters)]])
    return replace(automaton, letters=letters, delta=delta)


def _unified(formula: Formula, places: Collection[str]) -> Formula:
    """Return the formula with one name for each object: the first one of its synonyms.

    A place keeps its name: what a person calls a place is no synonym of a thing.
    """
    first: dict[str, str] = {}

    def key(name: str) -> str:
        return f"place {name}" if name in places else names.canonical(name)

    for name in ltl.propositions(formula):
        first.setdefault(key(name), name)
    return ltl.renamed(formula, lambda name: first[key(name)])
