"""Recognition of remarks: clauses that give no order, such as "I heard a noise"."""

from __future__ import annotations

import re
from functools import lru_cache

from edge.mission.language.words.everyday_words import ARTICLE, phrase_of
from edge.mission.language.words.lexicon import PAST, TABLE
from edge.mission.language.words.templates import SentenceTemplate, compile_templates, first_match
from edge.mission.language.words.utterances import ASSENTS, IDIOMS, REMARKS, STATES

_MAY_DIRECT = re.compile(
    r"\b(?:want|need|like|love|wish|would|should|must|shall|robot|let|"
    r"only(?! (?:just|got|has|had))|except|unless|if|until|"
    r"before|after|instead|but|first|second|third|next|(?<!at )last|then|avoid|never|allow|allowed|"
    r"prefer|mean|meant|hop(?:e|ed|ing)|expect|"
    r"(?:leav|skip|keep|clos|block|lock|shut|bann|forbid|exclud|omit)\w*|bans?|sa(?:y|ys|ying|id)|"
    r"talking|thinking|wrong|mistaken?|done with|"
    r"insist|order|ask|tell|call|called|name|"
    r"named|remember|find|which|whichever|whatever|either|both|twice|times|rounds?|"
    r"ones?(?! \w+$| \w+ (?:is|are|has|have) )|"
    r"else|others?|rest|also|well|(?:minute|hour|second)s?(?! ago)|"
    r"limits|bounds|closed|taboo|private|go|stay|keep|you|"
    r"no|none|nobody|nothing|without)\b|"
    r"(?<!do )(?<!did )(?<!can )(?<!could )(?<!have )(?<!has )\bnot\b|"
    rf"\b(?:it|them)\b(?=.* {phrase_of('relation')} )|"
    rf"^(?:he|she|they) (?:is|are|was|were|will be)(?: \w+ly)? {phrase_of('relation')} ",
    re.I,
)
"""Words that may change an order, so a clause with one of them is no mere remark."""
# A word before the base form of a verb that makes it no verb: "a walk".
_BEFORE_NO_VERB = re.compile(
    rf"(?:{ARTICLE}|is|are|was|were|am|been|being|still|so|very|too|all|quite|really)$", re.I
)
SUBORDINATE = (
    r"(?<!soon)(?<!far)(?<!long) (?=(?:because|cause|since|while|as|so|so that) "
    r"(?:i|we|he|she|they|somebody|someone|people|there|my|our)\b|"
    r"(?:because|cause|since) (?:it|that|the|\w+ (?:is|are|was|has|have))\b|"
    r"so (?:can|could|will|would) you\b|so (?:go|come|drive|find|check|look)\b|"
    r"(?:so|so that) you (?:know|learn|remember|will know|get to know)\b|"
    r"(?:for|in order) to (?:know|learn|get to know) )"
)
"""Regular expression for the space before a clause of reason: "wait because I am busy".

The "as" of "as soon as", "as far as" and "as long as" begins no reason."""


def is_remark(clause: str, states: bool = False, first: bool = False) -> bool:
    """Return True for a clause that gives no order: "I heard a noise".

    With `states`, one about a state ("the isolation is over") also counts; with `first`, at the
    beginning of the text, an assent ("all clear").
    """
    if first_match(_templates(IDIOMS + (ASSENTS if first else "")), clause) is not None:
        return True
    if _MAY_DIRECT.search(clause) or has_order(clause.lower().split()):
        return False
    return first_match(_templates(REMARKS + (STATES if states else "")), clause) is not None


def has_order(words: list[str]) -> bool:
    """Return True if a verb comes in its base form: "go", but not "a walk" or "is clean"."""
    return any(
        TABLE.get((word,)) in ("verb", "avoid")
        and word not in PAST
        and not word.endswith(("ed", "ing"))
        and not (word.endswith("s") and TABLE.get((word[:-1],)) == "verb")
        and not _BEFORE_NO_VERB.match(before)
        for before, word in zip(["", *words], words, strict=False)
    )


@lru_cache(maxsize=8)
def _templates(templates: str) -> list[SentenceTemplate]:
    return compile_templates(templates, {})
