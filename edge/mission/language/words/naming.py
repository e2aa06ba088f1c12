"""Parser of one name in an instruction.

    name = [article] word { word } | letter | '"' text '"'

`a` is an article if a longer word follows. The module `nouns` defines the possible words of a name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from edge import names, number_words
from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import AFTER_VERB
from edge.mission.language.words.tokens import Token, TokenReader, not_understood
from edge.text import one_line

# Words that no name has.
_NOT_NAMES = """
    anywhere nowhere everywhere somewhere none nothing everything more less most leave leaving
    among exit mean means if than which who whose whom what how why where about because not very
    again here else anything something anyone someone everyone nobody otherwise except unlike
    soon fast quickly slowly carefully today tomorrow tonight exactly really maybe perhaps
    instead another spot spots position point
    """
_REVERSING = (
    "except", "instead", "otherwise", "unlike", "than", "because", "if", "not", "another",
    "nowhere",
)  # fmt: skip
"""Words that reverse a meaning, so no other translator may guess at the sentence."""
_NEVER_IN_NAMES = frozenset(_NOT_NAMES.split())


def take_name(reader: TokenReader) -> str:
    """Parse a name and return its canonical form."""
    start = reader.peek()
    said = reader.take("article")
    article = said is not None
    if said and said.text.endswith(" to"):  # "any visit to the sofa"
        reader.take("article")
    if is_indefinite(reader):
        reader.take("word")
        article = True
    if token := reader.take("quoted"):
        return _canonical(reader, token.text, token)
    if is_letter(reader.peek()):
        if _is_probably_article(reader):
            reader.refuse("not a known object", start)
        return _take_token(reader).text
    words = _take_words(reader, article)
    if not words:
        refuse_missing_name(reader, start)
    _check_words(reader, words)
    if reader.is_at("article"):
        reader.refuse("unknown word", words[0])
    text = _join_words(words)
    return _canonical(reader, text, words[0])


def refuse_missing_name(reader: TokenReader, start: Token | None = None) -> NoReturn:
    """Refuse an instruction without a name at `start`, by default the next token."""
    start = start or reader.peek()
    if start.text == "the robot":
        reader.refuse_finally("this is the robot itself; say 'a robot' for another one", start)
    reader.refuse("expected the name of an object here", start)


def _take_words(reader: TokenReader, article: bool) -> list[Token]:
    """Take the words of a name; after an article it may begin with a verb."""
    words: list[Token] = []
    while reader.is_at("word", "group") and not is_letter(reader.peek()):
        # A particle ends the name, except directly after an article before a noun: "the back door".
        is_quality = article and not words and nouns.is_noun(reader.peek(1).text)
        if (reader.peek().text in AFTER_VERB and not is_quality) or _says_number(reader):
            break
        words.append(_take_token(reader))
    if words:
        words += _take_number(reader)
    return words


def _take_number(reader: TokenReader) -> list[Token]:
    """Take the number after a name, which may have two words: `12`, `twenty one`."""
    reader.at += _says_number(reader)  # skip the word "number"
    begin = reader.at
    pair = [reader.peek().text, reader.peek(1).text]
    if number_words.number(pair) is not None and is_number(reader, 1):
        reader.at += 2
    elif is_number(reader) or (is_letter(reader.peek()) and _is_lettered(reader)):
        reader.at += 1
    return reader.tokens[begin : reader.at]


def _says_number(reader: TokenReader) -> bool:
    """Return True if the next token is "number" before a number, as in "room number 12"."""
    return reader.peek().text == "number" and is_number(reader, 1)


def _is_lettered(reader: TokenReader) -> bool:
    """Return True if the letter here belongs to the word before it: "gate b"."""
    article = reader.peek().text == "a" and _is_article_a(reader)
    return reader.peek(-1).text in nouns.NUMBERED and not article


def _join_words(words: list[Token]) -> str:
    """Return the text of a name: "landmarks one" becomes "landmark one"."""
    texts = [token.text for token in words]
    numbered = next((i for i, token in enumerate(words) if i and token.kind == "number"), 0)
    if numbered:
        texts[numbered - 1] = names.singular(texts[numbered - 1])
    return " ".join(texts)


def _take_token(reader: TokenReader) -> Token:
    """Take the next token, of any kind."""
    reader.at += 1
    return reader.tokens[reader.at - 1]


def is_indefinite(reader: TokenReader) -> bool:
    """Return True if an `a` or `an` comes that is an article."""
    return reader.is_at("word") and reader.peek().text in ("a", "an") and _is_article_a(reader)


def _is_article_a(reader: TokenReader) -> bool:
    """Return True if `a` is an article: a longer word or a quoted name follows it."""
    follower = reader.peek(1)
    return follower.kind == "quoted" or (
        follower.kind == "word" and len(follower.text) > 1 and follower.text not in AFTER_VERB
    )


def _is_probably_article(reader: TokenReader) -> bool:
    """Return True if `a` is probably an article, as in "a walk".

    It is one if the instruction has no other one-letter name.
    """
    if reader.peek(-1).text == "be":  # "be a dear"
        return True
    if not reader.is_at("verb", "times", "immediately", "filler", "addressed", ahead=1):
        return False
    if reader.peek(1).text.startswith("at "):  # "avoid a at all costs"
        return False
    return not any(is_letter(token) and token.text != "a" for token in reader.tokens)


def is_letter(token: Token) -> bool:
    """Return True if a token is a single letter, which may be a name: "visit a"."""
    return token.kind == "word" and len(token.text) == 1 and token.text.isalpha()


def _check_words(reader: TokenReader, words: list[Token]) -> None:
    """Refuse a name with a word that no name has, or that is not known."""
    texts = [token.text for token in words]
    wrong = next((i for i, text in enumerate(texts) if text in _NEVER_IN_NAMES), None)
    if wrong is not None:
        hint = "unknown word, and not an object"
        if texts[wrong] in _REVERSING:
            reader.refuse_finally(hint, words[wrong])
        reader.refuse(hint, words[wrong])
    wrong = nouns.unknown_in(texts)
    if wrong is None:
        return
    if texts[wrong] in nouns.PLAIN_WORDS:
        said = reader.text[words[wrong].start : words[wrong].end]
        raise not_understood(said, words[wrong].start + 1, "unknown word, and not an object")
    close = nouns.suggest_word(texts[wrong])
    if close and not nouns.is_noun(texts[wrong]):
        reader.refuse(f"{one_line(texts[wrong], 40)}: {close}?", words[wrong])
    if reader.is_at("article", "pronoun"):
        reader.refuse("unknown verb", words[0])
    others = ((text, nouns.suggest_word(text)) for text in texts)
    if slip := next((f"{one_line(text, 40)}: {near}?" for text, near in others if near), ""):
        reader.refuse(slip, words[0])
    whole = one_line(" ".join(texts), 40)
    if wrong:
        last = one_line(texts[wrong - 1], 20)
        hint = f'unknown word after {last!r}; if it is one object, write "{whole}"'
        reader.refuse(f"{hint} in double quotes", words[wrong])
    reader.refuse(f'not a known object; if it is one, write "{whole}" in double quotes', words[0])


def _canonical(reader: TokenReader, text: str, token: Token) -> str:
    try:
        return names.canonical(text)
    except names.NotANameError as error:
        reader.refuse(f"no name: {str(error).rpartition(' is no name: ')[2]}", token)


def number_ahead(reader: TokenReader, last: Sequence[Sequence[str]]) -> Token | None:
    """Return the token that joins "1" and "2" in "landmarks 1 and 2"; None for no such list.

    `last` has the groups of the list's element before this token; here it has one name.
    """
    head = _numbered_head(last[-1][-1])
    ahead = 1 if reader.is_at("comma") else 0
    if reader.is_at("and", "or", ahead=ahead):
        ahead += 1
    is_list = head and len(last) == 1 and ahead
    return reader.peek(ahead - 1) if is_list and is_number(reader, ahead) else None


def next_numbered(reader: TokenReader, last: Sequence[Sequence[str]]) -> str:
    """Parse `2` after "landmark 1", and return "landmark two"."""
    reader.skip("comma", "and", "or")
    token = reader.peek()
    number = " ".join(said.text for said in _take_number(reader))
    return _canonical(reader, f"{_numbered_head(last[-1][-1])} {number}", token)


def _numbered_head(name: str) -> str:
    """Return `landmark` of "landmark one", `floor` of "first floor"; "" for other names."""
    first, _, last = name.rpartition(" ")
    return first if number_words.number([last]) is not None else ""


def is_number(reader: TokenReader, ahead: int = 0) -> bool:
    """Return True if the token `ahead` is a number that belongs to a name.

    In "two times" and "one or two times" it counts visits.
    """
    if not reader.is_at("number", ahead=ahead) or reader.is_at("times", "or more", ahead=ahead + 1):
        return False
    if reader.is_at("or", ahead=ahead + 1) and reader.is_at("times", ahead=ahead + 3):
        return False  # "one or two times"
    pair = [reader.peek(ahead).text, reader.peek(ahead + 1).text]
    if number_words.number(pair) is not None and reader.is_at("times", ahead=ahead + 2):
        return False  # "twenty one times"
    return not reader.is_at("group", ahead=ahead + 1)  # "two places" counts places
