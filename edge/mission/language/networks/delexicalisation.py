"""Delexicalisation: replaces the names in an instruction by placeholders for the network.

The network knows no objects. It reads `<0>` for the first object, `<1>` for the second, and so on.
A repeated object has the same placeholder.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from edge import names
from edge.mission.language.grammar.prefix_notation import MOST_NAMES, NAMES
from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import AFTER_VERB, PHRASES, TABLE
from edge.mission.language.words.spelling import WORD, expand_word
from edge.mission.language.words.tokens import MAX_CHARS, STRAIGHT, not_understood

MOST_PIECES = 250
"""Largest number of words and marks in an instruction."""
LONGEST_NAME = 6  # words
# Articles are removed before a placeholder.
ARTICLES = frozenset(["the", "a", "an", "my", "our", "your", "his", "her", "its", "their"])
# Words after which any known noun is a name.
_DETERMINERS = ARTICLES | {"this", "that", "each", "every", "any", "some", "another"}
_PREPOSITIONS = tuple(sorted(PHRASES["place"], key=len, reverse=True))  # of place, longest first
_OF_NO_NAME = {"of", "between", "against"}  # prepositions that join no two names
# An ordinal before these is a part of the name.
_STORIES = {"floor", "floors", "story", "level", "room", "landmark", "door", "street", "building"}
# Words after an `a` that is a name: "go to a then b".
_AFTER_LETTER = {*AFTER_VERB, ",", ".", "and", "or", "then", "before", "after", "until"}
# First words of the lexicon's phrases.
_PHRASE_STARTS = {
    words[0] for words, kind in TABLE.items() if kind not in ("filler", "addressed", "word")
}
_CUT_OFF = nouns.split_entries("don doesn didn isn aren wasn can won shouldn mustn couldn")
"""First part of a contraction whose `t` lost the apostrophe."""
_VERBS_TOO = """
    swing drop park dock point ring rest stick tap drill paint book fan bat saw scale tie train
    track frame file mop sponge exit guard
"""
_ALSO_VERBS = frozenset(_VERBS_TOO.split())
"""Words that name an object only after an article; else they are verbs."""
# Marks of an instruction → the words that stand for them.
_MARKS = {",": ",", ":": ",", ".": ".", ";": ".", "!": ".", "?": ".", "&": "and"}
_NEVER_NAMES = {*ARTICLES, *_MARKS.values(), "robot", "robots", "spot", "spots"}
_NEVER_ALONE = {"can"}  # a name only together with other words: "trash can"
_OWN = ("your", "our", "its", "my")
_WAYS = ("path", "way", "route", "road", "trip")  # after `_OWN`, no object to go to
_VEHICLES = """
    bus car train taxi cab bike bicycle motorcycle boat ship ferry plane airplane truck van tram
    subway elevator lift escalator wheelchair scooter foot
"""
_RIDING = ("by", "via", "per")  # a vehicle after them is a means of transport
_RIDDEN = frozenset(names.canonical(name) for name in _VEHICLES.split())
"""Objects that are a means of transport after "by" without an article."""
_PIECE = re.compile(rf"""(?P<quoted>"[^"]*")|(?P<word>{WORD.pattern})|(?P<mark>\S)""")


@dataclass(frozen=True, slots=True)
class DelexicalisedText:
    """A delexicalised instruction.

    Attributes:
        words: lower case, `NAMES[i]` for the object `names[i]`; the only marks are "," and ".".
        names: canonical names in order of first mention, each once.
        starts: for each word, the offset of its first character in the instruction.
    """

    words: tuple[str, ...]
    names: tuple[str, ...]
    starts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Piece:
    """A word, a mark or a quoted name of the instruction, and the offset of its first character."""

    text: str
    start: int
    quoted: bool = False


def delexicalise_text(text: str) -> DelexicalisedText:
    """Return the instruction with its names replaced by placeholders.

    Names are those that the grammar knows: the alias table, places and common objects with their
    qualities ("the small red box"), single letters, and texts in double quotes.

    Raises:
        TranslationError: the text is too long, has a character that is not allowed, or names more
            than `MOST_NAMES` objects.

    Example:
        >>> delexicalise_text("Go to the bed, then to the sofa.").words
        ('go', 'to', '<0>', ',', 'then', 'to', '<1>', '.')
    """
    pieces = _split_pieces(text)
    letters_are_names = _has_letter_names(pieces)
    words: list[str] = []
    starts: list[int] = []
    found: list[str] = []
    at = 0
    while at < len(pieces):
        length, name = _name_at(pieces, at, letters_are_names)
        if name in _RIDDEN and words and words[-1] in _RIDING:
            start = pieces[at].start
            raise not_understood(
                text[start:], start + 1, "say where to go, without the means of transport"
            )
        if name is None:
            words.append(pieces[at].text)
            starts.append(pieces[at].start)
            at += 1
            continue
        if name not in found:
            if len(found) == MOST_NAMES:
                hint = f"an instruction has at most {MOST_NAMES} objects"
                raise not_understood(text[pieces[at].start :], pieces[at].start + 1, hint)
            found.append(name)
        if words and words[-1] in ARTICLES:
            words.pop()
            starts.pop()
        words.append(NAMES[found.index(name)])
        starts.append(pieces[at].start)
        at += length
    return DelexicalisedText(tuple(words), tuple(found), tuple(starts))


def _split_pieces(text: str) -> list[_Piece]:
    """Return the words, marks and quoted names of a text; errors as in `delexicalise_text`."""
    if len(text) > MAX_CHARS:
        hint = f"an instruction has at most {MAX_CHARS} characters"
        raise not_understood(text[MAX_CHARS:], MAX_CHARS + 1, hint)
    pieces: list[_Piece] = []
    for match in _PIECE.finditer(text.translate(STRAIGHT)):
        found, start = match.group(), match.start()
        if match["quoted"] is not None:
            if not names.is_name(found[1:-1]):
                raise not_understood(found, start + 1, "no name")
            pieces.append(_Piece(found[1:-1], start, quoted=True))
        elif found.lower() == "t" and pieces and pieces[-1].text in _CUT_OFF:
            cut = pieces.pop()
            pieces += [_Piece(part, cut.start) for part in expand_word(f"{cut.text}'t")]
        elif match["word"] is not None:
            pieces += [_Piece(part, start) for part in expand_word(found.lower())]
        elif found in _MARKS:
            pieces.append(_Piece(_MARKS[found], start))
        else:
            raise not_understood(
                found, start + 1, "this character is not allowed in an instruction"
            )
    if len(pieces) > MOST_PIECES:
        late = pieces[MOST_PIECES].start
        raise not_understood(text[late:], late + 1, f"it has more than {MOST_PIECES} words")
    return pieces


def _name_at(pieces: list[_Piece], at: int, letters_are_names: bool) -> tuple[int, str | None]:
    """Return the number of pieces and the canonical form of the name here, or (0, None)."""
    if pieces[at].quoted:
        return 1, names.canonical(pieces[at].text)
    if _is_letter(pieces, at, letters_are_names):
        return 1, pieces[at].text
    length = _known_length(pieces, at)
    if not length or _is_own_way(pieces, at) or _is_verb(pieces, at, length):
        return 0, None
    text = " ".join(piece.text for piece in pieces[at : at + length])
    preposition, skipped = _preposition_at(pieces, at + length)
    if _is_own_way(pieces, at + length + skipped):
        preposition = ""  # "the table on your path"
    if preposition and (more := _known_length(pieces, at + length + skipped)):
        where = pieces[at + length + skipped : at + length + skipped + more]
        other = " ".join(piece.text for piece in where)
        text = f"{names.normalise(text)} {preposition} {other}"
        length += skipped + more
    return (length, names.canonical(text)) if names.is_name(text) else (0, None)


def _is_verb(pieces: list[_Piece], at: int, length: int) -> bool:
    """Return True if "lift the …" begins here, in which "lift" is a verb."""
    begins = at == 0 or pieces[at - 1].text in (",", ".", "and", "then", "please")
    following = pieces[at + length].text if at + length < len(pieces) else ""
    return begins and length == 1 and following in ARTICLES


def _is_own_way(pieces: list[_Piece], at: int) -> bool:
    """Return True if "your path" ends here, which is no object to go to."""
    own = 0 < at < len(pieces) and pieces[at - 1].text in _OWN
    return own and pieces[at].text in _WAYS


def _known_length(pieces: list[_Piece], at: int) -> int:
    """Return the length in pieces of the longest name of known words that begins here."""
    after_determiner = at > 0 and pieces[at - 1].text in _DETERMINERS
    for length in range(min(LONGEST_NAME, len(pieces) - at), 0, -1):
        run = pieces[at : at + length]
        texts = [piece.text for piece in run]
        if any(piece.quoted for piece in run) or nouns.unknown_in(texts) is not None:
            continue
        if _NEVER_NAMES & set(texts) or not _begins_name(texts, after_determiner):
            continue
        return length
    return 0


def _begins_name(texts: list[str], after_determiner: bool) -> bool:
    """Return True if these words name an object here; "first" and "check" mostly do not."""
    if texts[0] in _NEVER_ALONE and len(texts) == 1:
        return False
    if after_determiner:
        return True
    if texts[0] in nouns.ORDINALS:
        return any(text in _STORIES for text in texts)
    if texts[0] in _ALSO_VERBS:
        return False
    kind = TABLE.get((texts[0],))
    return (len(texts) > 1 and texts[0] in nouns.QUALITIES) or kind in (None, "word", "group")


def _is_letter(pieces: list[_Piece], at: int, letters_are_names: bool) -> bool:
    """Return True if a single letter here is a name; `a` is mostly an article."""
    text = pieces[at].text
    if len(text) != 1 or not text.isalpha() or not text.isascii() or text == "i":
        return False
    if text != "a":
        return True
    after = pieces[at + 1] if at + 1 < len(pieces) else _Piece(".", 0)
    if after.quoted or (len(after.text) > 1 and _known_length(pieces, at + 1)):
        return False
    return after.text in _AFTER_LETTER or (
        letters_are_names and (len(after.text) == 1 or after.text in _PHRASE_STARTS)
    )


def _has_letter_names(pieces: list[_Piece]) -> bool:
    """Return True if letters are names in this text, so that `a` may be one too.

    Letters are names if one other than a, i and s occurs, or if the text has no other name.
    """
    if any(p.text not in "ais" and len(p.text) == 1 and p.text.isalpha() for p in pieces):
        return True
    return not any(_known_length(pieces, at) for at in range(len(pieces)))


def _preposition_at(pieces: list[_Piece], at: int) -> tuple[str, int]:
    """Return a preposition of place here, and the number of pieces of it and its article."""
    for preposition in _PREPOSITIONS:
        words = preposition.split()
        comes = [p.text for p in pieces[at : at + len(words)]] == words
        if comes and preposition not in _OF_NO_NAME:
            end = at + len(words)
            article = end < len(pieces) and pieces[end].text in ARTICLES
            named = pieces[end + article].text if end + article < len(pieces) else ""
            if named in _WAYS:
                return "", 0  # "the lamp on your path"
            return preposition, len(words) + article
    return "", 0
