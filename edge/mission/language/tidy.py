"""Removal of what speech adds to an order: hesitations, politeness, self-corrections, reasons.

`tidy_up` is the first step with an utterance; the module `intents` then classifies the rest.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from edge import number_words
from edge.mission.language.remarks import SUBORDINATE, is_remark
from edge.mission.language.words.clock_times import write_times
from edge.mission.language.words.everyday_words import ARTICLE, NAME, phrase_of
from edge.mission.language.words.lexicon import TABLE
from edge.mission.language.words.spans import number_of
from edge.mission.language.words.spelling import WORD, expand_word
from edge.mission.language.words.tokens import MAX_CHARS, STRAIGHT, not_understood

_QUOTED = re.compile(r'"[^"]*"')
_ARROW = re.compile(r"\s*(?:[-=]+>|[→➔➜])\s*")
_BULLET = re.compile(r"(?:^|[.,;]*\n)\s*[-*•]\s+")
_FIRST_MARK = 0xE000  # private characters stand for quotations
# Spelling of speech → full words.
_SPOKEN = {"its": "it is", "u": "you", "id": "i would", "till": "until",
           "whichever's": "whichever is", "gotta": "must"}  # fmt: skip
# "the door's painted" has "is" only at the end of a clause: "the robot's painted door" is the
# robot's. "room 3's painted" and the listed words have it anywhere.
_APOSTROPHE_IS = re.compile(
    r"(?<=\w)'s (?=\w+ed\b(?! \w))|(?<=\d)'s (?=\w+ed\b)|"
    r"(?<=\w)'s (?=(?:still|there|not|been|now|off limits|okay|ok|free|open|closed|clear|gone|"
    r"fine|enough|good|over|up|"
    r"asleep|here|wet|dirty|sick|hot|cold|dark|\w+ing|"
    r"finished|done|coming|going|backing|blocked|busy)\b|"
    rf"(?:the|an?|my|our) |{phrase_of('relation')} )",
    re.I,
)
"""An `'s` that means "is": "the kitchen's closed"."""
_HESITATION = re.compile(
    rf"(?:(?P<comma>, )|(?<![\w'])){phrase_of('hesitation')}(?![\w'-]),?(?= |$)", re.I
)
# Words that a speaker may say twice: "the the".
_SMALL = (
    "(?:the|an?|my|room|to|and|or|in|into|of|on|at|i|you|we|he|she|they|it|is|am|are|was|were|there|this|"
    "that|here|for|then|with|where|what|can|could|would|do|did|have|please|go|come|find|look|stop|"
    "wait|no|not|never|me|from|ever|with|without)"
)
# First words of a clause that a speaker may begin twice: "go to go to".
_BEGINS = (
    "(?:where|what|go|come|is|are|was|did|do|have|can|could|find|look|stop|wait|check|explore|visit|"
    "patrol|drive|get|show|tell|return|search)"
)
_REPEATED = re.compile(
    rf"(?<![\w'-])(?:({_SMALL}(?: {_SMALL}){{0,3}}|the [\w']+)(?: \1(?![\w'-]))+"
    rf"|({_BEGINS}(?: (?!(?:and|or|then)\b)[\w']+){{0,3}})(?: the| an?| my)?(?:,? \2(?![\w'-]))+)",
    re.I,
)
"""Words that a speaker says twice: "where is the where is the", "explore hall, explore hall"."""
_LIKE = re.compile(
    r"\b(?:(?<!would )like(?!(?<=, like) an? \w+[.!?]*$)|(?<!do )(?<!so )(?<!that )you know),? "
    rf"(?=\d|{ARTICLE}\b|{'|'.join(number_words.SMALL_NUMBERS)}|(?:go|drive|come|find|look|check|if|whether)\b)",
    re.I,
)
"""The filler of "go to, like, the bed", and not that of "I would like the bed"."""
# The middle of "the bed, sorry, the sofa" and "the bed, no, the sofa".
_CORRECTION = (
    rf"[ ,.]*(?:\b(?:{phrase_of('correction')}|(?<=[,.] )make it(?= (?:the|an?|room)\b))\b[ ,.]*)+"
    r"|,? no,? (?=(?:the|to|go|not the|room|in)\b)"
)
_CORRECTS = re.compile(_CORRECTION, re.I)
# Words that a correction may not take away: without them, a ban or a condition would mean more.
_LIMITS = re.compile(
    r"\b(?:before|after|until|unless|if|when|while|not|never|without|except)\b", re.I
)
# Removed at the start, in lines from the top: "be a pirate and", "could you please", "I want you"
# before "go", the "you" of "you go to the bed", the "do" of "do go". Kept: the "can you" of
# "can you see a mug", the "let us" of "let us play", the "you" of "you may go".
_OPENING = re.compile(
    rf"(?:(?:let us play|pretend (?:(?:that )?you are|to be)|be) {NAME} and(?: you)? |"
    rf"(?!let us play\b)(?:{phrase_of('opening')}\b(?!(?<=you) see\b(?! (?:if|whether)\b))|"
    r"i (?:want|need) you (?=go|come|find|look|drive|check|wait)|"
    r"you (?!got|may|can|are|will|must|should|have|could|were)|"
    r"do (?=(?:go|come|find|check|look|hunt|have|please|you mind|stop|wait)\b))[ ,.!]*)+",
    re.I,
)
_CLOSING = re.compile(rf"(?:[ ,.!?]*\b{phrase_of('closing')})+[ .!?]*$", re.I)
_ADDRESS = re.compile(r", (?:my )?(?:dear|love|darling|mate|buddy|friend|robot),", re.I)
# Also the "to" of "please to find it", but not that of "please to the bed".
_PLEASE = re.compile(r" ?\b(?:pretty )?please(?: to(?! the\b))?\b(?P<comma>,?) ?", re.I)
# No closing phrase is removed after such an end: "the robot" stays complete.
_ENDS_IN_ARTICLE = re.compile(r"\b(?:the|an?|my|our|your)$", re.I)
# "do not go to the sofa quickly" does not forbid the sofa.
_FORBIDS_HASTE = re.compile(
    r"\b(?:not|never|without)\b[^.;!?,]* (?:quick|quickly|fast|carefully)[ .!?]*$", re.I
)
_CLAUSE_END = re.compile(r"[.!?;,]|\b(?:and|then|but|or)\b", re.I)
# Words that may refer to a name in another clause.
_REFERS = re.compile(
    r"\b(?:it|they|them|he|she|him|her|ones?|there|in again|enter again|is that)\b", re.I
)


@dataclass(frozen=True, slots=True)
class TidySpeech:
    """An utterance without what speech adds to it."""

    text: str  # the rest, in one line. A private Unicode character stands for each quotation
    reasons: tuple[str, ...] = ()  # the clauses that were left out because they give no order
    repaired: bool = False  # True if the speaker corrected or repeated words
    # the quotations in double quotes, in the order of their private characters
    quoted: tuple[str, ...] = ()

    def with_quotations(self, text: str) -> str:
        """Return a text with the quotations in place of their private characters."""
        for i, quotation in enumerate(self.quoted):
            text = text.replace(chr(_FIRST_MARK + i), quotation)
        return text


def tidy_up(utterance: str) -> TidySpeech:
    """Return the utterance in plain words, step by step.

    Raises:
        TranslationError: the text is too long, or a self-correction in it is unclear.

    Example:
        >>> tidy_up("Um, could you go to the kitchen, no sorry, the bathroom, please.").text
        'go to the bathroom.'
    """
    if len(utterance) > MAX_CHARS:
        hint = f"an instruction has at most {MAX_CHARS} characters"
        raise not_understood(utterance[MAX_CHARS:], MAX_CHARS + 1, hint)
    quoted: list[str] = []

    def hide(found: re.Match[str]) -> str:
        quoted.append(found[0])
        return chr(_FIRST_MARK + len(quoted) - 1)

    text = " ".join(_join_list(_QUOTED.sub(hide, utterance.translate(STRAIGHT))).split())
    text = _APOSTROPHE_IS.sub(" is ", WORD.sub(_expand, text))
    text = write_times(text)
    text = " ".join(_HESITATION.sub(_keep_if_it_corrects, text).split())
    text = _ADDRESS.sub(",", text)
    text = _PLEASE.sub(_comma_if_within, text).strip() or text
    text = re.sub(r"^(go|come|drive) you\b", r"\1", text, flags=re.I)  # "go you to the bed"
    # "could you like find it"
    text = re.sub(r"\b((?:could|can|would) you) like (?!to\b)", r"\1 ", text, flags=re.I)
    text = re.sub(r"\b(?:would|do) you mind (\w+)ing\b", _base_form, text, flags=re.I)
    text = re.sub(r"[ ,]+:(?= )", ":", text)  # "find , : the bed"
    unrepeated = _REPEATED.sub(r"\1\2", text)
    uncorrected = strip_politeness(_LIKE.sub("", unrepeated))
    text_after_corrections = _apply_corrections(uncorrected)
    kept, reasons = split_off_reasons(text_after_corrections)
    kept = re.sub(r"[ ,;:]+([.!?])", r"\1", strip_politeness(kept))
    repaired = unrepeated != text or text_after_corrections != uncorrected
    return TidySpeech(kept, reasons, repaired, tuple(quoted))


def _join_list(text: str) -> str:
    """Return a list with arrows, numbers or bullets as a sequence: "1. the bed 2. the sofa"."""
    text = _ARROW.sub(", then ", text.strip())
    if bulleted := _BULLET.match(text):
        return _BULLET.sub(", then ", text[bulleted.end() :])
    mark, number = r"\s*", 1
    while item := re.match(rf"(?P<before>.*?){mark}{number}[.)]\s+", text, re.S):
        if number == 1 and item["before"]:
            break
        text = f"{item['before']}{', then ' * (number > 1)}{text[item.end() :]}"
        mark, number = r"[\s,;.]*\n\s*" if "\n" in text else r"[\s,;.]+", number + 1
    return text


def _expand(found: re.Match[str]) -> str:
    """Return the words of a contraction; other words stay as they are."""
    word = found[0]
    is_noun = re.search(rf"\b{ARTICLE} $", found.string[: found.start()], re.I)  # "the till"
    if (plain := _SPOKEN.get(word.lower())) and not is_noun:
        return plain
    parts = expand_word(word.lower())
    return " ".join(parts) if len(parts) > 1 else word


def _comma_if_within(found: re.Match[str]) -> str:
    """Return the comma of "stop please, that is enough", which ends a clause."""
    return ", " if found["comma"] and re.search(r"\w$", found.string[: found.start()]) else " "


def _base_form(found: re.Match[str]) -> str:
    """Return the verb of "would you mind going": `go`."""
    stem = found[1]
    forms = (stem, f"{stem}e", stem[:-1])
    return next((form for form in forms if TABLE.get((form.lower(),)) == "verb"), found[0])


def _keep_if_it_corrects(found: re.Match[str]) -> str:
    """Keep the hesitation of "the bed, er, the sofa", which may replace the bed."""
    rest, before = found.string[found.end() :], found.string[: found.start()]
    named_again = found["comma"] and re.match(rf" {ARTICLE}\b", rest, re.I)
    corrects = named_again and not re.search(r"\b(?:and|or|then|to|the|with)$", before, re.I)
    return found[0] if corrects else (found["comma"] or " ")


def strip_politeness(text: str) -> str:
    """Remove politeness and names of the robot at both ends."""
    before = None
    while before != text:
        before = text
        opened = _OPENING.match(text)
        text = text[opened.end() :] if opened and opened.end() < len(text) else text
        closed = _CLOSING.sub("", text)
        is_kept = not closed or _ENDS_IN_ARTICLE.search(closed) or _FORBIDS_HASTE.search(text)
        text = text if is_kept else closed
    return text.strip(" ,")


def _apply_corrections(text: str) -> str:
    """Return the text with each self-correction carried out: "the bed, sorry, the sofa"."""
    while found := _CORRECTS.search(text):
        before, after = text[: found.start()].rstrip(" ,"), text[found.end() :].lstrip(" ,")
        if not before or not after:
            return text
        begin = _find_replaced(before, after)
        if begin is None or _LIMITS.search(before[begin:]):
            hint = "unclear what this corrects; say the whole sentence again"
            raise not_understood(text[found.start() :].strip(), found.start() + 1, hint)
        text = before[:begin] + after
    return text


def _find_replaced(before: str, after: str) -> int | None:
    """Return the offset in `before` at which the words begin that `after` replaces.

    The replaced words begin with the first word of `after`, with a number if `after` does, or
    with the last name. None if no such word comes.
    """
    first = re.escape(after.split()[0].strip(",."))
    same = [found.start() for found in re.finditer(rf"\b{first}(?![\w'-])", before, re.I)]
    if same:
        return same[-1]
    if number_of(after.split()[0]) is not None:
        words = re.finditer(r"[\w-]+", before)
        numbers = [word.start() for word in words if number_of(word[0]) is not None]
        return numbers[-1] if numbers else None
    name = re.match(rf"{NAME}$", _CLAUSE_END.split(after)[0].strip(), re.I)
    articles = list(re.finditer(rf"\b{ARTICLE} ", before, re.I))
    if name and articles and re.fullmatch(NAME, before[articles[-1].start() :], re.I):
        has_article = re.match(rf"{ARTICLE} ", after, re.I)
        return articles[-1].start() if has_article else articles[-1].end()
    return None


def split_off_reasons(text: str) -> tuple[str, tuple[str, ...]]:
    """Split off the clauses that give no order: "I heard a noise", "so you know your way".

    They are called reasons here, and `is_remark` finds them. Nothing is split off if no other
    clause would be left, or if a later clause may refer to a name in a reason ("the mug is dirty,
    find it").

    Returns:
        The other clauses as one text, and the reasons.
    """
    # Clauses are at even indices, the marks between them at odd ones.
    pieces = re.split(rf"([.!?;,]+ |{SUBORDINATE})", text, flags=re.I)
    # `kept` has the indices of the other clauses; `refers`: one of them may refer to a reason.
    kept, reasons, refers = [], [], False
    for at in range(0, len(pieces), 2):
        clause = pieces[at].strip(" .!?;")
        piece = clause if is_remark(clause, first=not at) else strip_politeness(clause)
        if is_remark(piece, first=not at) and len(pieces) > 1:
            reasons.append(piece)
        else:
            kept.append(at)
            refers = refers or bool(reasons and _REFERS.search(pieces[at]))
    if not reasons or not kept or refers:
        return text, ()
    joined = "".join(pieces[at] + (pieces[at + 1] if at + 1 < len(pieces) else "") for at in kept)
    return joined.strip(" ,;"), tuple(reasons)
