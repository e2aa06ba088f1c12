"""Parser of noun phrases: names, alone, in lists and in choices.

    objects  = element { ("," | "and" | "or" | ", and" | ", or") element }
    element = "either" name { ("," | "or") name } | "one of" names | ["all of"] name | pronoun

Single letters need no comma between them ("visit a b and c"). The module `naming` parses names.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import AFTER_VERB
from edge.mission.language.words.naming import (
    is_letter,
    is_number,
    next_numbered,
    number_ahead,
    take_name,
)
from edge.mission.language.words.tokens import Token, TokenReader

COUNTING = ("number", "once", "times n", "at least", "at most", "exactly", "only")
"""Kinds of token that can begin a count."""
LEAVE = ("leave", "leaving", "exit", "exiting")  # never names
# Hint of a refusal.
ONE_OF_A_KIND = "the robot can go to one object of a kind; say 'the …'"
_ONE_OF = ("one of", "either of", "either one of", "at least one of")
# Pronouns for several objects, and for one.
PLURALS = ("them", "these", "those")
SINGULARS = ("it", "this", "that", "that one", "this one")
_ELEMENT_KINDS = ("word", "quoted", "article", "either", "all of", "pronoun", "group")
_STARTS_PREDICATE = ("be", "must", "can", "happen", "banned")


@dataclass(frozen=True, slots=True)
class NounPhrase:
    """A noun phrase: all groups, any one name of each group.

    ((chair, sofa), (bed,)) is "either a chair or a sofa, and a bed".

    Attributes:
        groups: names, by group; one name of each group must be reached.
        listed: True for two or more groups without "and" or "or" between them.
        every: "them" ("any of them") or "places" ("each place") if the phrase means all goals so
            far; "" for other phrases.
    """

    groups: tuple[tuple[str, ...], ...]
    listed: bool = False
    every: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Every name once, in order."""
        return tuple(dict.fromkeys(name for group in self.groups for name in group))


@dataclass(slots=True)
class Antecedents:
    """The antecedents of pronouns."""

    named: NounPhrase | None = None  # the objects named last
    asked: NounPhrase | None = None  # the objects of the last goal
    previous: NounPhrase | None = None  # the objects of the goal before it
    every: tuple[tuple[str, ...], ...] = ()  # all goals so far, in order
    mentioned: dict[str, None] = field(default_factory=dict)  # all names so far, in any role
    # names in the plural, with their tokens
    several: dict[str, Token] = field(default_factory=dict)

    def ask(self, targets: NounPhrase) -> None:
        """Store the objects of a new goal."""
        self.previous, self.asked = self.asked, targets
        self.note(targets.groups)

    def note(self, groups: Sequence[tuple[str, ...]]) -> None:
        """Add objects to the goals so far."""
        self.every = tuple(dict.fromkeys((*self.every, *groups)))


def starts_noun_phrase(reader: TokenReader, ahead: int = 0) -> bool:
    """Return True if a noun phrase can begin at the token `ahead`."""
    token = reader.peek(ahead)
    if token.kind in ("number", "article") and reader.is_at("group", ahead=ahead + 1):
        return True
    return token.kind in _ELEMENT_KINDS and not (token.kind == "word" and token.text in AFTER_VERB)


def take_noun_phrase(
    reader: TokenReader,
    memory: Antecedents,
    subject: bool = False,
    banned: bool = False,
    way: bool = False,
) -> NounPhrase:
    """Parse the noun phrase that begins here.

    Args:
        reader: the token reader.
        memory: antecedents of pronouns.
        subject: True if a predicate is expected to follow, so that it does not end the list early.
        banned: True if "and" and "or" mean the same ("avoid a and b", "never visit a or b").
        way: True if the objects are passed through, so that "and to b" ends the list.

    Raises:
        TranslationError: no noun phrase, or an ambiguous one.
    """
    start = reader.peek()
    if every := _take_collective(reader, memory):
        if every == "them" and not memory.every and len(memory.mentioned) == 2:
            return NounPhrase(tuple((name,) for name in memory.mentioned), every=every)
        return NounPhrase(memory.every, every=every)
    elements = [_take_element(reader, memory)]
    between: list[Token] = []  # one token between each two elements
    kinds_between: set[str] = set()  # of all tokens between elements
    while True:
        if (number := number_ahead(reader, elements[-1])) is not None:
            between.append(number)
            elements.append(((next_numbered(reader, elements[-1]),),))
            continue
        ahead = _joint_length(reader)
        if ahead is None or (way and reader.peek(ahead - 1).kind == "to"):
            break
        is_alternative = reader.is_at("comma") and reader.is_at("or", ahead=1)
        if is_alternative and not banned and "comma" not in kinds_between:
            break  # "the bed, or the sofa": an alternative to all before it
        joined = any(reader.is_at("and", "or", ahead=i) for i in range(ahead))
        if not joined and reader.is_at("to", ahead=ahead - 1):
            break  # "not the elevator, to the second floor"
        if not banned and joined and _has_its_own_time(reader, ahead):
            break  # "…, and the bathroom after the hallway"
        kinds_between |= {reader.peek(i).kind for i in range(ahead)}
        if not subject and _is_subject(reader, ahead):
            break
        # Of ", and to", note the "and".
        joint = next((i for i in range(ahead) if reader.is_at("and", "or", ahead=i)), 0)
        between.append(reader.peek(joint))
        reader.at += ahead
        elements.append(_take_element(reader, memory))
    groups = [group for element in elements for group in element]
    memory.mentioned |= {name: None for group in groups for name in group}
    joints = {token.kind for token in between} & {"and", "or"}
    if len(set(groups)) < len(groups):
        reader.refuse("the same object is named twice", start)
    if banned and (start.text in _ONE_OF or (start.text == "either" and "and" in joints)):
        reader.refuse_finally("say which to avoid", start)
    if start.kind == "all of" and len(groups) == 1 and not banned:
        reader.refuse_finally(ONE_OF_A_KIND, start)
    if banned:
        return NounPhrase(tuple((name,) for group in groups for name in group))
    if joints == {"or"} and start.text == "both":
        reader.refuse_finally("unclear: both, or one of them? say which", start)
    if joints == {"or"}:
        return NounPhrase((tuple(dict.fromkeys(name for group in groups for name in group)),))
    if len(joints) > 1:
        fork = next(token for token in between if token.kind == "or")
        reader.refuse_finally("it mixes 'and' with 'or'; say it in two sentences", fork)
    return NounPhrase(tuple(groups), listed=len(groups) > 1 and not joints)


def _joint_length(reader: TokenReader) -> int | None:
    """Return the number of tokens before the next element of the list; None if the list ends."""
    if is_letter(reader.peek(-1)) and is_letter(reader.peek()):
        return 0
    ahead = 1 if reader.is_at("comma") else 0
    if reader.is_at("and", "or", ahead=ahead):
        ahead += 1
    if ahead and reader.is_at("to", ahead=ahead):
        if reader.peek(ahead).text in ("into", "onto"):
            return None  # "through a and into b" is an order
        ahead += 1
    adjuncts = (*COUNTING, "without", "while")
    if reader.is_at("all of", ahead=ahead) and reader.is_at(*adjuncts, ahead=ahead + 1):
        return None  # "a and b, each only once", "all without passing c"
    if reader.peek(ahead).text in ("it", *LEAVE):
        return None  # "go to a and it must go to b"
    return ahead if ahead and starts_noun_phrase(reader, ahead) else None


def _has_its_own_time(reader: TokenReader, ahead: int) -> bool:
    """Return True if the element there has its own "after" or "before" ("… and b after c")."""
    while reader.is_at("word", "quoted", "article", "place", "group", ahead=ahead):
        ahead += 1
    if reader.peek(ahead).text in ("after that", "afterwards", "later"):
        return reader.is_at("comma", "stop", "end", ahead=ahead + 1)
    own = reader.is_at("after", "before", ahead=ahead)
    own = own and not reader.is_at("comma", "stop", "end", "and", ahead=ahead + 1)
    before = reversed(reader.tokens[: reader.at])
    same = itertools.takewhile(lambda token: token.kind not in ("stop", "then"), before)
    return own and any(token.kind in ("after", "before") for token in same)  # "a after b, and …"


def _is_subject(reader: TokenReader, ahead: int) -> bool:
    """Return True if the element there is the subject of another clause ("… and b is visited")."""
    while reader.is_at("word", "quoted", "article", "place", "all of", "group", ahead=ahead):
        ahead += 1
    return reader.is_at(*_STARTS_PREDICATE, ahead=ahead)


_EARLIER = ("previous", "previously", "visited", "earlier", "one", "already", "other")
_BEEN = (
    ("you", "have", "visited"), ("you", "have", "been", "to"), ("you", "have", "been"),
    ("visited",), ("so", "far"), ("before",), ("already",),
    ("once", "you", "have", "been", "there"), ("after", "you", "have", "been", "there"),
    ("once", "after", "you", "have", "been", "there"),
)  # fmt: skip


def _take_collective(reader: TokenReader, memory: Antecedents) -> str:
    """Parse `each place`, `any of them`, `previously visited locations`; return "" if not found."""
    ahead = 0
    while reader.is_at("all of", "either", "article", ahead=ahead) or (
        reader.peek(ahead).text in _EARLIER
    ):
        ahead += 1
    first, last = reader.peek(), reader.peek(ahead)
    of_them = last.text in PLURALS and ahead > 0 and first.kind in ("all of", "either")
    of_them = of_them and first.text not in _ONE_OF
    follows = ("must", "be", "can", "comma", "stop", "end")
    both = first.text in ("both", "all") and not reader.is_at("not", ahead=-1)  # "but not both"
    if ahead == 1 and both and reader.is_at(*follows, ahead=1):
        of_them, ahead = True, 0  # "both must be visited", "visit both"
    if last.text in PLURALS and reader.peek(ahead + 1).text == ":":
        return ""  # "at least one of these: a, b and c"
    named = memory.named.groups if memory.named else ()
    if of_them and len(named) > 1 and named != memory.every:
        return ""  # those named last
    places = last.kind == "group" and (ahead > 0 or reader.is_at("out of turn", ahead=1))
    if not (of_them or places):
        return ""
    if starts_noun_phrase(reader, ahead + 1) or is_number(reader, ahead + 1):
        return ""  # "each of the places a and b"
    reader.at += ahead + 1
    while phrase := next((words for words in _BEEN if _has_words(reader, words)), None):
        reader.at += len(phrase)
    return "them" if of_them else "places"


def _has_words(reader: TokenReader, words: Sequence[str]) -> bool:
    return all(reader.peek(i).text == word for i, word in enumerate(words))


def _objects_of(token: Token, reader: TokenReader, memory: Antecedents) -> NounPhrase:
    """Return the objects of a pronoun; "them" after a single object means all goals so far."""
    meant = (token.text == "there" and memory.asked) or memory.named
    if token.text in SINGULARS and meant and len(meant.groups) > 1:
        reader.refuse_finally("unclear which one this refers to", token)
    if token.text in PLURALS and meant and len(meant.groups) == 1 and len(memory.every) > 1:
        meant = NounPhrase(memory.every)
    if meant is None or not meant.groups:
        reader.refuse(f"{token.text!r} refers to nothing that was named before", token)
    return meant


def _take_element(reader: TokenReader, memory: Antecedents) -> tuple[tuple[str, ...], ...]:
    """Parse one element of a list and return its groups."""
    if reader.is_at("all of") and reader.peek(1).text in PLURALS and reader.peek(2).text == ":":
        reader.at += 3  # "all of these: a, b and c"
    elif reader.take("all of") or (reader.is_at("group", ahead=1) and not _is_singled(reader)):
        reader.skip("number", "article", "group", "comma")
    if not _is_singled(reader):
        reader.skip("group")
    if token := reader.take("pronoun"):
        meant = _objects_of(token, reader, memory).groups
        if reader.is_at("all of") and reader.is_at("comma", "stop", "end", "and", ahead=1):
            reader.at += 1  # "them both"
        return meant
    if token := reader.take("either"):
        return (_take_choice(reader, whole_list=token.text != "either"),)
    name = take_name(reader)
    last = reader.tokens[reader.at - 1]
    memory.several.pop(name, None)
    if last.kind == "word" and nouns.is_plural(last.text):
        memory.several[name] = last
    return ((name,),)


def _is_singled(reader: TokenReader) -> bool:
    """Return True if a number selects one of a kind here: "landmark two", "the second room"."""
    ahead = 1 if reader.is_at("article") else 0
    return reader.is_at("group", ahead=ahead) and is_number(reader, ahead + 1)


def _take_choice(reader: TokenReader, whole_list: bool) -> tuple[str, ...]:
    """Parse `either x, y or z`, which ends after "or z", or all of `one of x, y and z`."""
    if reader.take("all of"):
        reader.skip("group")
    if reader.peek().text in PLURALS and reader.peek(1).text == ":":
        reader.at += 1
    if not _is_singled(reader):
        reader.skip("group")
    if reader.peek().text == ":":
        reader.at += 1
    reader.take("to")
    options = [take_name(reader)]
    has_or = False
    while (ahead := _joint_length(reader)) is not None:
        joint = {reader.peek(i).kind for i in range(ahead)}
        if not whole_list and ((has_or and "or" not in joint) or "and" in joint):
            break
        has_or = has_or or "or" in joint
        reader.at += ahead
        options.append(take_name(reader))
    if not whole_list and not has_or:
        reader.refuse_finally("'either' needs a second choice")
    return tuple(dict.fromkeys(options))
