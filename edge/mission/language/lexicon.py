"""The words that the English grammar knows, by kind; everything else can only be a name.

Every verb here is read as "reach" (ViTL IV-A1 reduces all action verbs to it). A phrase stands
under one kind; the longest phrase that fits wins.
"""

from __future__ import annotations

import re

from edge import names

PHRASES: dict[str, str] = {
    # Who is spoken to, how strongly, and words that carry nothing.
    "you": "you|we|i|the robot|you robot",
    "ensure": "make sure|make sure that|ensure|ensure that|be sure|remember|your task is|"
    "your mission is|i want you|i would like you|please make sure|take care",
    "must": "must|should|shall|have|has|had|need|needs|need to|required|are required|is required|"
    "ought|will",
    "can": "can|may|could|would|might|are allowed|is allowed|be allowed|allowed|are permitted|"
    "permitted|are free",
    "do": "do|does|did|let|let us",
    "be": "be|is|are|was|were|been|being",
    "not": "not|never|no|don|don t|doesn t|isn t|can t|won t|never ever|"
    "prohibited from|are prohibited from|are forbidden|"
    "not allowed|are not allowed|not permitted|are not permitted",
    "banned": "is prohibited|is forbidden|is not allowed|is not permitted|are prohibited|"
    "are banned",
    "neither": "neither",
    "filler": "me|us|please|at any point in time|at any point|eventually|sometime|some time|just|"
    "simply|also|too|as well|kindly|directly|ever|at any time|at all costs|at all|at some point|"
    "in the future|along the way|on your travels|on the way|on your way|on its way|hi|hello|hey|"
    "thanks|thank you|"
    "thank you very much|when you have a minute|when you have time|mind|if you do not mind|"
    "at some time|always|in turn|in the end|whenever you can|"
    "when you have the chance|already|for me|now|robot|as many times as you want|"
    "at some point in the future|some time in the future|sometime in the future|no more no less|"
    "no more and no less",
    # How clauses hang together.
    "and": "and|plus|as well as|&",
    "or": "or|or else|or alternatively|alternatively|nor",
    "but": "but|however|though|yet",
    "then": "then|and then|then finally|and finally|finally|lastly|next|and next|after that|"
    "and after that|afterwards|afterward|and afterwards|and afterward|sometime afterward|"
    "sometime afterwards|and sometime afterward|and sometime afterwards|after this|and after this|"
    "followed by|thereafter|later|later on|some time later|and later|subsequently|move on|"
    "and then finally|second|third|fourth|fifth|then next|and lastly|after which|then after that|"
    "move on to|then followed by|and then after that|and then later|next up|last of all|at last",
    "only then": "only then|and only then|only after that|and only after that|only afterwards",
    "first": "first|first of all|to begin with|firstly|initially",
    # Conditions.
    "before": "before|prior to|ahead of|earlier than",
    "after": "after|following|having",
    "until": "until|till|up until|until after",
    "unless": "unless|if not|except after",
    "when": "when|as soon|as soon as|whenever|every time|each time|any time|if|if ever",
    "while": "while|whilst|during which|as long as",
    "without": "without|not through|but not through|without ever|not via",
    "via": "via|by way of|by going through|by passing through|by going via|by first going through|"
    "while passing|while passing through|while going through|by entering|by first entering|"
    "by visiting|by first visiting|by first going to|by going to|by first passing through|"
    "by crossing|by moving through|by walking through|by traveling through|by travelling through|"
    "by using|by first using",
    "bound": "on the way to|on your way to|on its way to|en route to|to get to|to get into|"
    "in order to reach|in order to get to|in order to go to|in order to enter|while moving to|"
    "while going to|while heading to|while traveling to|while travelling to|while on the way to|"
    "on the way into|on your way into|on its way into",
    "bound there": "to get there|on the way there|on your way there|to reach it|to get to it",
    "immediately": "immediately|right|straight|straight away|right away|at the next step|"
    "in the next step",
    # Counting.
    "once": "once",
    "times n": "twice|thrice",
    "number": "zero|one|two|three|four|five|six|seven|eight|nine|ten|single|a single",
    "times": "time|times|separate times|occasion|occasions|separate occasions|different times|"
    "different occasions|times in total|separate visits|visits|visits to|visit to|"
    "separate visits to|in total|distinct visits|distinct visits to",
    "at least": "at least|a minimum of|no less than|no fewer than|not less than|on at least",
    "at most": "at most|a maximum of|no more than|not more than|up to|on at most|maximum",
    "exactly": "exactly|precisely|on exactly|just exactly",
    "more than": "more than|greater than|any more than|more often than",
    "less than": "less than|fewer than|any less than|any fewer than",
    "more or less": "more or less than|any more or less than|any more or fewer than|"
    "any more or any fewer than|any more or any less than",
    "or more": "or more|or more often|and more",
    "or less": "or less|or fewer|or less often|or fewer times",
    "only": "only|solely",
    "again": "again|anymore|any more|any longer|a second time|another time|once again|once more",
    # Order.
    "any order": "in any order|in any order you like|in no particular order|in no specific order|"
    "in arbitrary order|in an arbitrary order|in whatever order|any order|"
    "the order is not important|the order does not matter|order does not matter|"
    "it can be done in any order|regardless of order|in whichever order|in a random order|"
    "the order is up to you|the order is arbitrary",
    "in order": "in order|in that order|in this order|in the order given|in the given order|"
    "in sequence|sequentially|consecutively|one after another|one after the other|in this sequence|"
    "in that sequence|one by one",
    "strict order": "in strict order|in strictly this order|in this strict order|"
    "in that strict order|in this exact order|in that exact order|in exact order|"
    "in this specific order|in that specific order|in exactly this order|in exactly that order|"
    "strictly in order|strictly in this order|in the exact order|in the strict order|"
    "in that exact sequence|in this exact sequence",
    # Naming.
    "article": "the|an|some|any|my|our|your|his|her|their|another",
    "pronoun": "it|that|there|them|this|those|these|that one|this one|the same",
    "either": "either|one of|either one of|either of|any of|any one of|at least one of",
    "all of": "both|both of|all of|each of|all|all the following|the following|"
    "every one of|each|every",
    "group": "locations|location|places|landmarks|landmark|waypoints|objects|targets|rooms|things",
    "place": "near|next to|beside|in|inside|on|under|below|above|behind|in front of|close to|"
    "opposite|against|between|of",
    "to": "to|towards|toward|over to|back to|up to the|through|into|onto|in to",
    "happen": "happen|happens|happened|happening|occur|occurs|occurred|occurred|occurring",
    # Known only to be refused with a reason: see `words.REASONS`.
    "endless": "keep visiting|keep going|keep on|keep moving|continue|continuously|repeatedly|"
    "infinitely|endlessly|perpetually|again and again|over and over again|over and over|patrol|"
    "cycle through|back and forth|infinite|an infinite number of|do not stop visiting|"
    "do not stop going|never stop visiting|never stop going|do not ever stop|can not stop|"
    "not stop visiting|not stop going",
    "stay": "stay|stays|staying|wait|waits|waiting|remain|remains|remaining|leave|leaving",
    # Says nothing new of a ban, and too much of a goal.
    "forever": "forever|indefinitely|for ever",
}
"""Kind → its phrases, separated by `|`."""

_REGULAR_VERBS = """
    visit reach approach enter explore check inspect examine clean wipe wash dust vacuum
    mop tidy polish scrub water open close lock unlock touch press use fetch grab collect watch
    observe spot locate discover charge load unload empty fill photograph scan search view greet
    feed iron attend cross navigate travel walk move head proceed drive return arrive pass step roll
    look
    turn switch stop pick plug sanitize disinfect activate start repair service contact access
    """

_IRREGULAR_VERBS = """
    go goes going went gone find finds finding found see sees seeing saw seen get gets getting got
    gotten take takes taking took taken bring brings bringing brought sweep sweeps sweeping swept
    meet meets meeting met run runs running ran come comes coming came make makes making made
    sit sits sitting sat shut shuts shutting hit hits hitting
    revisit revisits revisiting revisited
    """

VERB_PHRASES = "make your way|making your way|made your way|go near|going near|come near|get near|"
VERB_PHRASES += "continue to|continue on to|continue into|continue through|continue on into|"
VERB_PHRASES += "end up|ends up|ending up|end at|end in|finish at|finish in"

_PARTICLES = """
    to on off at by up in over for out through from into inside with back down toward towards
    """
AFTER_VERB = tuple(_PARTICLES.split())
"""Particles that belong to the verb before them: "turn on", "look for", "stop at"."""

AVOID_PHRASES = (
    "avoid|avoids|avoiding|avoided|bypass|bypassing|stay away from|staying away from|"
    "keep away from|keeping away from|keep avoiding|stay clear of|staying clear of|"
    "steer clear of|steering clear of|keep off|stay off|keep out of|stay out of|skip|skipping|"
    "keep clear of|go anywhere but|visit anywhere but|go anywhere except|go anywhere other than|"
    "by avoiding|by bypassing|refrain from|ignore|leave out|leaving out"
)


def _forms(verb: str) -> list[str]:
    stem = verb[:-1] if verb.endswith("e") else verb
    third = verb + ("es" if verb.endswith(("ch", "sh", "ss", "x")) else "s")
    past, doubled = f"{stem}ed", verb + verb[-1]
    if verb.endswith("y") and verb[-2] not in "aeiou":
        third, past = f"{verb[:-1]}ies", f"{verb[:-1]}ied"
    return [verb, third, f"{stem}ing", past, f"{doubled}ing", f"{doubled}ed"]


def _table() -> dict[tuple[str, ...], str]:
    phrases = {
        tuple(phrase.split()): kind
        for kind, listed in PHRASES.items()
        for phrase in listed.split("|")
    }
    verbs = [form for verb in _REGULAR_VERBS.split() for form in _forms(verb)]
    verbs += [*_IRREGULAR_VERBS.split(), *VERB_PHRASES.split("|")]
    for verb in verbs:
        phrases.setdefault(tuple(verb.split()), "verb")
    for phrase in AVOID_PHRASES.split("|"):
        phrases[tuple(phrase.split())] = "avoid"
    known = {word for phrase in phrases for word in phrase}
    for name, others in names.ALIASES.items():  # "trash can" has nothing to do with "can"
        for phrase in map(str.split, (name, *others)):
            if len(phrase) > 1 and known & set(phrase):
                phrases[tuple(phrase)] = "word"
                phrases[(*phrase[:-1], f"{phrase[-1]}s")] = "word"
    return phrases


TABLE = _table()
"""Words of a phrase → its kind."""

LONGEST = max(map(len, TABLE))

CONTRACTIONS = {
    "can't": "can not",
    "thru": "through", "dont": "do not", "cant": "can not", "wont": "will not",
    "cannot": "can not", "won't": "will not", "shan't": "shall not",
    "let's": "let us", "it's": "it is", "that's": "that is", "i'd": "i would",
}  # fmt: skip
ENDINGS = {"n't": " not", "'ve": " have", "'re": " are", "'ll": " will", "'d": " would"}


def expanded(word: str) -> list[str]:
    """A word without its contraction: `don't` gives do, not."""
    if word in CONTRACTIONS:
        return CONTRACTIONS[word].split()
    for ending, full in ENDINGS.items():
        if word.endswith(ending) and len(word) > len(ending):
            return (word[: -len(ending)] + full).split()
    return [word]


NUMBERS = {
    "zero": 0, "once": 1, "twice": 2, "thrice": 3, "single": 1, "a single": 1, "one": 1, "two": 2,
    "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9, "ten": 10,
}  # fmt: skip

WORD = re.compile(r"[^\W_]+(?:['\-_][^\W_]+)*")
