"""Refusal of instructions that no formula over reached objects can express, recognised by words.

The instruction is searched before it is parsed. Otherwise a parser or a model could leave out or
misread a part. Then a ban could become its opposite ("never go out of the yard"), or the robot
could go to an object that no person meant ("guard the gate").
"""

from __future__ import annotations

import itertools

from edge.mission.language.grammar.action import LEADING
from edge.mission.language.grammar.routes import RIDDEN
from edge.mission.language.words import nouns
from edge.mission.language.words.naming import is_indefinite, is_letter
from edge.mission.language.words.tokens import REASONS, Token, TokenReader

# Reasons of a refusal.
_WHERE = "objects differ by kind, colour and size, not by place; give only the name"
_TIME = "times and distances cannot be used; say only what to reach"
_DENIED = "only reaching objects can be forbidden"
_STAY = REASONS["stay"]
_OTHERS = "not an instruction for the robot"
_SHUN = "unclear: avoid it or visit it? say which"

_AT_TIMES = ("for", "in", "after", "before", "at", "within", "until")  # prepositions of times
_LEAVE = nouns.split_entries(
    """leave leaves leaving exit exits exiting depart departs departing quit quits quitting vacate
    vacating abandon abandoning stray strays straying escape escaping deviate deviating wander
    wandering"""
)
_NO_LEAVING = ("turn", "turning", "switch", "switching", "shut", "shutting", "take", "taking")
_KEEPS = ("stay", "keep", "remain", "stick", "wait")
_SELF = ("yourself", "itself")
_OPENS = ("open", "clos", "shut", "lock", "unlock")
_HANDLED = (
    *_OPENS, "mov", "pick", "grab", "collect", "bring", "fetch", "take", "taking", "load",
    "unload", "empty", "fill", "start", "turn", "switch", "roll",
)  # fmt: skip
"""Beginnings of verbs that handle an object: a ban on handling is no ban on reaching it."""
_CAUSES = ("make", "making", "get", "getting")
_KEPT_BY = ("at", "by", "along", "with", "within", "to")
_DENYING = ("not", "without", "avoid", "neither")
BEYOND_NAMES = nouns.split_entries(
    """taller tallest shorter shortest larger largest bigger biggest smaller smallest wider widest
    longer longest lower lowest higher highest narrower narrowest newest oldest brightest darkest
    nearest closest nearby nearer closer farthest furthest farther further leftmost rightmost
    middlemost next-door"""
)
"""Words that compare objects, or say which one by its place; no name has them."""
_MOST_NAME_WORDS = 6
_SPOTS = ("spot", "spots", "place", "position", "point", "somewhere", "anywhere", "everywhere")
_WITH = ("with", "at", "between", "by")
_VEHICLES = nouns.split_entries(
    """car bus bike bicycle train taxi cab truck van tram boat ship ferry plane air motorcycle
    motorbike scooter metro subway foot hand"""
)
_SEARCHES = ("search", "scan", "survey", "map")
_UNITS = nouns.split_entries(
    """second seconds minute minutes hour hours day days week weeks moment moments pm am
    o'clock metre metres meter meters foot feet yard yards mile miles kilometre kilometres kilometer
    kilometers km cm step steps inch inches"""
)
_SPANS = nouns.split_entries(
    """second seconds minute minutes hour hours day days week weeks moment moments while bit"""
)


def refuse_unsupported(reader: TokenReader) -> None:
    """Refuse staying, leaving, places, relations, times and the like.

    Raises:
        UnclearError: the instruction has such a part.
    """
    denied = False
    for at, token in enumerate(reader.tokens):
        reader.at = at
        if denied and token.kind == "then" and reader.is_at("article", "quoted", ahead=1):
            reader.refuse_finally(_SHUN, token)  # "do not go to a and then the b"
        if token.kind in ("stop", "comma", "but", "then"):
            denied = False
        hint, start = _reason(reader, denied), token
        before = _previous(reader)
        if hint == _WHERE:
            start = _name_before(reader) or token
        # The message begins at the name, or at the preposition of the time.
        if hint == _TIME and before and before.text in _AT_TIMES:
            start = before
        if hint:
            reader.refuse_finally(hint, start)
        denied = denied or token.kind in _DENYING
    reader.at = 0


def _reason(reader: TokenReader, denied: bool) -> str:
    """Return why the token here cannot be understood; "" if it may be understood.

    `denied` is True after "not", "without", "avoid" or "neither" in the same part of a sentence.
    """
    token, after, before = reader.peek(), reader.peek(1), _previous(reader)
    if token.kind in ("quoted", "end"):
        return ""
    if _is_leaving(reader, denied) or _is_staying(reader, denied):
        return _STAY
    if token.text == "nor" and not any(t.kind in _DENYING for t in reader.tokens[: reader.at]):
        return "'nor' needs 'not' or 'neither' before it"
    if token.text == "nowhere" and after.kind == "but":
        return "say what to visit, and what to avoid"
    if token.kind == "around" and denied:
        return "say what to avoid, or what to go through"  # "go around it" means "avoid it"
    if hint := _handling_reason(reader, denied) or _no_order_reason(reader):
        return hint
    if token.kind == "avoid" and after.kind == "neither":
        return _SHUN
    if _is_trailing_always(reader):
        return "unclear how long to avoid it; use a separate sentence"
    if _is_lone_letter(reader):
        return "give the full name of each, as in 'gate a or gate b'"
    if token.text == "last" and before and before.kind == "article" and _name_at(reader, 1):
        return "the camera cannot see which one is the last; give its kind, colour or size"
    if _is_time(reader):
        return _TIME
    if token.text in BEYOND_NAMES and token.kind == "word":
        return "the camera cannot see which one this is; give its kind, colour or size"
    if token.text in _SPOTS and _is_location(reader, 1):
        return "the robot can reach objects, not places near them; name the object"
    starts = before is None or before.kind == "stop"
    if starts and token.text == "after that" and after.kind == "word" and len(after.text) > 1:
        return "say 'after the …'"  # "After that chair, go to the bed."
    where = _is_location(reader, 0) or token.text == "on the road"
    if where and _name_before(reader):
        return _WHERE
    if token.text == "by" and after.text in _VEHICLES:
        return "how to go cannot be chosen; say only where to go"
    if _is_search(reader):
        return "the robot cannot search a place; say which object to find there"
    return "unclear if it must be done; leave out the condition" if _is_soft(reader) else ""


def _handling_reason(reader: TokenReader, denied: bool) -> str:
    """Return why "do not move the chair" or "pass up the sofa" is refused; "" for other tokens."""
    token = reader.peek()
    if token.kind == "word":
        did = reader.at > 1 and reader.tokens[reader.at - 2].kind == "do"
        bare = did and reader.peek(-1).kind == "not" and nouns.is_noun(token.text)
        return _DENIED if bare else ""  # "do not park before a"
    if token.kind != "verb":
        return ""
    ahead = 1
    while reader.peek(ahead).text in ("up", "back", "on", "off"):
        ahead += 1
    first = token.text.split()[0]
    if first in ("pass", "passing", "cross", "crossing") and reader.peek(1).text in ("up", "out"):
        return "say 'avoid …', or where to go"  # "pass up the sofa"
    handles = first.startswith(_HANDLED) and _is_object(reader, ahead)
    opens = first.startswith(_OPENS) and reader.is_at("article", ahead=ahead)
    return _DENIED if denied and (handles or opens) else ""


def _is_object(reader: TokenReader, ahead: int) -> bool:
    """Return True if an article and a known name that is no place come there."""
    article = reader.is_at("article", ahead=ahead) or reader.peek(ahead).text in ("a", "an")
    return article and bool(_name_at(reader, ahead)) and not _is_place(reader, ahead)


def _no_order_reason(reader: TokenReader) -> str:
    """Return why "can you see the lamp?" or "let me go" is refused; "" for other tokens."""
    token, after, before = reader.peek(), reader.peek(1), _previous(reader)
    if token.text == "let" and after.text == "me":
        return _OTHERS
    if token.kind == "verb" and token.text in _CAUSES and _is_object(reader, 1):
        ahead = 2
        while reader.is_at("word", ahead=ahead):
            ahead += 1
        ahead += reader.is_at("to", ahead=ahead)
        return _OTHERS if reader.is_at("verb", ahead=ahead) else ""  # "make the dog go to a"
    if before is not None and before.kind not in ("stop", "comma"):
        return ""
    sees = token.kind == "can" and reader.is_at("you", ahead=1) and reader.peek(2).text == "see"
    must = token.text == "must" and reader.is_at("you", ahead=1)
    return "not an instruction; say for example 'visit the bed'" if sees or must else ""


def _is_lone_letter(reader: TokenReader) -> bool:
    """Return True if the letter of "gate a or b", or of "rooms a and b", comes."""
    if not _is_letter(reader.peek()) or is_indefinite(reader):
        return False
    before = reader.tokens[: reader.at]
    if not before or before[-1].text == "rooms":
        return bool(before)
    lettered = any(
        word.kind == "word" and nouns.is_noun(word.text) and _is_letter(follower)
        for word, follower in itertools.pairwise(before)
    )
    joints = ("and", "or", "then", "to", "comma", "but", "not", "avoid")
    return lettered and before[-1].kind in joints


def _is_letter(token: Token) -> bool:
    return is_letter(token) and token.text != "i"


def _is_trailing_always(reader: TokenReader) -> bool:
    """Return True if the "always" of "avoid a until b, and c always" comes."""
    if not reader.is_at("always"):
        return False
    begin = reader.at
    while begin and reader.tokens[begin - 1].kind in ("word", "article", "quoted", "number"):
        begin -= 1
    joined = 0 < begin < reader.at and reader.tokens[begin - 1].kind in ("and", "comma")
    kinds = [token.kind for token in reader.tokens[:begin]]
    while "stop" in kinds:  # only the present sentence counts
        kinds = kinds[kinds.index("stop") + 1 :]
    return joined and any(kind in kinds for kind in ("until", "unless", "before", "after"))


def _is_soft(reader: TokenReader) -> bool:
    """Return True if "if you can", "if possible", or "every time" without a continuation comes."""
    if not reader.is_at("when"):
        return False
    willing = reader.is_at("you", ahead=1) and reader.peek(2).text in ("can", "could", "want")
    polite = reader.peek(1).text in ("possible", "necessary", "needed")
    return willing or polite or _ends_clause(reader, 1)


def _previous(reader: TokenReader) -> Token | None:
    return reader.tokens[reader.at - 1] if reader.at else None


def _ends_clause(reader: TokenReader, ahead: int) -> bool:
    return reader.is_at("stop", "comma", "end", "but", ahead=ahead)


def _is_leaving(reader: TokenReader, denied: bool) -> bool:
    """Return True if "out of a", "off a", "away from a", "beyond a" or a denied "leave a" comes."""
    token, after, before = reader.peek(), reader.peek(1), _previous(reader)
    joins = before is not None and before.kind in ("and", "or")
    if token.text == "out" and denied and after.kind == "article" and _is_place(reader, 1):
        return _name_at(reader, 1).split()[-1] not in LEADING  # "without going out the yard"
    if token.text in ("out", "away") and after.text in ("of", "from"):
        shuns = any(t.kind == "avoid" for t in reader.tokens[: reader.at])
        return not (joins and shuns)  # "stay out of a and out of b"
    if token.text == "off" and after.kind in ("article", "word", "quoted", "pronoun", "all of"):
        switched = before is not None and before.text in _NO_LEAVING
        return not (switched and not _is_place(reader, 1))
    return denied and (token.text in _LEAVE or (token.text == "from" and not joins))


def _is_staying(reader: TokenReader, denied: bool) -> bool:
    """Return True if "keep to a", "stay on a", "never stay away from a" comes."""
    token = reader.peek()
    if not token.text.startswith(_KEEPS):
        return False
    if token.kind == "avoid":  # "never stay away from a"
        # The last token before it that is no filler.
        before = next(t for t in [*reader.tokens[reader.at - 1 :: -1], token] if t.kind != "filler")
        return reader.at > 0 and denied and before.kind in _DENYING
    ahead = 1
    while reader.is_at("you", "pronoun", ahead=ahead) or reader.peek(ahead).text in _SELF:
        ahead += 1  # "keep the robot on the path"
    return reader.is_at("place", "to", ahead=ahead) or reader.peek(ahead).text in _KEPT_BY


def _is_time(reader: TokenReader) -> bool:
    """Return True if "for a minute", "in five minutes", "5 pm", "2 m" comes."""
    token, after = reader.peek(), reader.peek(1)
    if token.kind == "number":
        return after.text in _UNITS and after.text != "second"
    if token.text not in ("for", "in", "after"):
        return False
    unit = 2 if after.text in ("a", "an", "one", "some", "few", "several") else 1
    unit += reader.peek(unit).text in ("few", "short", "little", "couple")
    ends = _ends_clause(reader, unit + 1) or not reader.is_at("word", ahead=unit + 1)
    return unit > 1 and reader.peek(unit).text in _SPANS and ends


def _is_location(reader: TokenReader, ahead: int) -> bool:
    """Return True if "near the sofa", "in it", "that is on a table" begins there."""
    token, after = reader.peek(ahead), reader.peek(ahead + 1)
    if token.kind != "place" and token.text not in (*_WITH, "inside of"):
        return False
    if token.text == "by" and reader.peek(ahead + 2).text in RIDDEN:
        return False
    return after.kind in ("quoted", "pronoun", "either") or bool(_name_at(reader, ahead + 1))


def _name_before(reader: TokenReader) -> Token | None:
    """Return the first token of the name that ends before this token; None if there is none."""
    begin = reader.at
    before = _previous(reader)
    if before is None:
        return None
    if before.kind == "number" and begin > 1:
        begin -= 1
    end, found = begin, None
    earliest = max(0, begin - _MOST_NAME_WORDS)
    while begin > earliest and reader.tokens[begin - 1].kind in ("word", "group"):
        begin -= 1
        if _is_known([token.text for token in reader.tokens[begin:end]]):
            found = reader.tokens[begin]
    return found


def _is_place(reader: TokenReader, ahead: int) -> bool:
    """Return True if the name that begins there is the name of a place."""
    name = _name_at(reader, ahead)
    return bool(name) and nouns.is_place(name)


def _name_at(reader: TokenReader, ahead: int) -> str:
    """Return the known name that begins there, after an optional article; "" if there is none."""
    while reader.is_at("article", "all of", ahead=ahead) or reader.peek(ahead).text in ("a", "an"):
        ahead += 1
    words: list[str] = []
    while reader.is_at("word", "group", ahead=ahead) and len(words) < _MOST_NAME_WORDS:
        words.append(reader.peek(ahead).text)
        ahead += 1
    known = (" ".join(words[:n]) for n in range(len(words), 0, -1))
    return next((name for name in known if _is_known(name.split())), "")


def _is_known(words: list[str]) -> bool:
    return nouns.unknown_in(words) is None


def _is_search(reader: TokenReader) -> bool:
    """Return True if "explore the house", "search the kitchen", "look around" comes."""
    token = reader.peek()
    verb = token.text.split(" ")[0]
    if token.kind == "verb" and verb.startswith("explor"):
        return not _name_at(reader, 1) or _is_place(reader, 1)
    return verb.startswith(_SEARCHES) and token.kind in ("verb", "word") and _is_place(reader, 1)
