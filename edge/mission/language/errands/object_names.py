"""Names of objects in an errand: new compounds, relations such as "mug on the desk", articles."""

from __future__ import annotations

import re

from edge import names, number_words
from edge.mission.language.errands import errand_patterns as patterns
from edge.mission.language.grammar.unsupported import BEYOND_NAMES
from edge.mission.language.words import nouns
from edge.mission.language.words.everyday_words import (
    MARK,
    NOWHERE,
    bare,
    each_kind,
    is_room,
    is_vague,
    phrase_of,
    refuse_each,
)
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.places import EVERY, is_marked
from edge.mission.language.words.spans import number_of
from edge.mission.language.words.tokens import unclear
from edge.text import one_line

_ROOM_OF = re.compile(phrase_of("room of"))


def refuse_unknown_names(text: str) -> None:
    """Refuse a quoted proposition with a word that is no known object, such as a typing error."""
    for phrase in text.split('"')[1::2]:  # the texts in quotes
        if patterns.NO_OBJECT.match(phrase):
            continue
        described = re.sub(rf"^(?:{patterns.CHECK}|{EVERY}) ", "", phrase)
        for name in patterns.BETWEEN_NAMES.split(described):
            if name.strip() and not is_name(name):
                words = name.split()
                odd = words[nouns.unknown_in(words) or 0]
                slip = f" ({meant}?)" if (meant := nouns.suggest_word(odd)) else ""
                hint = (
                    f"not a known object or room{slip}; if it is an object, "
                    f'write "{one_line(phrase)}" in double quotes'
                )
                raise unclear(name, hint)


def is_name(name: str) -> bool:
    """Return True for a known name, or a new one for a kind of a known object: "crash trolley"."""
    words = bare(name).partition(" of ")[0].split()
    if re.fullmatch(MARK, name) or is_room(bare(name)) or nouns.unknown_in(words) is None:
        return True
    # "crash trolley": the known noun begins at word 1, and "crash" may stand before it.
    head = next((i for i in range(len(words)) if nouns.is_noun(" ".join(words[i:]))), None)
    return head is not None and all(map(modifies, words[:head]))


def modifies(word: str) -> bool:
    """Return True if a word may stand before a noun, and is no slip of a known word."""
    if _ROOM_OF.fullmatch(word):
        return True
    kind = TABLE.get((word,))
    if word in BEYOND_NAMES or word in nouns.ORDINALS or word in ("whole", "entire"):
        return False
    if is_vague(word) or is_room(word) or kind not in (None, "word", "verb"):
        return False
    if kind == "verb" and not word.endswith("ing") and not nouns.is_noun(word):
        return False
    is_slip = sorted(word) == sorted("the") or nouns.suggest_word(word)  # "teh kitchen"
    return word.strip("'").isalpha() and not is_slip


def relation_text(relation: str | None, anchor: str | None, other: str | None = None) -> str | None:
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


_SURFACES = nouns.split_entries(
    """desk table sofa couch bed shelf counter countertop worktop bench workbench chair armchair
    stool nightstand windowsill carpet rug bookshelf bookcase sideboard mantelpiece"""
)
_CONTAINERS = nouns.split_entries(
    """fridge refrigerator freezer drawer cupboard cabinet wardrobe closet box basket bag bin crate
    locker oven dishwasher"""
)


def searched_text(searched: str) -> str | None:
    """Return " in the kitchen", " on the desk", " in the drawer" for what is searched; or None."""
    name = bare(searched)
    head = names.singular(name.split()[-1])
    on = head in _SURFACES and not is_room(name)
    is_known = is_room(name) or ((on or head in _CONTAINERS) and is_name(name))
    return relation_text("on" if on else "in", searched) if is_known else None


def with_article(name: str) -> str:
    """Return the name of a room with an article, which learners leave out: "go to kitchen"."""
    articled = name.startswith('"') or bare(name) != name.lower() or is_marked(name)
    return name if articled or not is_room(name) or name[-1].isdigit() else f"the {name}"


def quote_related(found: re.Match[str]) -> str | None:
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
    is_verb = TABLE.get((words[-1].lower(),)) in ("verb", "do")
    if slots.get("relation") and is_verb and not (articled and len(words) == 2):  # "my watch"
        return None
    other = slots.get("other")
    where = relation_text(relation, found["anchor"], other)
    within = slots.get("within")  # " in the kitchen": the name begins at the third part
    if where is None or (within and not is_room(bare(within.split(" ", 2)[2]))):
        return None
    where += relation_text("in", within.split(" ", 2)[2]) or "" if within else ""
    rest, name = "", bare(" ".join(words))
    joint = (slots.get("joint") or "or").lower()
    if joint == "and" and not patterns.LOOKS_FOR.search(found.string[: found.start()]):
        rest = f" and {slots['again']} {slots['else']}"
    elif slots.get("else"):
        rest = f" or {slots['else']}"
        if slots["again"] or (is_room(bare(slots["else"])) and is_room(bare(found["anchor"]))):
            rest = f' or "{name}{relation_text(slots["again"] or relation, slots["else"])}"'
    return f' {before}"{name}{where}"{rest}'


def quote_compound(found: re.Match[str]) -> str | None:
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
    if not all(map(modifies, words[: -2 if numbered else -1])) or all(
        map(names.is_known, words[-2:])
    ):
        return None
    return f' "{" ".join(words)}"'
