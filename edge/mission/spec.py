"""Preparation of a mission: from an instruction or formula to a `MissionSpec`, or an error."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from edge import names
from edge.config import MissionConfig, TranslatorLtl
from edge.errors import UserError
from edge.geometry import SE2
from edge.memory import Site, is_room_name, parse_description
from edge.mission.destinations import (
    CheckTarget,
    Destination,
    EveryRoomTarget,
    ExploreTarget,
    FailureTarget,
    PlaceTarget,
    RoomTarget,
    WaitTarget,
    describe_destination,
    destination_of,
    failure_of,
    with_caller,
)
from edge.mission.fallbacks import FallbackTranslator
from edge.mission.language.english import describe
from edge.mission.language.errand_patterns import CHECK
from edge.mission.language.errands import spell_out
from edge.mission.language.everyday_words import is_room
from edge.mission.language.fallbacks import Branches, split_outcomes
from edge.mission.language.grammar import readings
from edge.mission.language.impossible import asks_for_work
from edge.mission.language.intents import (
    Control,
    MemoryQuestion,
    MissionOrder,
    NoMissionError,
    understand,
)
from edge.mission.language.nouns import split_entries
from edge.mission.language.places import EVERY, EXPLORED, NO, quote_places
from edge.mission.language.tidy import TidySpeech, tidy_up
from edge.mission.language.tokens import UnclearError, unclear
from edge.mission.logic import ltl
from edge.mission.logic.automaton import Automaton, compile_formula
from edge.mission.logic.diagnosis import Diagnosis, diagnose
from edge.mission.logic.ltl import Formula
from edge.mission.planning.planner import make_planner
from edge.mission.read_back import orders_of
from edge.mission.repetition import Repetition, recurrence, split_repetition
from edge.mission.task_step import TaskStep
from edge.mission.translate import (
    AmbiguousInstructionError,
    ParsedInstruction,
    Reading,
    Translation,
    TranslationError,
    Translator,
    make_translator,
)
from edge.text import one_line

_NO_SITE = Site()
# Spelled-out text that means more than the words as they were given.
_MEANS_MORE = re.compile(rf'"(?:{CHECK}|{EXPLORED}|{EVERY})\b|, then ')
_NEAREST = re.compile(r"\b(?:nearest|closest)\b", re.I)
_MOST_SHOWN = 600  # characters of the parts of a contradiction


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
        prompts: the names of the targets that are objects, with the anchors of relations ("desk" of
            "chair next to desk"), or else the target of the configuration. The detector searches
            for them, and each has its own vision-language scores.
        steps: steps of a task (`edge.tasks`), at least one; None if this is no task.
    """

    translation: Translation
    automaton: Automaton
    diagnosis: Diagnosis
    targets: tuple[str, ...]
    prompts: tuple[str, ...]
    steps: tuple[TaskStep, ...] | None = None

    def prompt_for(self, target: str) -> str:
        """Return the prompt to search for while this target is pursued."""
        destination = self.translation.destinations.get(target)
        wanted = destination.name if isinstance(destination, CheckTarget) else target
        if wanted not in self.prompts and (described := parse_description(wanted)) is not None:
            wanted = described.noun
        if wanted in self.prompts:
            return wanted
        key = names.canonical(wanted)
        same = (prompt for prompt in self.prompts if names.canonical(prompt) == key)
        return next(same, self.prompts[0])

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


_SMALL_WORDS = frozenset(split_entries("the next near room and for from here there with wait"))
"""Words in names that a remark may share with a target by chance."""


def prepare(
    config: MissionConfig,
    instruction: str | None = None,
    formula: str | None = None,
    reading: int | None = None,
    site: Site = _NO_SITE,
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
        translation = _with_failures(make_translator(TranslatorLtl()).translate(formula))
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


def translate(
    config: MissionConfig,
    text: str,
    site: Site = _NO_SITE,
    reading: int | None = None,
    ask: bool = True,
) -> Translation:
    """Spell out the everyday words of an instruction and translate it; for arguments see `prepare`.

    `ask` is True if the sender can choose a reading.

    Raises:
        NoMissionError: it is a question, an order to learn, or about the present mission.
        TranslationError: it is not understood.

    Example:
        >>> translation = translate(MissionConfig(), "Please go to the bed and the sofa.")
        >>> str(translation.formula)
        'F bed & F sofa'
    """
    places = [place.name for place in site.places] + [room.name for room in site.room_names]
    translator = make_translator(config.translator)
    if isinstance(config.translator, TranslatorLtl):
        quoted, repeat = split_repetition(quote_places(text, places))
        translation = _with_failures(translator.translate(quoted, reading, ask))
        return replace(translation, repeat=repeat)
    speech = tidy_up(text)
    if (branches := split_outcomes(speech.text)) is not None:
        try:
            return _translate_branches(config, branches, speech, site, reading, ask, text)
        except UnclearError as error:
            if not branches.is_rule:
                raise
            try:
                return _translate_plain(config, text, site, reading, ask)
            except TranslationError:
                raise error from None
    return _translate_plain(config, text, site, reading, ask)


def _translate_plain(
    config: MissionConfig, text: str, site: Site, reading: int | None = None, ask: bool = True
) -> Translation:
    """Translate an order without looking for fallbacks in it; see `translate`."""
    places = [place.name for place in site.places] + [room.name for room in site.room_names]
    translator = make_translator(config.translator)
    order = understand(text, [item.name for item in site.items])
    if not isinstance(order, MissionOrder):
        raise NoMissionError(order)
    plain = order.speech.with_quotations(spell_out(order.speech.text, places))
    given = quote_places(text, places)
    # What the grammar reads in the person's own words needs no spelling out, unless it would lose
    # something: a check is no visit, and people mean an order when they say "go there and find".
    means_more = order.speech.repaired or _MEANS_MORE.search(plain)
    chosen = given if not means_more and _is_understood(given) else plain
    chosen, repeat = split_repetition(chosen)
    translation = translator.translate(chosen, reading, ask)
    short = {name for name in ltl.propositions(translation.formula) if len(name) == 1}
    if short == {"a"} and '"a"' not in text:  # "find a" has lost its noun
        hint = "the name of the object is missing after 'a'; say for example 'find a mug'"
        raise UnclearError(f"instruction: {hint}")
    english = translation.english + _note(order.speech.reasons, translation.formula)
    if asks_for_work(order.speech.text):
        english += " (The robot has no arms: it only drives there.)"
    if _NEAREST.search(text) and not _NEAREST.search(str(translation.formula)):
        english += " (One that it knows, else the first that it finds.)"
    return replace(translation, instruction=text, english=english, repeat=repeat)


def _translate_branches(
    config: MissionConfig,
    branches: Branches,
    speech: TidySpeech,
    site: Site,
    reading: int | None,
    ask: bool,
    instruction: str,
) -> Translation:
    """Translate an order whose parts depend on the outcome of others; see `translate`."""
    parts: list[Translation] = []

    def translate_part(part: str) -> Formula:
        part = speech.with_quotations(part)
        try:
            parts.append(translate(config, part, site))
        except (AmbiguousInstructionError, NoMissionError) as error:
            intent = error.intent if isinstance(error, NoMissionError) else None
            waits_for = re.search(r"\buntil (?!I |we )", part, re.I)  # "wait until it is there"
            if isinstance(intent, Control) and intent.do == "pause" and not waits_for:
                return ltl.eventually(
                    ltl.ap(f"wait {intent.seconds:g} s" if intent.seconds else "wait")
                )
            if isinstance(intent, MemoryQuestion) and intent.topic == "exists":
                return translate_part(f"check if there is {intent.object_phrase}")
            hint = "with a condition, expected an order that has one meaning"
            raise unclear(part, hint) from error
        if parts[-1].repeat is not None:
            raise unclear(part, "what repeats cannot have a condition")
        return parts[-1].formula

    def is_object(name: str) -> bool:
        described = parse_description(name)
        noun = name if described is None else described.noun
        return destination_of(name, site) is None and not is_room(noun)

    formulas = FallbackTranslator(translate_part, is_object).readings(branches)
    if branches.may_drive:
        with suppress(UserError):
            formulas.append(_translate_plain(config, instruction, site).formula)
    if any(name.startswith(NO) for part in parts for name in ltl.propositions(part.formula)):
        raise UnclearError("instruction: with a condition, no name may begin with 'no'")
    read = ParsedInstruction(formulas, parts[0].backend)
    try:
        translation = Translator("fallbacks", lambda _: read).translate(instruction, reading, ask)
    except AmbiguousInstructionError as error:
        shown = [
            with_destinations(_with_failures(Translation("", r.formula, r.english, "")), site)
            for r in error.readings
        ]
        offered = tuple(Reading(one.formula, one.english) for one in shown)
        raise AmbiguousInstructionError(offered, error.implied) from None
    notes = "".join(part.english.removeprefix(describe(part.formula)) for part in parts)
    english = translation.english + notes + _note(speech.reasons, translation.formula)
    return _with_failures(replace(translation, english=english))


def _with_failures(translation: Translation) -> Translation:
    """Return a translation in which "no mug" is the failure of the target "mug"."""
    targets = ltl.propositions(translation.formula)
    failures = {name: failure_of(name, targets) for name in targets}
    return replace(
        translation, destinations={name: one for name, one in failures.items() if one is not None}
    )


def _refuse_other_of_kind(formula: Formula) -> None:
    """Refuse one object of a kind of which a number is asked for: "two dogs, but avoid the dog"."""
    targets = [(name, parse_description(name)) for name in ltl.propositions(formula)]
    counted = {found.noun for _, found in targets if found is not None and found.is_new}
    for name, described in targets:
        noun = name if described is None else described.noun
        if (described is None or not described.is_new) and names.same_as_any(noun, counted):
            raise unclear(noun, "unclear if it is one of those that you counted; leave it out")


def _note(reasons: Sequence[str], formula: Formula) -> str:
    """Return a note about the clauses that give no order.

    Raises:
        UnclearError: such a clause may say more about a target.
    """
    for reason in reasons:
        if shared := _shared_word(reason, formula):
            hint = (
                f"unclear if this says more about {shared!r}; leave it out, or say it as an order"
            )
            raise unclear(reason, hint)
    unused = "; ".join(f"'{one_line(reason)}'" for reason in reasons)
    return f" (Not part of the order: {unused}.)" if unused else ""


def _shared_word(remark: str, formula: Formula) -> str:
    """Return a word that a remark shares with a target or a ban; "" if there is none."""
    targets = " ".join(ltl.propositions(formula)).lower()
    spoken = set(re.findall(r"[a-z]{3,}", remark.lower())) - _SMALL_WORDS
    return next((word for word in re.findall(r"[a-z]{3,}", targets) if word in spoken), "")


def _is_understood(instruction: str) -> bool:
    """Return True if the grammar understands an instruction."""
    try:
        return bool(readings(instruction))
    except TranslationError:
        return False


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


def with_destinations(translation: Translation, site: Site) -> Translation:
    """Return a translation with the destinations that its propositions name, also in its English.

    Raises:
        DestinationError: see `destination_of`.
        RelationError: see `parse_description`.
        MissionError: a zone closes a place, or an object is in a room that has no such name.
    """
    found: dict[str, Destination] = {}
    english = translation.english
    for name in ltl.propositions(translation.formula):
        destination = translation.destinations.get(name) or destination_of(name, site)
        if destination is not None:
            _refuse_closed(name, destination, site)
            found[name] = destination
            english = english.replace(f'"{name}"', describe_destination(name, destination))
        else:
            _refuse_unknown_room(name, site)
    formula_english = describe(translation.formula)
    orders = orders_of(translation.formula, found)
    if found and orders and translation.english.startswith(formula_english):
        english = orders + translation.english[len(formula_english) :]
    return replace(translation, destinations=found, english=english)


def _refuse_unknown_room(name: str, site: Site) -> None:
    """Refuse an object in a room whose name is no kind of room, and which no person gave."""
    room = described.room if (described := parse_description(name)) is not None else ""
    if room and not is_room_name(room) and site.room_name(room) is None:
        raise MissionError(
            f"mission: {one_line(name, 80)}: no room or object is called {one_line(room, 60)!r}; "
            "leave it out, or give a room this name first"
        )


def _refuse_closed(name: str, destination: Destination, site: Site) -> None:
    """Refuse a place that a zone closes, to which no path can lead."""
    if isinstance(destination, PlaceTarget) and (pose := destination.pose) is not None:
        zone = site.closed_by(pose.x_m, pose.y_m)
        if zone:
            raise MissionError(
                f"mission: {one_line(name)} is closed by the zone {one_line(zone)!r}; remove the "
                "zone or name another place"
            )


def spec_of(config: MissionConfig, translation: Translation) -> MissionSpec:
    """Compile and check a translated formula for the configured planner; see `prepare`."""
    formula = _with_one_name(translation.formula, translation.destinations)
    translation = replace(translation, formula=formula)
    names = ltl.propositions(formula)
    _check_number(config, len(names))
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
        raise MissionError(
            f"mission: {one_line(formula)} ({one_line(translation.english)}) is fulfilled by doing "
            f"nothing{always}; name something to reach"
        )
    targets = tuple(name for name in names if name not in diagnosis.unused)
    automaton = _without_unused(automaton, targets)
    # Check now that the planner accepts the mission.
    make_planner(config.planner, automaton, translation.instruction)
    # One step is enough, or only one target may be reached. A tour has several stops.
    alone = automaton.steps_left[0] < 2 or len(automaton.possible) < 2
    destinations = translation.destinations
    has_tour = any(isinstance(destinations.get(name), EveryRoomTarget) for name in targets)
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
        if destination is None or isinstance(destination, CheckTarget) or by_object:
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
        if chosen or isinstance(
            destination,
            (CheckTarget, EveryRoomTarget, ExploreTarget, FailureTarget, WaitTarget),
        ):
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
