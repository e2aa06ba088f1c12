"""Parser of the parts of a clause: counts, conditions, and the words before its verb."""

from __future__ import annotations

from dataclasses import dataclass, field

from edge.mission.language.words.lexicon import AFTER_VERB, NUMBERS
from edge.mission.language.words.noun_phrases import (
    Antecedents,
    NounPhrase,
    starts_noun_phrase,
    take_noun_phrase,
)
from edge.mission.language.words.tokens import ONE_ROBOT, PAST_TENSE, REASONS, Token, TokenReader

MAX_VISITS = 20
"""Largest number of visits to one object that a count may ask for."""
_MARKERS = (  # kinds of token that say how a number is meant
    "at least", "at most", "exactly", "more than", "less than", "more or less", "or more",
    "or less", "only",
)  # fmt: skip
_NUMBERS = ("number", "times n", "once")  # kinds of token that have a number


@dataclass(frozen=True, slots=True)
class Count:
    """A range of separate visits."""

    least: int  # smallest number of visits
    most: int | None = None  # largest number of visits; None: no limit

    def negated(self) -> Count | None:
        """Return the range that "do not …" leaves; None if that is no range."""
        if self.most is None:
            return Count(0, self.least - 1) if self.least else None
        return Count(self.most + 1) if self.least == 0 else None


def take_count(reader: TokenReader, negated: bool, every: bool = False) -> Count | None:
    """Parse the count that begins here; return None if there is none.

    `negated`: the clause and the result are negated. `every`: the count is for all places, so that
    "once" means "no second time".

    Raises:
        TranslationError: the count is above `MAX_VISITS`, or makes no sense after "not".
    """
    begin, start = reader.at, reader.peek()
    if start.text in ("on", "for") and reader.is_at(*_NUMBERS, *_MARKERS, ahead=1):
        reader.at += 1
    # "At least two and at most four times": kinds of the markers, the numbers, and the first number
    # after each marker ("" for none). `times`: it counts visits, as "times" or "twice" shows.
    markers: set[str] = set()
    numbers: list[int] = []
    marked: dict[str, int] = {}
    marker = ""
    times = False
    while True:
        token = reader.peek()
        if token.kind in _MARKERS:
            markers.add(token.kind)
            marker = token.kind
        elif token.kind in _NUMBERS and not (token.kind == "once" and _means_as_soon_as(reader)):
            # Nine digits are enough: all these numbers are above `MAX_VISITS`.
            numbers.append(NUMBERS[token.text] if token.text in NUMBERS else int(token.text[:9]))
            times = times or token.kind != "number"
            marked.setdefault(marker, numbers[-1])
        elif token.kind == "times":
            times = True
        elif not (
            token.kind in ("or", "and")
            and (markers or numbers)
            and reader.is_at(*_NUMBERS, *_MARKERS, ahead=1)
        ):
            break
        reader.at += 1
    if not numbers or not times:
        reader.at = begin
        return None
    joined = any(token.kind in ("or", "and") for token in reader.tokens[begin : reader.at])
    if len(set(numbers)) > 1 and not (joined or markers):
        reader.refuse_finally("give one number of visits", start)  # "2 times 3"
    if max(numbers) > MAX_VISITS:
        reader.refuse(f"at most {MAX_VISITS} visits can be counted", start)
    if not negated and {"at least", "at most"} <= marked.keys():
        if marked["at least"] > marked["at most"]:
            reader.refuse("the counts contradict each other", start)
        return Count(marked["at least"], marked["at most"])
    if every and not markers and numbers == [1]:
        return Count(1, 1)
    return _count_meant(reader, markers, numbers, negated, begin)


def take_quota(reader: TokenReader, memory: Antecedents, clause: Clause) -> None:
    """Parse `the maximum number of visits to a is three`."""
    token = reader.take("quota")
    assert token is not None
    clause.targets = take_noun_phrase(reader, memory)
    reader.skip("be", "must", "can")
    if reader.is_at("exactly") and reader.is_at("number", ahead=1):
        reader.at += 1
    marked = take_count(reader, negated=False)
    number = reader.take("number") if marked is None else None
    if marked is not None and marked.most not in (None, marked.least):
        reader.refuse("give one number of visits", token)
    n = marked.least if marked else NUMBERS.get(number.text if number else "", MAX_VISITS + 1)
    if n > MAX_VISITS:
        reader.refuse(f"at most {MAX_VISITS} visits can be counted", token)
    kind = token.text.removeprefix("the ")
    most = None if kind.startswith("min") else n
    clause.count = Count(0 if kind.startswith("max") else n, most)


def _means_as_soon_as(reader: TokenReader) -> bool:
    """Return True if "once" here means "as soon as"."""
    return reader.is_at("you", "article", "word", "quoted", "pronoun", "all of", "either", ahead=1)


def _count_meant(
    reader: TokenReader, markers: set[str], numbers: list[int], negated: bool, begin: int
) -> Count:
    """Return the count that markers and numbers mean; see `take_count`."""
    n = numbers[-1]
    if 0 in numbers and markers & {"or more", "at least"}:
        reader.refuse("this number is always fulfilled; leave it out", reader.tokens[begin])
    if "more or less" in markers:  # "not more or less than n": exactly n
        return Count(n, n)
    if markers & {"exactly", "only"} or {"at least", "at most"} <= markers:
        count = Count(n, n)
    elif markers & {"at most", "or less"} or (0 in numbers and "more than" not in markers):
        count = Count(0, max(numbers))
    elif "less than" in markers:
        count = Count(0, n - 1)
    elif "more than" in markers and len(numbers) == 1:
        count = Count(n + 1)
    else:
        count = Count(min(numbers))
        tokens = reader.tokens[begin : reader.at]
        once = next((t for t in tokens if t.kind == "once" or (n == 1 and t.kind == "times")), None)
        if once and not (markers or negated) and reader.pick(once, 2) == 1:
            count = Count(1, 1)  # "visit a once" may mean: no second time
    if not negated:
        return count
    rest = count.negated()
    if rest is None or (rest.most is not None and rest.most < 0):
        reader.refuse("say how often it may be instead", reader.tokens[begin])
    return rest


CONDITIONS = ("before", "after", "until", "unless", "when", "once")
"""Kinds of token that begin a condition."""
ORDERS = ("any order", "in order", "strict order")
"""Kinds of token that order the objects of a clause."""
MOOD = (
    "you", "ensure", "must", "can", "do", "not", "filler", "only", "first", "be", "always",
    "in the end",
)  # fmt: skip
"""Kinds of token that may stand before the verb of a clause."""
AUXILIARIES = frozenset({"be", "must", "can"})
"""Kinds of token for auxiliary verbs."""
# After "not", these leave open what is denied: "do not go straight to a".
_LIMITING = (
    "just", "simply", "always", "also", "now", "only", "directly", "already", "straight",
    "immediately", "right", "solely",
)  # fmt: skip
# After "not", these make a duty optional: "you do not have to".
_NEEDS = (
    "have", "has", "had", "need", "needs", "need to", "required", "are required", "is required",
    "obliged", "are obliged",
)  # fmt: skip
# After "no", these make it an answer: "no thanks", "no problem".
_THANKS = ("thanks", "please", "thank you", "way", "problem")
_NOT_NEEDED = REASONS["needless"]
PREDICATE = ("must", "can", "not", "filler", "only", "first", "be")
"""Kinds of token that may stand between a subject and its verb."""


@dataclass(slots=True)
class Condition:
    """A condition of a clause."""

    kind: str  # "before", "after", "until", "unless" or "when" ("once" is "when")
    token: Token
    targets: NounPhrase  # objects of the event
    only: bool = False  # "only after …", "only before …"
    denied: bool = False  # "not before …", or an event that is negated ("once you have not …")
    recurring: bool = False  # "whenever", "if": each event counts, not only the first
    going: bool = False  # "when visiting a", which may mean on the way there or afterwards
    count: Count | None = None  # number of events in "after you have visited a twice"
    # "before that" or "before" alone. Without a verb ("before that is visited"), it means only the
    # order of two goals
    referred: bool = False


@dataclass(slots=True)
class Clause:
    """The content of one clause."""

    token: Token
    mood: str = "do"  # "do" (an order), "must" (a duty) or "can" (a permission)
    negated: bool = False  # "do not", "never", "avoid"
    only: bool = False  # "only" before the verb
    targets: NounPhrase | None = None  # objects of the clause; None for "do not stop (until …)"
    conditions: list[Condition] = field(default_factory=list)
    # objects to avoid on the way ("while avoiding", "without")
    avoiding: list[NounPhrase] = field(default_factory=list)
    during: bool = False  # the avoidance has "while", so it ends with this clause
    # objects to avoid permanently ("while always avoiding")
    never: list[NounPhrase] = field(default_factory=list)
    # objects to avoid only until then ("without visiting x first")
    not_first: list[NounPhrase] = field(default_factory=list)
    # objects not to visit again on the way ("without returning to x")
    not_again: list[NounPhrase] = field(default_factory=list)
    order: str = ""  # kind of order among the objects, or ""
    count: Count | None = None  # number of visits
    separate_count: bool = False  # the count stood after a comma
    next_step: bool = False  # "right after", "immediately"
    instant: Token | None = None  # token of "in the next step", exactly
    soon: bool = False  # "as soon as", which applies to duties only
    again: bool = False  # "again", "any more", "revisit"
    first: bool = False
    trails: bool = False  # the clause comes after the clause before it ("… after that")
    returns: bool = False  # "return to", "go back to": the clause comes after all clauses before it
    bound: NounPhrase | None = None  # destination given first: "to reach x, go through y"
    bound_by: Token | None = None  # token of a destination given last: "go through y to reach x"
    through: bool = False  # the objects are on the way to something
    by_way: bool = False  # the objects can only be on the way ("go by way of x")
    # objects that are reached before `targets`, in order
    route: list[NounPhrase] = field(default_factory=list)
    several_ways: bool = False  # the route has "a and b" in one part
    only_way: bool = False  # no other route is allowed
    enroute: bool = False  # the clause is "on the way" to an earlier goal
    # the clause names only exceptions ("any room but a"), so another goal is needed
    elsewhere: bool = False
    always: Token | None = None
    ends: bool = False
    each: int | None = None  # limit of visits to each place ("no revisiting")
    out_of_turn: bool = False  # a ban on another order than the given one
    done: bool = False  # the verb is in the past: "you must have visited a (before b)"
    leads: bool = False  # "then" stands between the conditions and the rest
    subject: bool = False  # the clause names who must act ("you must …")
    in_future: bool = False  # the clause describes the future ("will", "can not")
    agent: str = ""  # name for the robot ("the drone")
    verb: str = ""  # the verb; "" in a bare clause


def names_one_robot(reader: TokenReader) -> bool:
    """Return True if "robot c" comes."""
    letter = reader.is_at("word", ahead=1) and len(reader.peek(1).text) == 1
    return letter and reader.peek().text in ("robot", "the robot")


def _refuse_scope(reader: TokenReader, denial: Token) -> None:
    """Refuse `do not just go to a`, `you don't always have to visit a`: unclear what is denied."""
    ahead = 0
    while reader.is_at("filler", "always", "only", "immediately", ahead=ahead):
        if set(_LIMITING) & set(reader.peek(ahead).text.split()):
            reader.refuse_finally("say directly what not to do", denial)
        ahead += 1
    if reader.is_at("must", ahead=ahead) and reader.peek(ahead).text in _NEEDS:
        reader.refuse_finally(_NOT_NEEDED, denial)


def _is_statement(reader: TokenReader) -> bool:
    """Return True if "I go to a" or "we never use a" comes; "we have to go to a" is an order."""
    return reader.is_at("verb", "must", "can", "not", "do", "be", "filler", ahead=1)


def _is_acting_robot(reader: TokenReader) -> bool:
    """Return True if "it" is the robot here: it goes, must go, never goes."""
    ahead = 1
    while reader.is_at("must", "can", "not", "filler", "to", ahead=ahead):
        ahead += 1
    verb = reader.peek(ahead).text.split(" ")[0]
    goes = verb.endswith("s") and not verb.endswith("ss")
    does = reader.is_at("verb", "avoid", ahead=ahead) and (ahead > 1 or goes)
    return does and not reader.is_at("comma", "stop", "end", ahead=ahead + 1)  # "before it closes"


def take_mood(reader: TokenReader, clause: Clause, kinds: tuple[str, ...] = MOOD) -> set[str]:
    """Skip "you must never", "please make sure to" and the like; return the kinds of the tokens."""
    seen: set[str] = set()
    while True:
        token = reader.peek()
        if token.text == "need" and reader.is_at("not", ahead=1):
            reader.refuse_finally(_NOT_NEEDED, token)
        if names_one_robot(reader):
            reader.refuse_finally(ONE_ROBOT, token)
        if token.text in ("ok", "okay", "alright") and reader.is_at("to", ahead=1):
            reader.refuse_finally(_NOT_NEEDED, token)
        answers = reader.is_at("comma", "article", ahead=1) or reader.peek(1).text in _THANKS
        if token.text == "no" and answers:
            reader.refuse_finally("give the full instruction again", token)  # "…, no, the bed"
        if token.kind == "you" and token.text in ("i", "we") and _is_statement(reader):
            reader.refuse_finally("not an instruction for the robot", token)
        if token.text == "did" and reader.is_at("not", ahead=1):
            reader.refuse_finally(PAST_TENSE, token)
        let = token.text == "let" and reader.is_at("article", ahead=1)
        if let and reader.is_at("verb", ahead=3):  # "let the dog go there"
            reader.refuse_finally(ONE_ROBOT, token)
        if token.text == "it" and _is_acting_robot(reader):
            seen.add("you")
            reader.at += 1  # "the robot goes to a, then it goes to b"
            continue
        if token.kind == "to" and reader.is_at("filler", ahead=1) and reader.is_at("verb", ahead=2):
            reader.at += 2  # "you have to eventually get there"
            continue
        to = token.kind == "to" and reader.is_at("verb", "not", "avoid", "be", "happen", ahead=1)
        both = token.kind == "all of" and seen and reader.is_at("verb", "be", ahead=1)
        if to or both:  # "to visit", "are both visited"
            reader.at += 1
            continue
        if token.text in ("then", "afterwards", "later") and seen & {*AUXILIARIES, "you", "ensure"}:
            clause.trails = True  # "you must then visit it"
            reader.at += 1
            continue
        if token.kind == "banned":
            clause.negated = not clause.negated
            reader.at += 1
            continue
        if token.kind not in kinds:
            return seen
        seen.add(token.kind)
        reader.at += 1
        if token.kind in ("first", "filler"):
            reader.skip("comma")
        if token.kind == "not":
            _refuse_scope(reader, token)
            clause.negated = not clause.negated
        elif token.kind == "only":
            clause.only = True
        elif token.kind == "first":
            clause.first = True
        elif token.kind == "always":
            clause.always = token
        elif token.kind == "in the end":
            clause.ends = True
        elif token.kind in ("must", "can"):
            if clause.negated and "not" in seen and token.text in _NEEDS:
                reader.refuse_finally(_NOT_NEEDED, token)
            clause.mood = token.kind
            if token.kind == "can" and reader.take("you"):  # "can you go to …": a request
                clause.mood = "do"


def skip_particles(reader: TokenReader, clause: Clause) -> None:
    """Skip words between a verb and its object: "go first directly to"."""
    while True:
        token = reader.peek()
        if token.text == "back":
            if clause.verb.startswith("turn"):
                reader.refuse("say where to go back to", token)
            clause.again = clause.returns = True
            reader.at += 1
        elif clause.negated and token.text in _LIMITING:
            reader.refuse_finally("say directly what not to do", token)  # "do not go straight to a"
        elif token.text in AFTER_VERB and token.kind in ("word", "place", "to"):
            reader.at += 1
        elif token.text == "up to" and starts_noun_phrase(reader, 1):
            reader.at += 1  # "go up to the roof" has no count
        elif token.text == "straight" and not starts_noun_phrase(reader, 1):
            reader.at += 1
        elif token.kind == "first":
            clause.first = True
            reader.at += 1
        elif token.text in ("me", "us") and (
            clause.verb.startswith("follow") or reader.tokens[reader.at - 1].text == "with"
        ):
            reader.refuse("the robot can only go to objects", token)
        elif token.kind == "filler" and names_one_robot(reader):
            reader.refuse_finally(ONE_ROBOT, token)
        elif token.kind in ("to", "filler") or (
            token.kind == "and" and reader.is_at("verb", ahead=1) and clause.verb == "go"
        ):
            reader.at += 1
        else:
            return
