"""Preparation of a mission: from an instruction or formula to a `MissionSpec`, or an error."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from edge import names
from edge.config import MissionConfig, TranslatorLtl
from edge.geometry import SE2
from edge.memory import Site, parse_description
from edge.mission.destinations import (
    CheckTarget,
    Destination,
    EveryObjectTarget,
    EveryRoomTarget,
    PlaceTarget,
    RoomTarget,
    with_caller,
)
from edge.mission.instructions import (
    NO_SITE,
    MissionError,
    translate,
    with_destinations,
    with_failures,
)
from edge.mission.language.grammar.english import describe
from edge.mission.language.words.tokens import unclear
from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.diagnosis import Diagnosis, diagnose
from edge.mission.logic.goal_sequence import split_bans
from edge.mission.logic.ltl import Formula
from edge.mission.planning.planner import make_planner
from edge.mission.repetition import Repetition, recurrence
from edge.mission.task_step import TaskStep
from edge.mission.translate import Translation, TranslationError, make_translator
from edge.text import one_line

_MOST_SHOWN = 600  # characters of the parts of a contradiction


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
        prompts: the names of the targets that are objects, with the anchors of relations ("desk" of
            "chair next to desk"), or else the target of the configuration. The detector searches
            for them, and each has its own vision-language scores.
        steps: steps of a task (`edge.tasks`), at least one; None if this is no task.
        labels: the label that detections of each target have; for a place or room, its own name.
    """

    translation: Translation
    automaton: Automaton
    diagnosis: Diagnosis
    targets: tuple[str, ...]
    prompts: tuple[str, ...]
    steps: tuple[TaskStep, ...] | None = None
    labels: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", {name: self._label_of(name) for name in self.targets})

    def prompt_for(self, target: str) -> str:
        """Return the prompt to search for while this target is pursued."""
        label = self.labels[target]
        return label if label in self.prompts else self.prompts[0]

    def _label_of(self, target: str) -> str:
        wanted = self.object_name(target)
        if wanted not in self.prompts and (described := parse_description(wanted)) is not None:
            wanted = described.noun
        key = names.canonical(wanted)
        same = (prompt for prompt in self.prompts if names.canonical(prompt) == key)
        return wanted if wanted in self.prompts else next(same, target)

    def object_name(self, target: str) -> str:
        """Return the name or description of one object that a target means; or the target."""
        destination = self.translation.destinations.get(target)
        is_named = isinstance(destination, (CheckTarget, EveryObjectTarget))
        return destination.name if is_named else target

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the operator before the robot drives."""
        unused = one_line(", ".join(self.diagnosis.unused))
        lines = [f"does not affect the mission: {unused}"] if unused else []
        if self.translation.warning:
            lines.append(self.translation.warning)
        if self.translation.implied:
            ways = len(self.translation.readings)
            lines.append(
                f"the instruction has {ways} readings and no person chose one, so reading "
                f"{self.translation.reading} was taken: it fulfils all of them"
            )
        return tuple(lines)


def prepare(
    config: MissionConfig,
    instruction: str | None = None,
    formula: str | None = None,
    reading: int | None = None,
    site: Site = NO_SITE,
    caller: SE2 | None = None,
    repeat: Repetition | None = None,
) -> MissionSpec:
    """Translate, compile and check a mission; this can take as long as the translator does.

    Args:
        config: the `mission` section.
        instruction: text for the configured translator. Its sender can choose a reading. For the
            configuration's own instruction the safer reading is taken, as no person may be there
            to choose (see `Translator.translate`).
        formula: linear temporal logic, instead of an instruction. With neither, the instruction
            or the target of the configuration is used.
        reading: the chosen reading of the given instruction, counted from 1. For the
            configuration's own instruction, `config.reading` applies.
        site: a place of the site is a target that needs no search.
        caller: pose of the person who calls the robot, the place `caller`; None if it is not known.
        repeat: the end of a mission that repeats; None: as the instruction or formula says.

    Raises:
        AmbiguousInstructionError: the instruction has several readings, and none was chosen.
        UserError: the instruction was not understood, or the formula cannot be used: it is
            malformed, too large (also for the configured planner), a contradiction (the error
            names the parts in conflict), or asks for nothing.

    Example:
        >>> spec = prepare(MissionConfig(), "Go to the bed, then to the sofa.")
        >>> str(spec.automaton.formula), spec.targets
        ('F (bed & F sofa)', ('bed', 'sofa'))
    """
    site = with_caller(site, caller)
    if formula is not None:
        translation = with_failures(make_translator(TranslatorLtl()).translate(formula))
    elif instruction is not None or config.instruction is not None:
        ask = instruction is not None
        text = instruction if instruction is not None else config.instruction or ""
        reading = reading if ask else config.reading
        try:
            translation = translate(config, text, site, reading, ask)
            _refuse_other_of_kind(translation.formula)
        except TranslationError as error:
            raise _with_position(error, text) from None
        repeat = repeat or translation.repeat
    else:
        reach = ltl.eventually(ltl.ap(config.target))
        translation = Translation(config.target, reach, describe(reach), "target")
    return spec_of(config, with_destinations(with_repetition(translation, repeat), site))


def _refuse_other_of_kind(formula: Formula) -> None:
    """Refuse one object of a kind of which a number is asked for: "two dogs, but avoid the dog"."""
    targets = [(name, parse_description(name)) for name in ltl.propositions(formula)]
    counted = {found.noun for _, found in targets if found is not None and found.is_new}
    for name, described in targets:
        noun = name if described is None else described.noun
        if (described is None or not described.is_new) and names.same_as_any(noun, counted):
            raise unclear(noun, "unclear if it is one of those that you counted; leave it out")


def _with_position(error: TranslationError, instruction: str) -> TranslationError:
    """Return the error with the position of its part in the instruction as it was given."""
    at = instruction.find(error.part) + 1 if error.part else 0
    if not at or at == error.position:
        return error
    message = str(error).replace(f"character {error.position}:", f"character {at}:", 1)
    return type(error)(message, error.part, at)


def with_repetition(translation: Translation, repeat: Repetition | None) -> Translation:
    """Return a translation to one round of a mission that repeats, if it does.

    Args:
        translation: the entire mission, or one round.
        repeat: the end of the repetition; None: the mission repeats if its formula says so.
    """
    formula, recurs = recurrence(translation.formula, repeat is not None)
    if recurs:
        repeat = repeat or Repetition()
        translation = replace(translation, formula=formula, english=describe(formula))
    if repeat is None:
        return translation
    return replace(
        translation, repeat=repeat, english=f"{translation.english} Repeat this {repeat}."
    )


def spec_of(config: MissionConfig, translation: Translation) -> MissionSpec:
    """Compile and check a translated formula for the configured planner; see `prepare`."""
    formula = _with_one_name(translation.formula, translation.destinations)
    translation = replace(translation, formula=formula)
    propositions = ltl.propositions(formula)
    _check_number(config, len(propositions))
    automaton = compile_formula(formula, compiler=config.compiler)
    diagnosis = diagnose(automaton)
    if diagnosis.contradiction:
        shown = ((one_line(part), one_line(describe(part))) for part in diagnosis.contradiction)
        parts = one_line("; ".join(f"{part} ({english})" for part, english in shown), _MOST_SHOWN)
        several = len(diagnosis.contradiction) > 1
        what = "these parts conflict" if several else "this part cannot be done"
        raise MissionError(f"mission: a contradiction, {what}: {parts}; remove or change a part")
    if automaton.steps_left[0] == 0:
        always = ", whatever is reached" if diagnosis.tautology else ""
        hint = "name something to reach"
        if not always and not split_bans(formula)[0]:
            hint += (
                ", as in 'go to the kitchen, but avoid the sofa'; only a room can be forbidden for "
                "good, as in 'stay out of the bedroom'"
            )
        raise MissionError(
            f"mission: {one_line(formula)} ({one_line(translation.english)}) is fulfilled by doing "
            f"nothing{always}; {hint}"
        )
    targets = tuple(name for name in propositions if name not in diagnosis.unused)
    automaton = _without_unused(automaton, targets)
    # Check now that the planner accepts the mission.
    make_planner(config.planner, automaton, translation.instruction)
    # One step is enough, or only one target may be reached. A tour has several stops.
    alone = automaton.steps_left[0] < 2 or len(automaton.possible) < 2
    destinations = translation.destinations
    tours = (EveryRoomTarget, EveryObjectTarget)
    has_tour = any(isinstance(destinations.get(name), tours) for name in targets)
    if translation.repeat is not None and alone and not has_tour:
        raise MissionError(
            f"mission: {one_line(formula)} cannot be repeated: name at least two objects or places "
            "to reach in each round"
        )
    _refuse_bans(automaton, destinations)
    prompts = _prompts(targets, destinations)
    return MissionSpec(translation, automaton, diagnosis, targets, prompts or (config.target,))


def _prompts(targets: Iterable[str], destinations: Mapping[str, Destination]) -> tuple[str, ...]:
    """Return the names that the detector must look for, each once; an anchor follows its noun."""
    found: dict[str, str] = {}
    for target in targets:
        destination = destinations.get(target)
        by_object = isinstance(destination, RoomTarget) and destination.which == "with"
        is_named = isinstance(destination, (CheckTarget, EveryObjectTarget))
        if destination is None or is_named or by_object:
            wanted = target if destination is None else destination.name
            relation = parse_description(wanted)
            for name in (wanted,) if relation is None else relation.prompts:
                found.setdefault(names.canonical(name), name)
    return tuple(found.values())


def _refuse_bans(automaton: Automaton, destinations: Mapping[str, Destination]) -> None:
    """Raise a MissionError if the mission only forbids something that cannot be forbidden."""
    for name in set(automaton.propositions).difference(automaton.possible):
        destination = destinations.get(name)
        chosen = isinstance(destination, RoomTarget) and destination.which != "called"
        if chosen or not isinstance(destination, (PlaceTarget, RoomTarget, type(None))):
            raise MissionError(
                f"mission: {one_line(name, 60)}: the robot can do this, but it cannot be "
                "forbidden; leave it out"
            )


def spec_of_task(
    config: MissionConfig,
    translation: Translation,
    targets: tuple[str, ...],
    steps: tuple[TaskStep, ...],
) -> MissionSpec:
    """Return the `MissionSpec` of a task, whose automaton counts completed steps.

    No formula describes a task: its goal is the end of a trajectory.

    Raises:
        MissionError: more targets than `mission.max_targets`.
    """
    _check_number(config, len(targets))
    states = np.arange(len(steps) + 1, dtype=np.int32)
    delta = np.repeat(states[:, None], len(targets) + 1, axis=1)
    delta[:-1, -1] += 1
    # Only NOTHING, the last column, moves the state, and the last state has no successor.
    chain = Automaton(ltl.TRUE, targets, delta, states == len(steps), np.zeros_like(states))
    return MissionSpec(translation, chain, Diagnosis((), True, ()), targets, targets, steps)


def task_state(spec: MissionSpec) -> dict[str, Any] | None:
    """Return the arguments of `spec_of_task` that the translation lacks, or None for a mission."""
    if spec.steps is None:
        return None
    return {"targets": spec.targets, "steps": [asdict(step) for step in spec.steps]}


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
            f"mission: {targets} targets, at most {config.max_targets} are allowed; name fewer, or "
            "raise mission.max_targets"
        )


def _without_unused(automaton: Automaton, used: tuple[str, ...]) -> Automaton:
    """Remove propositions that make no difference, so that the planner never searches for them."""
    if used == automaton.propositions:
        return automaton
    columns = [automaton.propositions.index(name) for name in used]
    delta = np.ascontiguousarray(automaton.delta[:, [*columns, len(automaton.propositions)]])
    return replace(automaton, propositions=used, delta=delta)


def _with_one_name(formula: Formula, destinations: Collection[str]) -> Formula:
    """Return the formula with one name for each object: the first one of its synonyms.

    A destination keeps its name: what a person calls a place is no synonym of an object.
    """
    first: dict[str, str] = {}

    def key(name: str) -> str:
        return f"destination {name}" if name in destinations else names.canonical(name)

    for name in ltl.propositions(formula):
        first.setdefault(key(name), name)
    return ltl.renamed(formula, lambda name: first[key(name)])
