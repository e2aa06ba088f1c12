"""Translation of an instruction, with the destinations that it names.

The translators of `edge.mission.translate` read plain orders. Here the everyday words of an
instruction become plain orders, and conditions such as "if it is not there" become branches.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from edge.config import MissionConfig, TranslatorLtl
from edge.errors import UserError
from edge.memory import Site, is_room_name, parse_description
from edge.mission.destinations import (
    Destination,
    PlaceTarget,
    describe_destination,
    destination_of,
    failure_of,
)
from edge.mission.fallbacks import FallbackTranslator
from edge.mission.language.errands.errand_patterns import CHECK, WAIT
from edge.mission.language.errands.impossible import asks_for_work, says_manner
from edge.mission.language.errands.outcomes import Branches, split_outcomes
from edge.mission.language.errands.periods import Period, split_period
from edge.mission.language.errands.spell_out import spell_out
from edge.mission.language.grammar.english import describe
from edge.mission.language.grammar.instruction import readings
from edge.mission.language.intents import (
    Control,
    MemoryQuestion,
    MissionOrder,
    NoMissionError,
    understand,
)
from edge.mission.language.tidy import TidySpeech, tidy_up
from edge.mission.language.words.everyday_words import is_room
from edge.mission.language.words.nouns import split_entries
from edge.mission.language.words.places import (
    EVERY,
    EXPLORED,
    NO,
    mark_places,
    quote_places,
    restore_places,
)
from edge.mission.language.words.spans import shown_s
from edge.mission.language.words.tokens import UnclearError, unclear
from edge.mission.logic import ltl
from edge.mission.logic.goal_sequence import NotASequenceError, split_bans, then
from edge.mission.logic.ltl import Formula
from edge.mission.read_back import orders_of
from edge.mission.repetition import Repetition, split_repetition
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

NO_SITE = Site()
"""A site without names."""
# Spelled-out text that means more than the words as they were given.
_MEANS_MORE = re.compile(rf'"(?:{CHECK}|{EXPLORED}|{EVERY})\b|, then ')
_DAY = re.compile(r"\b(?:today|tonight|this (?:morning|noon|afternoon|evening|night))\b", re.I)
_NEAREST = re.compile(r"\b(?:nearest|closest)\b", re.I)
# Words in names that a remark may share with a target by chance.
_SMALL_WORDS = split_entries("the next near room and for from here there with wait")


class MissionError(UserError):
    """A mission that is refused before it starts; the message has one line."""


def translate(
    config: MissionConfig,
    text: str,
    site: Site = NO_SITE,
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
    if isinstance(config.translator, TranslatorLtl):
        quoted, repeat = split_repetition(quote_places(text, _place_names(site)))
        translation = make_translator(config.translator).translate(quoted, reading, ask)
        return replace(with_failures(translation), instruction=text, repeat=repeat)
    speech = tidy_up(text)
    marked, places = mark_places(speech.text, _place_names(site))
    if (period := split_period(marked)) is not None:
        try:
            order = speech.with_quotations(restore_places(period.order, places))
            return _with_period(translate(config, order, site, reading, ask), period, speech, text)
        except NoMissionError:
            raise unclear(text, "only an order to drive can be repeated after a time") from None
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


def _with_period(order: Translation, period: Period, speech: TidySpeech, text: str) -> Translation:
    """Return an order that is repeated, with a wait at one end of each round.

    A wait until a time of day is at the begin.
    """
    if order.repeat not in (None, Repetition()):
        hint = (
            "leave out the number or time of rounds"
            if period.until
            else ("say only the time between rounds")
        )
        raise unclear(text, f"unclear what is repeated how often; {hint}")
    if _timed_waits(order.formula) and not period.until:
        raise unclear(
            text, "unclear how often; say a time of day or a time between rounds, not both"
        )
    goals, bans = split_bans(order.formula)
    end = f"until {period.until}" if period.until else shown_s(period.wait_s)
    wait = ltl.eventually(ltl.ap(f"{WAIT} {end}"))
    try:
        round_of_goals = then(*goals, wait)  # also checks that it is a sequence
        if period.until:
            round_of_goals = then(wait, *goals)
    except NotASequenceError:
        raise unclear(text, "expected orders in a sequence, to repeat them") from None
    assert round_of_goals is not None  # it has the wait
    formula = ltl.conj(round_of_goals, *bans)
    notes = order.english.removeprefix(describe(order.formula)) + _note(speech.reasons, formula)
    return replace(
        order, instruction=text, formula=formula, english=describe(formula) + notes,
        repeat=Repetition(limit_s=period.limit_s),
    )  # fmt: skip


def _translate_plain(
    config: MissionConfig, text: str, site: Site, reading: int | None = None, ask: bool = True
) -> Translation:
    """Translate an order without looking for fallbacks in it; see `translate`."""
    translator, places = make_translator(config.translator), _place_names(site)
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
    goals, bans = split_bans(translation.formula)
    timed_waits = _timed_waits(translation.formula)
    if len(goals) + len(bans) > 1 and not timed_waits.isdisjoint(goals):
        raise unclear(text, "a time of day must begin a sequence of orders to go somewhere")
    english = translation.english + _note(order.speech.reasons, translation.formula)
    if timed_waits and _DAY.search(text):
        english += " (A time is the next one, today or tomorrow.)"
    if asks_for_work(order.speech.text):
        english += " (The robot has no arms: it only drives there.)"
    if says_manner(text):
        english += " (How it drives is set in the motion controller.)"
    if _NEAREST.search(text) and not _NEAREST.search(str(translation.formula)):
        english += " (One that it knows, else the first that it finds.)"
    return replace(translation, instruction=text, english=english, repeat=repeat)


def _timed_waits(formula: Formula) -> set[Formula]:
    """Return `F "wait until 09:00"` for each wait until a time of day in a formula."""
    names = (name for name in ltl.propositions(formula) if name.startswith(f"{WAIT} until "))
    return {ltl.eventually(ltl.ap(name)) for name in names}


def _place_names(site: Site) -> list[str]:
    return [place.name for place in site.places] + [room.name for room in site.room_names]


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
            with_destinations(with_failures(Translation("", r.formula, r.english, "")), site)
            for r in error.readings
        ]
        offered = tuple(Reading(one.formula, one.english) for one in shown)
        raise AmbiguousInstructionError(offered, error.implied) from None
    notes = "".join(part.english.removeprefix(describe(part.formula)) for part in parts)
    english = translation.english + notes + _note(speech.reasons, translation.formula)
    return with_failures(replace(translation, english=english))


def with_failures(translation: Translation) -> Translation:
    """Return a translation in which "no mug" is the failure of the target "mug"."""
    targets = ltl.propositions(translation.formula)
    failures = {name: failure_of(name, targets) for name in targets}
    return replace(
        translation, destinations={name: one for name, one in failures.items() if one is not None}
    )


def _note(reasons: Sequence[str], formula: Formula) -> str:
    """Return a note about the clauses that give no order.

    Raises:
        UnclearError: such a clause may say more about a target.
    """
    for reason in reasons:
        if shared := _shared_word(reason, formula):
            hint = f"unclear if this says more about {shared!r}"
            raise unclear(reason, f"{hint}; leave it out, or say it as an order")
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
