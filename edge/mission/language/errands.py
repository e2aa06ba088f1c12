"""Rewriting of everyday errands into plain orders with quoted propositions.

Checks, explorations, patrols, waits and objects with a relation become `go to "check stove"`,
`go to "explored kitchen"`, `go to "wait 30 s"`, `find "mug in the kitchen"`. Each quoted
proposition is the canonical text of a destination (see `edge.mission.destinations`). `spell_out`
applies the rules in a fixed order; the translators read its result.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Union

from edge import names, number_words
from edge.memory import RECOGNISED_KINDS, kind_of_room
from edge.mission.language import errand_patterns as patterns
from edge.mission.language import nouns
from edge.mission.language.errand_parts import PARTS
from edge.mission.language.errand_patterns import CALLER, CHECK, MAX_COUNT, MAX_ROUNDS, WAIT
from edge.mission.language.everyday_words import (
    EACH_ROOM,
    EACH_ROOM_AND,
    MARK,
    NAME,
    NOWHERE,
    bare,
    each_kind,
    is_room,
    is_vague,
    phrase_of,
    refuse_each,
)
from edge.mission.language.impossible import refuse_impossible, refuse_states
from edge.mission.language.lexicon import TABLE
from edge.mission.language.places import (
    EVERY,
    EXPLORED,
    HERE,
    START,
    is_marked,
    mark_places,
    restore_places,
)  # fmt: skip
from edge.mission.language.spans import number_of, seconds_of
from edge.mission.language.templates import STOP, compile_templates
from edge.mission.language.tokens import UnclearError
from edge.mission.language.unsupported import BEYOND_NAMES
from edge.text import one_line

_Change = Callable[[re.Match[str]], Union[str, None]]  # None keeps the match
_BAN = re.compile(r"\b(?:not|never|avoid\w*|without|except|away|out of)\b", re.I)
_JOINT = r",? (?:and then|and|then|or) |, "  # between the stops of an exploration


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
        raise UnclearError(f"instruction: {permits[0]!r}: {hint}", permits[0])
    marked, known = mark_places(text, places)
    refuse_states(marked)
    text = f" {marked}"
    for pattern, plain in patterns.FIRST_REWRITES:
        text = pattern.sub(plain, text)
    for rule, change in _rules():
        for pattern in rule:
            text = _rewrite_outside_quotes(pattern, change, text)
    text = patterns.EXPLORED_TWICE.sub(r"\1", text)
    _refuse_unknown_names(text)
    _refuse_other_tours(text)
    text = restore_places(text, known)
    text = patterns.AFTER_WAIT.sub(r"\g<wait>, then", text)
    for unclear, hint in patterns.UNCLEAR:
        if found := unclear.search(text):
            part = found[0].strip()
            raise UnclearError(f"instruction: {part!r}: {hint}", part)
    refuse_impossible(text.strip())
    return text.strip()


@cache
def _rules() -> list[tuple[list[re.Pattern[str]], _Change]]:
    """Return the patterns of each rule and the function that replaces a match.

    The order matters: each rule sees the text of the rules before it, and none changes what is in
    quotes already. The templates are compiled at the first call, which takes 0.2 s.
    """
    rules: tuple[tuple[str | list[re.Pattern[str]], _Change], ...] = (
        ([patterns.COUNTED], _rewrite_counted),
        ([patterns.HINTED], _rewrite_hinted),
        ([patterns.COLOURED], _rewrite_coloured),
        ([patterns.WANTED_FOUND], lambda found: f" find {found['object']}"),
        ([patterns.NEAREST], lambda found: f" the {found['object']} nearest to {found['anchor']}"),
        ([patterns.NEAREST_TO_ROBOT], _rewrite_nearest),
        ([patterns.INTRODUCED], _rewrite_introduced),
        (patterns.SEARCHES, _rewrite_search),
        (patterns.PATROLS, _rewrite_patrol),
        (patterns.EVERY_ROOM, _rewrite_every_room),
        ([patterns.EVERY_ROOM_TOO], _rewrite_every_room_too),
        ([patterns.ROOM_FIRST], _rewrite_room_first),
        # Only at the start of the text.
        (patterns.ROUNDS_FIRST, lambda found: None if found.start() else _rewrite_patrol(found)),
        (patterns.ERRAND_AND_BACK, _rewrite_errand_and_back),
        (patterns.CHECKS, _rewrite_check),
        (patterns.EXPLORES, _rewrite_exploration),
        (patterns.EXPLORES_HERE, _rewrite_exploration_here),
        ([patterns.ROOM_WITH, patterns.RELATED], _quote_related),
        ([patterns.WHICH_ROOM], _quote_which_room),
        ([patterns.GOES_ROOM], _insert_to),
        ([patterns.GOES_TO], lambda found: f"{found['lead']}go to {_with_article(found['name'])}"),
        (patterns.IN_TURN, _rewrite_list_in_turn),
        ([patterns.FINDS], lambda found: f"{found['lead']}find {found['name']}"),
        ([patterns.THERE_AND], _insert_then),
        ([patterns.COMPOUND], _quote_compound),
        (patterns.STARTS, _rewrite_start),
        (patterns.BACK_TO, _rewrite_back_to),
        (patterns.BACKS, _rewrite_back),
        (patterns.CALLS, lambda found: f' go to "{CALLER}"' if not found.start() else None),
        (patterns.WAITS, _rewrite_wait),
    )
    return [(compile_templates(p, PARTS) if isinstance(p, str) else p, change)
            for p, change in rules]  # fmt: skip


def _refuse_unknown_names(text: str) -> None:
    """Refuse a quoted proposition with a word that is no known object, such as a typing error."""
    for phrase in text.split('"')[1::2]:  # the texts in quotes
        if patterns.NO_OBJECT.match(phrase):
            continue
        for name in patterns.BETWEEN_NAMES.split(phrase.removeprefix(f"{CHECK} ")):
            if name.strip() and not _is_name(name):
                words = name.split()
                odd = words[nouns.unknown_in(words) or 0]
                slip = f" ({meant}?)" if (meant := nouns.suggest_word(odd)) else ""
                hint = (
                    f"not a known object or room{slip}; if it is an object, "
                    f'write "{one_line(phrase)}" in double quotes'
                )
                raise UnclearError(f"instruction: {name!r}: {hint}", name)


def _refuse_other_tours(text: str) -> None:
    """Refuse several rooms that no rule has read; a ban may name them."""
    for sentence in re.split(r"[.;!?]", re.sub(r'"[^"]*"', '""', text)):
        found = re.search(rf"\b{EACH_ROOM}\b", sentence, re.I)
        if found and not _BAN.search(sentence):
            hint = f"a tour cannot stand here; say 'go into {found[0]}' in a sentence of its own"
            raise UnclearError(f"instruction: {found[0]!r}: {hint}", found[0])


def _is_name(name: str) -> bool:
    """Return True for a known name, or a new one for a kind of a known object: "crash trolley"."""
    words = bare(name).partition(" of ")[0].split()
    if re.fullmatch(MARK, name) or is_room(bare(name)) or nouns.unknown_in(words) is None:
        return True
    # "crash trolley": the known noun begins at word 1, and "crash" may stand before it.
    head = next((i for i in range(len(words)) if nouns.is_noun(" ".join(words[i:]))), None)
    return head is not None and all(map(_modifies, words[:head]))


def _rewrite_outside_quotes(pattern: re.Pattern[str], change: _Change, text: str) -> str:
    """Replace the matches of a pattern outside quotes.

    Args:
        pattern: the pattern.
        change: returns the replacement of a match; None keeps the match.
        text: the text.
    """

    def replace(found: re.Match[str]) -> str:
        # The match begins in quotes, or only one of its ends is in quotes.
        if text.count('"', 0, found.start()) % 2 or found[0].count('"') % 2:
            return found[0]
        new = change(found)
        return found[0] if new is None else new

    return pattern.sub(replace, text)


def _go_to(proposition: str, found: re.Match[str] | None = None) -> str:
    """Return `go to "proposition"`; with "then" if the match is not at the start of the text."""
    later = found is not None and found.start() > 0
    return f'{", then" if later else ""} go to "{proposition}"'


def _rewrite_introduced(found: re.Match[str]) -> str | None:
    """Put the object that the first clause names in place of the second clause's pronoun."""
    slots = found.groupdict()
    noun = bare(found["object"])
    relation, anchor = slots["relation"] or slots["later"], slots["anchor"] or slots["at"]
    where = _relation_text(relation, anchor)
    # Without an article, "look" is a verb.
    verb = noun == slots["object"].lower() and TABLE.get((noun.split()[0],)) == "verb"
    known = slots["opening"] or (_is_name(noun) and not verb)
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
    return f" go to {_with_article(found['name'])}" if is_room(name) else None


def _rewrite_counted(found: re.Match[str]) -> str | None:
    """Return "find two chairs" as `find "chair 1 of 2", then find "chair 2 of 2"`."""
    *first, last = found["object"].lower().split()
    count = 2 if found["count"].lower() == "both" else number_of(found["count"].lower())
    where = _relation_text(found["relation"], found["anchor"])
    noun = " ".join((*first, names.singular(last)))
    if (
        count is None
        or not 2 <= count <= MAX_COUNT
        or where is None
        or names.singular(last) == last
    ):
        return None
    if is_room(noun) or is_vague(found["object"]) or nouns.unknown_in(noun.split()) is not None:
        return None
    goals = (f'find "{noun} {n} of {count}{where}"' for n in range(1, count + 1))
    return found["lead"] + ", then ".join(goals)


def _rewrite_hinted(found: re.Match[str]) -> str | None:
    """Return "find the mug, it should be on the desk" as the order to find the mug on the desk."""
    noun, where = bare(found["object"]), _relation_text(found["relation"], found["anchor"])
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
    clause = re.split(r"[.;!?,]| and | then ", found.string[: found.start()])[-1]
    return None if _BAN.search(clause) else f" the {found['object']}"


def _rewrite_search(found: re.Match[str]) -> str | None:
    """Return "search the kitchen for a mug" as the order to find the mug in the kitchen."""
    slots = found.groupdict()
    room, each, name = slots.get("room"), slots.get("each"), slots.get("object") or slots["own"]
    if (room and not is_room(bare(room))) or is_vague(name):
        return None
    if each and each_kind(each) != "room":
        refuse_each(each)
    where = _relation_text("in", room)
    return None if where is None else f' find "{bare(name)}{where}"'


def _rewrite_every_room(found: re.Match[str]) -> str | None:
    """Return "visit all bedrooms" as `go to "every bedroom"`; None to explore all rooms."""
    kind, left_out = each_kind(found["each"]), bare(found["left_out"] or "")
    explores = re.search(r"\b(?:explor|scan|map|survey)", found[0], re.I)
    is_ban = re.search(r"\b(?:not|never)$", found.string[: found.start()], re.I)
    if is_ban or (kind == "room" and explores):
        return None
    rest = found[0][found.end("each") - found.start() :]
    if work := patterns.IN_EACH.match(rest + found.string[found.end() :]):
        hint = "the robot goes into each room and looks around; it cannot be told what to do there"
        raise UnclearError(f"instruction: {work[0].strip()!r}: {hint}", work[0].strip())
    known = is_marked(left_out) or kind_of_room(left_out) in RECOGNISED_KINDS
    if known or re.fullmatch(r"room \w+", left_out):
        rest = f", but do not go to {found['left_out']}"
    elif left_out and is_room(left_out):
        hint = "no room has this name; give a room this name first"
        raise UnclearError(f"instruction: {left_out!r}: {hint}", left_out)
    elif not left_out:
        rest = ""
    is_next = found.start() and re.match(r",| (?:and|then|so|but)\b", found[0], re.I)
    return _go_to(_tour_of(found), found if is_next else None) + rest


def _tour_of(found: re.Match[str]) -> str:
    """Return the proposition of a tour: "every bedroom" for "all the bedrooms"."""
    if more := EACH_ROOM_AND.match(found.string, found.end("each")):
        part = f"{found['each'].strip()}{more[0]}"
        hint = "unclear if this means every one of them; say 'every' before each kind of room"
        raise UnclearError(f"instruction: {part!r}: {hint}", part)
    return f"{EVERY} {each_kind(found['each'])}"


def _rewrite_every_room_too(found: re.Match[str]) -> str | None:
    """Return "and every bathroom", after another stop, as an order."""
    sentence = re.split(r"[.;!?]", found.string[: found.start()])[-1]
    return None if _BAN.search(sentence) else _go_to(_tour_of(found), found)


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
        where = _relation_text("in", slots.get("room") or slots["into"])
    else:
        where = _relation_text(slots.get("relation"), slots.get("anchor"))
    if slots.get("within"):
        if where is None or not is_room(bare(slots["within"])):
            return None
        where += _relation_text("in", slots["within"]) or ""
    if re.match(r" (?!and |then |but |when |while |in order )\w", found.string[found.end() :]):
        return None  # "check if the heater is on"
    return None if where is None else _go_to(f"{CHECK} {noun}{where}", found)


def _relation_text(
    relation: str | None, anchor: str | None, other: str | None = None
) -> str | None:
    """Return " next to the desk"; "" without a relation, None if the anchor is no object."""
    if not relation or not anchor:
        return ""
    if each_kind(anchor):
        refuse_each(anchor)
    name = bare(anchor)
    words = name.split()
    phrase = f"{relation} {anchor}".lower().split()
    # A phrase of the lexicon that is longer than the relation, such as "at some point".
    idiom = any(
        tuple(phrase[:n]) in TABLE for n in range(len(relation.split()) + 1, len(phrase) + 1)
    )
    verb = name == anchor.lower() and TABLE.get((words[0],)) == "verb" and len(words) > 1
    bare_by = relation == "by" and name == anchor.lower() and not is_marked(name)  # "by bus"
    if idiom or verb or bare_by or is_vague(anchor) or words[-1] in NOWHERE:
        return None  # "at some point", "by passing the desk"
    if number_words.number(words) is not None and not is_room(name):
        return None  # "between the two"
    relation = patterns.RELATIONS.get(relation.lower(), relation.lower())
    the = "" if re.search(r" (?:\d+\w?|[a-z])$", name) else "the "
    more = f" and the {bare(other)}" if other else ""
    return f" {relation} {the}{name}{more}"


def _rewrite_exploration(found: re.Match[str]) -> str | None:
    """Return "explore the kitchen and the hall" as orders to go to `explored …`."""
    slots = found.groupdict()
    time = _for_duration(slots.get("span"))
    # Rooms, and the words between them; "" stands for the entire site.
    joints = re.findall(_JOINT, slots.get("stops") or "")
    rooms = [bare(stop) for stop in re.split(_JOINT, slots.get("stops") or slots.get("room") or "")]
    rooms = ["" if re.fullmatch(r"(?:every|each|all) rooms?", room) else room for room in rooms]
    if not all(is_room(room) for room in rooms if room) or (time and len(rooms) > 1):
        return None
    if vague := [room for room in rooms if room and is_vague(room)]:
        raise UnclearError(f"instruction: {vague[0]!r}: unclear which room; name it", vague[0])
    orders = [_go_to(f"{EXPLORED}{f' {room}' * bool(room)}{time}") for room in rooms]
    return orders[0] + "".join(
        j.rstrip() + order for j, order in zip(joints, orders[1:], strict=True)
    )


def _rewrite_exploration_here(found: re.Match[str]) -> str | None:
    """Return the order to explore the entire site, or the room that the text before goes to."""
    room, before = "", found.string[: found.start()]
    if before:
        last = re.search(rf"(?:to|in|into) (?P<name>{NAME}),?$", before, re.I)
        if last is None or not is_room(bare(last["name"])):
            raise UnclearError(f"instruction: {found[0].strip()!r}: unclear where; name the room")
        room = f" {bare(last['name'])}"
    return _go_to(f"{EXPLORED}{room}{_for_duration(found['span'])}", found)


def _for_duration(span: str | None) -> str:
    return f" for {_duration_text(seconds_of(span))}" if span else ""


def _duration_text(seconds: float) -> str:
    """Return a length of time [s] in the format of propositions: `90 s`, `10 min`."""
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min" if minutes and not rest else f"{seconds:.0f} s"


def _rewrite_patrol(found: re.Match[str]) -> str | None:
    """Return a patrol as the stops of all its rounds, or as one round with "repeat …".

    Return None if it is no patrol.
    """
    slots = found.groupdict()
    before, after = found.string[: found.start()], found.string[found.end() :].strip(" .!?")
    if re.search(r"\b(?:not|never|stop)$", before, re.I):
        return None
    if slots.get("stops") is None:
        kind = each_kind(slots["each"]) if slots.get("each") else "room"
        stops = [f'"{EVERY} {kind}"']
    else:
        stops = [bare(stop) for stop in re.split(STOP, slots["stops"])]
        if re.search(r"\bor\b", slots["stops"]) or any(map(is_vague, stops)) or len(stops) < 2:
            return None
    often = (slots.get("count") or slots.get("often") or "").lower()
    rounds = number_of(often) if often else None
    if often and rounds is None:
        return None
    if rounds is not None and 1 <= rounds <= MAX_ROUNDS and (len(stops) > 1 or rounds == 1):
        return _go_to_each(stops * rounds)
    if before or after:
        part = before.strip() or after
        hint = (
            "this cannot go with a patrol of rooms, for some time, without an end or with more "
            f"than {MAX_ROUNDS} rounds; send the patrol alone"
        )
        raise UnclearError(f"instruction: {part!r}: {hint}", part)
    end = f"{rounds} times" if rounds is not None else "until told"
    end = f"for {_duration_text(seconds_of(slots['span']))}" if slots.get("span") else end
    return f"{_go_to_each(stops)}; repeat {end}"


def _rewrite_errand_and_back(found: re.Match[str]) -> str | None:
    """Return "go to the door and back, three times" as a sequence of stops."""
    slots = found.groupdict()
    times = number_of((slots.get("count") or slots.get("often") or "").lower())
    if times is None or not 1 <= times <= MAX_ROUNDS:
        return None
    return _go_to_each([bare(found["object"]), f'"{HERE}"'] * times)


def _quote_related(found: re.Match[str]) -> str | None:
    """Quote an object with its relation: the mug on the desk becomes "mug on the desk"."""
    slots = found.groupdict()
    noun = found["object"]
    words = noun.split()
    # "find mug on the desk": the name begins after the verb.
    while words and TABLE.get((words[0].lower(),)) in ("verb", "avoid") and len(words) > 1:
        words = words[1:]
    before = noun[: len(noun) - len(" ".join(words))]
    relation = (slots.get("relation") or "with").lower()
    articled = bare(noun) != noun.lower()
    led = before or patterns.LEADS_TO_NAME.search(found.string[: found.start()])
    if not articled and (nouns.unknown_in(words) is not None or not led):
        return None  # "park at the dock": a verb, no object
    if (
        words[-1] in NOWHERE
        or (is_vague(" ".join(words)) and relation != "with")
        or (is_room(bare(noun)) and relation in ("by", "near", "at"))
    ):
        return None
    if slots.get("relation") and TABLE.get((words[-1].lower(),)) in ("verb", "do"):
        return None
    other = slots.get("other") if relation == "between" else None
    where = _relation_text(relation, found["anchor"], other)
    within = slots.get("within")  # " in the kitchen": the name begins at the third part
    if where is None or (within and not is_room(bare(within.split(" ", 2)[2]))):
        return None
    where += _relation_text("in", within.split(" ", 2)[2]) or "" if within else ""
    rest = f" and {slots['other']}" if slots.get("other") and not other else ""
    name = bare(" ".join(words))
    if slots.get("else"):
        rest = f" or {slots['else']}"
        if slots["again"] or (is_room(bare(slots["else"])) and is_room(bare(found["anchor"]))):
            rest = f' or "{name}{_relation_text(slots["again"] or relation, slots["else"])}"'
    return f' {before}"{name}{where}"{rest}'


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
    known = is_marked(name) or (is_room(name) and all(map(_modifies, first)))
    return f"{found['lead']}go to {found['name']}" if known else None


def _rewrite_list_in_turn(found: re.Match[str]) -> str | None:
    """Return a list of stops that comes back to one as a sequence: "kitchen, hall, kitchen"."""
    stops = [bare(stop) for stop in re.split(STOP, found["stops"])]
    if len(set(stops)) == len(stops) or re.search(r"\bor\b", found["stops"]):
        return None
    return _go_to_each(stops)


def _go_to_each(stops: Sequence[str]) -> str:
    """Return the order to go to each of the stops in sequence."""
    goals = (stop if is_marked(stop) or stop[0] == '"' else f"the {stop}" for stop in stops)
    return " " + ", then ".join(f"go to {goal}" for goal in goals)


def _with_article(name: str) -> str:
    """Return the name of a room with an article, which learners leave out: "go to kitchen"."""
    articled = name.startswith('"') or bare(name) != name.lower() or is_marked(name)
    return name if articled or not is_room(name) or name[-1].isdigit() else f"the {name}"


def _quote_compound(found: re.Match[str]) -> str | None:
    """Quote a name of several words that is in no list, if no word is a typing error."""
    name = found["name"]
    words = bare(name).split()
    articled = bare(name) != name.lower()
    if len(words) < 2 or nouns.unknown_in(words) is None:
        return None
    if words[1] == "of" and articled:
        return f' "{" ".join(words)}"'
    head = nouns.is_noun(words[-1]) and not nouns.is_plural(words[-1])
    if not is_room(" ".join(words)) and not (articled and head):
        return None
    numbered = words[-2] == "room" and (words[-1].isdigit() or number_of(words[-1]) is not None)
    if not all(map(_modifies, words[: -2 if numbered else -1])) or all(
        map(names.is_known, words[-2:])
    ):
        return None
    return f' "{" ".join(words)}"'


def _modifies(word: str) -> bool:
    """Return True if a word may stand before a noun, and is no slip of a known word."""
    if re.fullmatch(phrase_of("room of"), word):
        return True
    kind = TABLE.get((word,))
    if word in BEYOND_NAMES or word in nouns.ORDINALS or word in ("whole", "entire"):
        return False
    if is_vague(word) or is_room(word) or kind not in (None, "word", "verb"):
        return False
    if kind == "verb" and not word.endswith("ing") and not nouns.is_noun(word):
        return False
    return word.strip("'").isalpha() and nouns.suggest_word(word) is None


def _rewrite_back_to(found: re.Match[str]) -> str | None:
    """Return "back to the kitchen" as an order; None if it names no room or place."""
    noun = found["object"]
    if not (is_marked(noun) or is_room(bare(noun))):
        return None
    return f"{', then' * bool(found.start())} go to {_with_article(noun)}"


def _rewrite_start(found: re.Match[str]) -> str | None:
    """Return "go home" as the order to go to the start; None within a name or a clause."""
    before, after = found.string[: found.start()], found.string[found.end() :]
    if re.search(r"\b(?:i|we|you|they|he|she|not|never|to)$", before, re.I):
        return None
    ends = re.match(r"[,.;!?]|$| (?:and|then|but|or)\b", after)
    is_word = re.search(r"\b(?:home|base)$", found[0], re.I)
    return None if is_word and not ends else _go_to(START, found)


def _rewrite_back(found: re.Match[str]) -> str | None:
    """Return "come back" as the order to go where the mission began; None before a destination."""
    after = found.string[found.end() :]
    if re.match(r" ?(?:to|\"|into|and forth)", after) or re.match(
        r" +(?!then|and|when|once)\w", after
    ):
        return None
    return _go_to(HERE, found)


def _rewrite_wait(found: re.Match[str]) -> str | None:
    """Return "wait for ten minutes at the door" as orders with `wait 10 min`."""
    slots = found.groupdict()
    # "until I say go to the kitchen": the rest may be what is said then
    if " until " in found[0] and re.match(r" (?!and\b|then\b)\w", found.string[found.end() :]):
        return None
    wait = f"{WAIT} {_duration_text(seconds_of(slots['span']))}" if slots.get("span") else WAIT
    if slots.get("object"):
        return f'{", then" * bool(found.start())} go to {slots["object"]}, then go to "{wait}"'
    return _go_to(wait, found) if found.start() or slots.get("span") else None
