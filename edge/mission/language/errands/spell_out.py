"""Rewriting of everyday errands into plain orders with quoted propositions.

Checks, explorations, patrols, waits and objects with a relation become `go to "check stove"`,
`go to "explored kitchen"`, `go to "wait 30 s"`, `find "mug in the kitchen"`. Each quoted
proposition is the canonical text of a destination (see `edge.mission.destinations`). `spell_out`
applies the rules in a fixed order; the translators read its result.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache

from edge import names
from edge.mission.language.errands import errand_patterns as patterns
from edge.mission.language.errands.errand_parts import PARTS
from edge.mission.language.errands.errand_patterns import CALLER, CHECK, MAX_COUNT, WAIT
from edge.mission.language.errands.impossible import (
    refuse_impossible,
    refuse_unseen,
    without_manner,
)
from edge.mission.language.errands.object_names import (
    is_name,
    modifies,
    quote_compound,
    quote_related,
    refuse_unknown_names,
    relation_text,
    searched_text,
    with_article,
)
from edge.mission.language.errands.timed_orders import put_times_first
from edge.mission.language.errands.tours import (
    refuse_other_tours,
    rewrite_all_but,
    rewrite_errand_and_back,
    rewrite_every_room,
    rewrite_every_room_too,
    rewrite_exploration,
    rewrite_exploration_here,
    rewrite_list_in_turn,
    rewrite_patrol,
)
from edge.mission.language.words import nouns
from edge.mission.language.words.clock_times import time_of_day
from edge.mission.language.words.everyday_words import (
    ARTICLE,
    NOWHERE,
    bare,
    each_kind,
    is_room,
    is_vague,
    phrase_of,
    refuse_each,
)
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.places import (
    EVERY,
    HERE,
    START,
    is_marked,
    mark_places,
    restore_places,
)
from edge.mission.language.words.rewriting import Change, Pattern, go_to, rewrite_outside_quotes
from edge.mission.language.words.spans import number_of, seconds_of, shown_s
from edge.mission.language.words.templates import STOP, compile_templates
from edge.mission.language.words.tokens import unclear


def spell_out(text: str, places: Iterable[str] = ()) -> str:
    """Return an errand in plain words with its destinations as quoted propositions.

    Raises:
        UnclearError: a part is unclear, or the robot cannot do it with wheels, a camera and text.

    Example:
        >>> spell_out("go and check whether the kettle is in the kitchen, then come back")
        'go to "check kettle in the kitchen", then go to "here"'
    """
    if permits := patterns.PERMITS.match(text):
        hint = "unclear if an order or a permission; say 'go to …', or 'you may go to … again'"
        raise unclear(permits[0], hint)
    marked, known = mark_places(text, places)
    refuse_unseen(marked)
    text = put_times_first(without_manner(f" {marked}"))
    for pattern, plain in patterns.FIRST_REWRITES:
        text = pattern.sub(plain, text)
    for rule, change in _rules():
        for pattern in rule:
            text = rewrite_outside_quotes(pattern, change, text)
    text = patterns.EXPLORED_TWICE.sub(r"\1", text)
    refuse_unknown_names(text)
    refuse_other_tours(text)
    _refuse_other_counts(text)
    text = restore_places(text, known)
    text = patterns.AFTER_WAIT.sub(r"\g<wait>, then", text)
    for pattern, hint in patterns.UNCLEAR:
        if found := pattern.search(text):
            raise unclear(found[0], hint)
    refuse_impossible(text.strip())
    return text.strip()


@cache
def _rules() -> list[tuple[list[Pattern], Change]]:
    """Return the patterns of each rule and the function that replaces a match.

    The order matters: each rule sees the text of the rules before it, and none changes what is in
    quotes already.
    """
    rules: tuple[tuple[str | list[Pattern], Change], ...] = (
        ([patterns.ANOTHER], _rewrite_another),
        ([patterns.COUNTED], _rewrite_counted),
        ([patterns.HINTED], _rewrite_hinted),
        ([patterns.COLOURED], _rewrite_coloured),
        ([patterns.WANTED_FOUND], lambda found: f" find {found['object']}"),
        ([patterns.NEAREST], lambda found: f" the {found['object']} nearest to {found['anchor']}"),
        ([patterns.NEAREST_TO_ROBOT], _rewrite_nearest),
        ([patterns.INTRODUCED], _rewrite_introduced),
        ([patterns.SEARCHED_ROOM], _rewrite_searched_room),
        (patterns.SEARCHES, _rewrite_search),
        ([patterns.ALL_BUT], rewrite_all_but),
        (patterns.PATROLS, rewrite_patrol),
        (patterns.EVERY_ROOM, rewrite_every_room),
        ([patterns.EVERY_ROOM_TOO], rewrite_every_room_too),
        ([patterns.ROOM_FIRST], _rewrite_room_first),
        # Only at the start of the text.
        (patterns.ROUNDS_FIRST, lambda found: None if found.start() else rewrite_patrol(found)),
        (patterns.ERRAND_AND_BACK, rewrite_errand_and_back),
        (patterns.CHECKS, _rewrite_check),
        (patterns.EXPLORES, rewrite_exploration),
        (patterns.EXPLORES_HERE, rewrite_exploration_here),
        ([patterns.ROOM_WITH, patterns.RELATED], quote_related),
        ([patterns.WHICH_ROOM], _quote_which_room),
        ([patterns.GOES_ROOM], _insert_to),
        ([patterns.GOES_TO], lambda found: f"{found['lead']}go to {with_article(found['name'])}"),
        (patterns.IN_TURN, rewrite_list_in_turn),
        ([patterns.FINDS], lambda found: f"{found['lead']}find {found['name']}"),
        ([patterns.THERE_AND], _insert_then),
        ([patterns.COMPOUND], quote_compound),
        (patterns.STARTS, _rewrite_start),
        (patterns.BACK_TO, _rewrite_back_to),
        (patterns.BACKS, _rewrite_back),
        (patterns.CALLS, lambda found: f' go to "{CALLER}"' if not found.start() else None),
        (patterns.WAITS, _rewrite_wait),
    )
    return [(compile_templates(p, PARTS) if isinstance(p, str) else p, change)
            for p, change in rules]  # fmt: skip


def _rewrite_introduced(found: re.Match[str]) -> str | None:
    """Put the object that the first clause names in place of the second clause's pronoun."""
    slots = found.groupdict()
    noun = bare(found["object"])
    relation, anchor = slots["relation"] or slots["later"], slots["anchor"] or slots["at"]
    where = relation_text(relation, anchor)
    # Without an article, "look" is a verb.
    verb = noun == slots["object"].lower() and TABLE.get((noun.split()[0],)) == "verb"
    known = slots["opening"] or (is_name(noun) and not verb)
    if slots["relation"] and slots["later"]:
        return None
    if where is None or not known or bool(slots["any"]) != bool(slots["other"]):
        return None
    other = f" or the {bare(slots['other'])}" if slots["other"] else ""
    # "there is a mug on the desk, go there" asks to go to it; "look there" stays as it is.
    order = patterns.GO_THERE.sub("go to", found["order"]) if slots["there"] else found["order"]
    if slots["there"] and order == found["order"]:
        return None
    return f" {order} the {noun}{where}{other}"


def _rewrite_room_first(found: re.Match[str]) -> str | None:
    """Put "go to" before a room or place at the beginning."""
    name = bare(found["name"])
    return f" go to {with_article(found['name'])}" if is_room(name) else None


def _rewrite_another(found: re.Match[str]) -> str | None:
    """Return "find a chair, then another" as the order to find `chair 1 of 2`, then the other."""
    noun, between = found["object"].lower(), found["between"]
    wheres = (relation_text(*found.group("relation", "anchor")),
              relation_text(*found.group("later", "at")))  # fmt: skip
    is_other = found["same"] is None or found["same"].lower() == "one"
    if is_other and re.search(rf"\b{ARTICLE}\b", between):
        return None  # "find a chair, go to the desk, then find another one"
    if re.search(r"\b(?:and|or) (?!wait\b)", between):
        return None  # "find a mug and go to the dock, then find another mug"
    if patterns.BAN.search(between) or None in wheres or not _is_countable(noun):
        return None
    one, two = (f'"{noun} {n} of 2{where}"' for n, where in enumerate(wheres, 1))
    return f"{found['lead']}{found['first']} {one}{between}, then find {two}"


def _is_countable(noun: str) -> bool:
    """Return True if a name without an article means a known kind of object."""
    is_known = nouns.unknown_in(noun.split()) is None
    return is_known and not (is_room(noun) or is_vague(noun) or nouns.is_plural(noun.split()[-1]))


def _rewrite_counted(found: re.Match[str]) -> str | None:
    """Return "find two chairs" as `find "chair 1 of 2", then find "chair 2 of 2"`.

    Return "find all chairs" as `find "every chair"`.
    """
    *first, last = found["object"].lower().split()
    how_many = found["count"].lower()
    count = 2 if how_many == "both" else number_of(how_many) or 0
    relation, anchor = found.group("relation", "anchor")
    if relation in ("on", "at") and is_room(bare(anchor)) and not is_marked(bare(anchor)):
        relation = "in"  # "on the ward"
    where = relation_text(relation, anchor)
    if re.fullmatch(f" in(?: the)? {patterns.EVERYTHING}", where or ""):
        where = ""  # "in the house"
    noun = " ".join((*first, names.singular(last)))
    if where is None or is_vague(found["object"]) or not _is_countable(noun):
        return None
    if how_many.startswith(("all", "each", EVERY)):
        is_first = found["lead"][:1] in ".;!?"  # of a sentence
        there = None if is_first else patterns.GONE_TO.search(found.string[: found.start()])
        room = bare(there["name"]) if there is not None and not found["relation"] else ""
        if is_marked(room):  # it may be the name of a room
            raise unclear(found[0].strip(), "unclear where; say so, or use two sentences")
        where = relation_text("in", room) if room and is_room(room) else where
        if (names.singular(last) == last) == (how_many == "all") or noun in (*NOWHERE, "landmark"):
            return None  # "all chair", "every floor"
        _refuse_more_of_each(found)
        return f'{found["lead"]}find "every {noun}{where}"'
    if not 2 <= count <= MAX_COUNT or names.singular(last) == last:
        return None
    goals = (f'find "{noun} {n} of {count}{where}"' for n in range(1, count + 1))
    return found["lead"] + ", then ".join(goals)


def _refuse_more_of_each(found: re.Match[str]) -> None:
    """Refuse work at each object, and more names or rooms, after "find all chairs"."""
    rest = found.string[found.end() :]
    if re.match(r"[^.;!?]*\bthere\b", rest) or patterns.IN_EACH.match(rest):
        hint = "the robot goes to each one; it can do no more there"
        raise unclear(f"{found[0]}{rest}".strip(), hint)
    joint = r"(?:,| and| then)+"
    more = re.match(rf"{joint} (?P<where>in|all|each|every)?(?P<name>.*?)(?=[,.;!?]| and|$)", rest)
    if more is not None and (more["where"] or nouns.unknown_in(bare(more["name"]).split()) is None):
        raise unclear(more[0].strip(" ,"), "unclear what of it is meant; say 'find all …' for each")


def _refuse_other_counts(text: str) -> None:
    """Refuse "every chair" with other names, which a translator would read as one chair."""
    for sentence in re.split(r"[.;!?]", re.sub(r'"[^"]*"', '""', text)):
        for found in patterns.EACH_OBJECT.finditer(sentence):
            is_ban = patterns.BAN.search(sentence, 0, found.start())
            if _is_countable(bare(found["object"])) and not is_ban:
                hint = "unclear if this means every one of them; say 'find all …' for each"
                raise unclear(found[0].strip(), hint)


def _rewrite_hinted(found: re.Match[str]) -> str | None:
    """Return "find the mug, it should be on the desk" as the order to find the mug on the desk."""
    noun, where = bare(found["object"]), relation_text(found["relation"], found["anchor"])
    if where is None or is_room(noun) or is_marked(noun) or is_vague(noun):
        return None
    return f"{found['order']} the {noun}{where}"


def _rewrite_coloured(found: re.Match[str]) -> str | None:
    """Return "find my mug, it is a white one" as the order to find the white mug."""
    colour, noun = found["colour"].lower(), bare(found["object"])
    if colour not in nouns.COLOURS or is_vague(noun) or is_room(noun):
        return None
    if nouns.COLOURS & set(noun.split()):
        return None
    return f"{found['order']} the {colour} {noun}"


def _rewrite_nearest(found: re.Match[str]) -> str | None:
    """Return "the nearest chair" as the chair; None in a ban, which would mean all chairs."""
    return None if _is_banned(found) else f" the {found['object']}"


def _is_banned(found: re.Match[str]) -> bool:
    """Return True if a word of a ban is before a match, in its clause."""
    clause = re.split(r"[.;!?,]| and | then ", found.string[: found.start()])[-1]
    return patterns.BAN.search(clause) is not None


def _goes_on(found: re.Match[str]) -> bool:
    """Return True if a place or another name belongs to what a match ends with."""
    rest = found.string[found.end() :]
    return re.match(rf" (?:{phrase_of('relation')}|and {ARTICLE})\b", rest, re.I) is not None


def _rewrite_searched_room(found: re.Match[str]) -> str | None:
    """Return "search the kitchen" as the order to explore it."""
    return f" explore {found['room']}" if is_room(bare(found["room"])) else None


def _rewrite_search(found: re.Match[str]) -> str | None:
    """Return "search the kitchen for a mug" as the order to find the mug in the kitchen."""
    slots = found.groupdict()
    room, each, name = slots.get("room"), slots.get("each"), slots.get("object") or slots["own"]
    new = slots.get("stops") or " until " in found[0]
    if new and (_is_banned(found) or _goes_on(found)):
        return None
    if slots.get("stops"):  # "search the bedroom and the bathroom for my keys"
        return _rewrite_search_in_rooms(slots["stops"], name)
    if room and each_kind(room):
        each, room = room, None  # "search every room for my keys"
    if is_vague(name):
        return None
    if each and each_kind(each) != "room":
        refuse_each(each)
    where = relation_text(slots.get("relation"), slots.get("anchor"))
    where = searched_text(room) if room else where
    if where is None or (where.startswith(" on") and re.search(r" (?:in|inside) ", found[0])):
        return None  # "look in the desk for my keys"
    return f' find "{bare(name)}{where}"'


def _rewrite_search_in_rooms(stops: str, name: str) -> str | None:
    """Return the order to find an object in any of several rooms; None if one is no room."""
    rooms = re.split(STOP, stops)
    if re.search(r"\b(?:then|to)\b", stops) or not all(is_room(bare(room)) for room in rooms):
        return None
    if is_vague(name):
        return None
    places = (f'"{bare(name)}{relation_text("in", room)}"' for room in rooms)
    return f" find {' or '.join(places)}"


def _rewrite_check(found: re.Match[str]) -> str | None:
    """Return "see if the mug is on the desk" as `go to "check mug on the desk"`."""
    slots = found.groupdict()
    noun = bare(found["object"])
    if is_vague(noun) or noun in ("it", "them"):
        return None
    if not slots.get("relation") and found[0].rstrip().endswith(found["object"]):
        known = is_marked(noun) or nouns.unknown_in(noun.split()) is None
        # An unknown object needs an article other than "any" and "some".
        named = known or re.match(r"(?!any|some)\w+ ", found["object"][: -len(noun)])
        nowhere = noun.startswith("rooms ") or noun.split()[-1] in NOWHERE
        if is_room(noun) or nowhere or not named:
            return None  # "check the kitchen" is no check of an object; nor "check for messages"
    if slots.get("into") and not is_room(bare(slots["into"])):
        return None
    if slots.get("room") or slots.get("into"):
        where = searched_text(slots.get("room") or slots["into"])
    else:
        where = relation_text(slots.get("relation"), slots.get("anchor"))
    if slots.get("within"):
        if where is None or not is_room(bare(slots["within"])):
            return None
        where += relation_text("in", slots["within"]) or ""
    if re.match(r" (?!and |then |but |when |while |in order )\w", found.string[found.end() :]):
        return None  # "check if the heater is on"
    return None if where is None else go_to(f"{CHECK} {noun}{where}", found)


def _quote_which_room(found: re.Match[str]) -> str:
    which = {"biggest": "largest"}.get(found["which"].lower(), found["which"].lower())
    return f' "{which} room"'


def _insert_then(found: re.Match[str]) -> str | None:
    """Insert "then" between "go to the kitchen" or "find the mug" and the work there."""
    in_order = is_room(bare(found["room"])) if found["room"] else not found["finds"]
    return f"{found['go']}, then" if in_order else None


def _insert_to(found: re.Match[str]) -> str | None:
    """Insert the "to" that children and learners of English leave out: "go kitchen"."""
    name = bare(found["name"])
    first = name.split()[:-1]
    known = is_marked(name) or (is_room(name) and all(map(modifies, first)))
    return f"{found['lead']}go to {found['name']}" if known else None


def _rewrite_back_to(found: re.Match[str]) -> str | None:
    """Return "back to the kitchen" as an order; None if it names no room or place."""
    noun = found["object"]
    if not (is_marked(noun) or is_room(bare(noun))):
        return None
    return f"{', then' * bool(found.start())} go to {with_article(noun)}"


def _rewrite_start(found: re.Match[str]) -> str | None:
    """Return "go home" as the order to go to the start; None within a name or a clause."""
    before, after = found.string[: found.start()], found.string[found.end() :]
    if re.search(r"\b(?:i|we|you|they|he|she|not|never|to)$", before, re.I):
        return None
    ends = re.match(r"[,.;!?]|$| (?:and|then|but|or)\b", after)
    is_word = re.search(r"\b(?:home|base)$", found[0], re.I)
    return None if is_word and not ends else go_to(START, found)


def _rewrite_back(found: re.Match[str]) -> str | None:
    """Return "come back" as the order to go where the mission began; None before a destination."""
    after = found.string[found.end() :]
    if re.match(r" ?(?:to|\"|into|and forth)", after) or re.match(
        r" +(?!then|and|when|once)\w", after
    ):
        return None
    return go_to(HERE, found)


def _rewrite_wait(found: re.Match[str]) -> str | None:
    """Return "wait for ten minutes at the door" as orders with `wait 10 min`."""
    slots = found.groupdict()
    # "until I say go to the kitchen": the rest may be what is said then
    if " until " in found[0] and re.match(r" (?!and\b|then\b)\w", found.string[found.end() :]):
        return None
    wait, has_end = WAIT, slots.get("span") or slots.get("clock")
    if has_end:
        clock = slots.get("clock")
        end = f"until {time_of_day(clock)}" if clock else shown_s(seconds_of(slots["span"]))
        wait = f"{WAIT} {end}"
    if slots.get("object"):
        return f'{", then" * bool(found.start())} go to {slots["object"]}, then go to "{wait}"'
    return go_to(wait, found) if found.start() or has_end else None
