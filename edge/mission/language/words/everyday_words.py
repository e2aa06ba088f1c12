"""Phrases of everyday speech to a robot, by kind, and regular expressions for names.

The modules that read utterances before the grammar (`tidy`, `intents`, `errands`, …) use them. The
format is the lexicon's: phrases are separated by `;`, and "(a|b) c" is both "a c" and "b c".
"""

from __future__ import annotations

import re
from typing import NoReturn

from edge import names, number_words
from edge.memory import kind_of_room
from edge.mission.language.words import nouns
from edge.mission.language.words.lexicon import expand_choices
from edge.mission.language.words.places import is_marked
from edge.mission.language.words.tokens import unclear

_ROWS: dict[str, str] = {
    # Words around an order, which do not change it.
    "hesitation": "uh; um; er; erm; hmm; hm; uhm; mm; eh; yeah; yep",
    "opening": """
        hey; hi; hello; yo; ok; okay; so; well; now; please; robot; oh; right; alright; all right;
        listen; dear; ah; and; then; carefully; good morning; good evening; attention; quick;
        quickly; yes; yeah; (hey|hello|hi) (there|you|buddy); excuse me; thanks; thank you; whoa;
        off you (go|toddle|trot|pop|run); buddy; sorry; just; kindly; from now; from now on;
        from today (on|); (make|pay) attention; watch out; for now; first; today; (my|) (dear|love|
        darling|friend|sweetheart|sweetie); (could|can|would|will) you (just|maybe|perhaps|kindly|
        quickly|); (could|can|would|will) you (be so kind|be so good) (as|) to; (would|do) you mind;
        i (want|need|would like|expect) (that|) you to; i (want|need|would like|
        would prefer) that you; (that is|this is) enough; that will do; (we|i) (want|need|
        would like) (the|) robot to; i want to ask you to; you (must|should|shall) to; you (must|
        should|shall|have to|need to|are to); it would be (nice|great|lovely) if you (could|would);
        be (a|an) (dear|pal|darling|sweetheart|love|angel|star|good (robot|boy|girl)) and;
        do me a favour and; do me a (favor|kindness) and; oi; go ahead and; make sure (to|you|
        that you); be sure to; try to; you (had|would) better; let us; (is it|it is|
        would it be) possible (for you|) to; mind (that|) you; i (wonder|was wondering) (if|
        whether) you (could|would|might) (be so kind|be so good|) (as to|); i (would be|
        am) (much obliged|grateful|glad|happy) if you (could|would|); (perhaps|maybe) you (could|
        would|might|can); you might (like|want) to; i dare you to; is it possible;
        is possible (that|) you; wow; oops; goodness; dear me; vroom; beep; whee; yay; (if it is|
        unless it is) not too much (bother|trouble); (forgive|pardon|excuse) me (for asking|
        ) (again|) (but|); (i am|) sorry to (ask|bother you) (again|); but; why do not you;
        why do n't you; time to; in your memory; hurry up and; hurry and; as far as you (know|
        remember); come on; follow the plan and; please to
    """,
    "closing": """
        please; thanks; thank you; thank you (very|so) much; thanks (ever|) so much; many thanks;
        cheers; dear; love; buddy; robot; okay; ok; mate; keep (that|it) in mind; pal; (would|will|
        could|can) you; for me; now; right now; right away; at once; immediately; honey; darling;
        sweetie; my dear; my friend; my love; sweetheart; as (fast|quickly|soon) as you can;
        (really|very|super|) (quickly|quick|fast); sharpish; hurry; hurry up; thanks a lot; (just|
        ) so you know; for your information; log it; you can find; if you (please|do not mind);
        when you (have|get) (time|a moment|a minute|a chance); in case you did not know; for now;
        today; do not forget (that|it|); got it; did you get that; you hear; will you please;
        all right; alright; for us; sir; friend; be careful; and be careful; carefully; come on;
        good robot; pronto; asap; from now on; there is a good (boy|robot|lad|girl|chap|fellow);
        to charge; (it|) starting (now|today); as of (now|today); (from|) end to end; (from|
        ) top to bottom; of course; whichever you (like|please|prefer); (while|when) you are at it;
        (all|) by yourself; yes; (and|then) report; (and|) let (me|us) know; (and|) (tell|give|say|
        show|report) (to|) (me|us) the (result|answer); for charge; for charging; to recharge; (and|
        ) (tell|show) me; (when|once|after) you (are|have) (done|finished|ready); no rush;
        just wondering; by the way; lying (about|around); will (ya|you); would ya; off you go;
        with you; little (one|robot|friend); (to|do|try to|you have to|) (remember|memorize|
        memorise) (it|that|); as far as you (know|remember); every (bit|part|inch|corner) of it;
        like a (guard|policeman|robot|spy)
    """,
    # A self-correction: "the bedroom, no, I mean the office".
    "correction": """
        no sorry; sorry; sorry no; no wait; wait no; no i mean; i mean; i meant; no i meant; no no;
        oh no; no not that; make that; scratch that; actually no; no actually; or rather; no rather;
        sorry i mean; sorry i meant; no make that; or actually; wait i mean; wait sorry;
        actually i (mean|meant); (i|) actually (mean|meant|wanted); oh wait; no i wanted
    """,
    # Kinds of rooms: the last word of a room's name, before a number.
    "room": """
        room; kitchen; kitchenette; bedroom; bathroom; restroom; washroom; office; study; lounge;
        hall; hallway; corridor; playroom; nursery; garage; basement; cellar; attic; pantry;
        balcony; terrace; garden; lobby; foyer; ward; gym; library; lab; laboratory; workshop;
        canteen; cafeteria; storeroom; stockroom; classroom; den; conservatory; patio; yard; aisle;
        bay; warehouse; unit; theatre; clinic; pharmacy; mailroom; cloakroom; ballroom; boardroom;
        darkroom; showroom; staffroom; lunchroom; guestroom; stairwell; entrance hall; sunroom;
        studio; mezzanine; sluice; gallery
    """,
    # First words of rooms' names that are no names of objects.
    "room of": """
        break; staff; lunch; tea; supply; copy; mail; print; printing; control; treatment; exam;
        examination; operating; recovery; emergency; changing; dressing; shower; utility; boiler;
        packing; shipping; receiving; loading; sorting; cold; isolation; therapy; music; games;
        reading; sewing; hobby; day; quiet; prayer; spare; master; tool; supplies; equipment; crash;
        wash; sleep; play; med; medication; drug; activity; common; rest; family; waiting;
        breakfast; dining; seating; sitting; smoking; server; interview; consulting; fitness;
        luggage; laundry; delivery; pickup; parking; charging; assembly; machine; sick; ironing
    """,
    "everything": """
        everything; everywhere; house; home; flat; apartment; building; floor; area; place;
        surroundings; environment; rooms; ward; warehouse; site; all; everything here; place here;
        all here; what is here; all what is here; everything that is here; whole thing; every room;
        all rooms; all the rooms; every corner; entire place; everything around here;
        everything around you; the rest
    """,
    # Relations between objects, as `edge.memory` decides them.
    "relation": """
        next to; beside; besides; near; close to; by; under; underneath; below; behind; in front of;
        on; on top of; in; inside; at; opposite; above; nearest to; nearest; closest to; against;
        across from; between; near to; near of; next of; beside of; behind of; nearby
    """,
    "standing": """
        (that|which|what|who) (is|are|stands|sits|lies|hangs|stand|sit|lie) (sitting|standing|lying|
        hanging|placed|located|right|just|); standing; sitting; lying; hanging; right
    """,
    # Other words for "go to" and "find", at the beginning of a clause.
    "go to": """
        (pop|nip|trundle|scoot|shoot|zoom|toddle|wander|roll|dash|sprint|motor|hop|whizz|come|head|
        run|drive|go|move|walk|skip|ride|cruise|travel|hurry|race|be off|off|get) (on|along|round|
        quickly|right|straight|next door|again|now|) (over|back|across|up|down|) (in|into|to|at|
        inside); back (in|into|to); make your way (over|back|) (to|into); get yourself (over|back|
        ) (to|into); bring yourself (over|back|) to; report (to|at); head (back|over|) (for|
        towards); make for; head for; set off (for|to); show up (at|in); (go|drive|come) (as far as|
        until); be off to; drop (in|) (at|by|into); i need you (over|) (in|at|to);
        you are needed (in|at); (park|sleep|rest|charge|recharge) (yourself|) (at|in|on|by|near|
        next to); present yourself at; position yourself (at|in|by); place yourself (at|in|by);
        put yourself (at|in|by); get (over|back|) to; go and stand (in|at|by|near|next to);
        go (stand|sit|wait|be|sleep|park) (in|at|by|near|next to); go visit; (pay|paid) a visit to;
        take a trip to; go have a look at; (take|get|bring|off) yourself (off|down|up|along) to;
        (go|move|drive|get|come) (close|closer|next|up) to; (move|drive|get|come) near
    """,
    "find": """
        make (a|) search (of|for); track down; hunt (for|down|out); seek; seek out; spot;
        look out for; go find; go and find; go around and find; go around and (look|search) for;
        (find|look) for (me|us); search; search for; go search for; go and search for; go look for;
        go and look for; locate; go locate; try to find; try and find; help (me|us) find; help (me|
        us) look for; find me; find us; see if you can find; see if you can spot;
        keep an eye out for; i am looking for; we are looking for; i need you to find;
        i can not find; where could we find; look for
    """,
    # Beginnings of clauses that ask for what a robot with wheels, a camera and text cannot do.
    # Verbs of carrying and handing: they are no order to drive to the object.
    "carry": """
        bring; fetch; carry; grab; lift; hold; hand; open; close; shut; lock; unlock; give;
        pass (me|us|him|her|it|them); pick; take; deliver; collect; load; unload; throw; put; place;
        drop; move; push; pull; drag; pour; plug; unplug; make (me|us); get (me|us|the|my|a|an|some|
        that|it|them); serve; tow; stack; fold; build; shake; cut; charge my; hug; help me; cook;
        press
    """,
    # Verbs of work at an object: the robot drives there.
    "work": """
        sweep; touch; wash; wipe; mop; vacuum; clean; dust; tidy; feed; iron; water; empty; fill;
        (switch|turn) (on|off|up|down); knock; fix; repair; sort
    """,
    "talk": """
        tell; call; ring; phone; say; sing; ask; speak; talk; shout; message; text; email; remind;
        warn; greet; whisper; inform; alert; announce; read; play; dance; laugh; count; translate;
        write; record; film; take (a|some) (picture|photo|pictures|photos)
    """,
    "follow": """
        follow (me|us|him|her|them|my|that|the (man|woman|nurse|doctor|patient|dog|cat|boy|girl|
        people|person|visitor|forklift|lady|guy|kids|children)); chase; accompany; escort;
        come with; (guide|lead|show|walk) (me|us) (to|around|back|home|there|into|the way|out|
        through); (take|bring|guide|lead|show|walk|drive) (him|her|them|the (patient|visitor|guest|
        man|lady|guests|visitors)) (to|around|back|home|there|into|the way|out|upstairs|through);
        run after; walk with; come along; keep up with; stay with me; hide; catch
    """,
    # Elsewhere in an errand.
    "climb": """
        upstairs; downstairs; climb; (up|down) the (stairs|steps); take the (stairs|lift|elevator);
        (next|other|upper|lower) floor
    """,
    "clock": """
        at (half|quarter|noon|midnight|night|dawn|lunch|dinner|breakfast|supper); tonight;
        (every|each) (day|night|morning|afternoon|evening); in the (morning|evening|afternoon);
        (after|before) (lunch|dinner|breakfast|supper|visiting hours); (half|quarter) (past|to);
        o'clock; oclock
    """,
    "date": """
        tomorrow; later today; (on|every|each|next|this) (monday|tuesday|wednesday|thursday|friday|
        saturday|sunday); on (mondays|tuesdays|wednesdays|thursdays|fridays|saturdays|sundays|
        weekdays|weekends); (every|each|next) (week|weekend|weekday|month|year)
    """,
}  # fmt: skip

# Regular expression for an article or another determiner.
ARTICLE = r"(?:the|an?|my|our|your|his|her|their|this|that|those|these|some|any)"

_NOT_IN_NAMES = """
    and or then but to for from in into on at by near with of under behind beside next inside while
    until till before after unless if when because it them i we you he she they there here is are
    was were has have had will not do does did please now again also too first afterwards anymore
    any more anywhere once twice okay ok still never that which who what where without via through
    so as than can could would should must may go come drive find return wait stop today since
    during around over up out off away back just only below above underneath opposite against
    between close nearest closest across top look be me us him this how why standing
    sitting lying hanging it's already same order everywhere somewhere thing right yet like
    the a an my our your his her their those these some last lately recently earlier kept located
    gone exactly been ever always forever
    """
AFTER_A_NAME = (
    r"(?:front(?! (?:door|desk|gate|yard|garden|room|office|entrance|row|seat)s?\b)|"
    f"{'|'.join(_NOT_IN_NAMES.split())}|left(?= (?:on|in|under|at|by|near|next|behind|inside) ))"
)
"""Regular expression for a word that cannot be part of a name, so that a name ends before it."""


def phrase_of(kind: str) -> str:
    """Return a regular expression for one of the phrases of a kind, the longest first."""
    tree: _Tree = {}
    for phrase in expand_choices(_ROWS[kind]):
        rest = tree
        for word in phrase.split():
            rest = rest.setdefault(word, {})
        rest[""] = {}  # a phrase ends here
    return f"(?:{_any_branch(tree)})"


_Tree = dict[str, "_Tree"]  # first word of phrases -> the tree of what may follow it


def _any_branch(tree: _Tree) -> str:
    """Return a regular expression for one path through the tree, the longest first.

    Words with the same continuations share it. One alternative for each phrase would be 184,000
    characters long for "go to", and take 0.3 s to compile.
    """
    words = sorted(filter(None, tree), key=len, reverse=True)
    beginnings = {word for word in words if any(w.startswith(word) and w != word for w in words)}
    by_rest: dict[str, list[str]] = {}
    for word in words:
        if word not in beginnings:
            by_rest.setdefault(_continuation(tree[word]), []).append(re.escape(word))
    branches = [f"{_either(alike)}{rest}" for rest, alike in by_rest.items()]
    # "do" comes after "dotty", or it would match the beginning of that.
    branches += [re.escape(w) + _continuation(tree[w]) for w in words if w in beginnings]
    return _either(branches)


def _continuation(tree: _Tree) -> str:
    if set(tree) == {""}:
        return ""
    return f"(?: {_any_branch(tree)}){'?' if '' in tree else ''}"


def _either(alternatives: list[str]) -> str:
    return f"(?:{'|'.join(alternatives)})" if len(alternatives) > 1 else alternatives[0]


# A word of a name: "mug", but also "trash can" and "bottle of water".
_WORD = (
    r"(?:(?:trash|garbage|rubbish|watering|paint|soda|beer) can"
    r"|(?:(?:bottle|glass|cup|mug|bowl|plate|box|bag|pack|packet|roll|jar|tin|stack|pile) of )?"
    rf"(?!{AFTER_A_NAME}\b)\w[\w'.-]*(?<![.]))"
)
MARK = "[\ue000-\uf8ff]"
"""Regular expression for a private Unicode character that stands for a name; see `places`."""
PLAIN_NAME = rf"(?:{MARK}|(?:(?:(?<=[\w'-]) |(?<![\w'-])){_WORD}){{1,5}})"
"""Regular expression for one name without an article: up to five words, with a space before each
but the first. No word character may stand right before the name."""
NAME = rf"(?:(?:all )?(?:{ARTICLE} )?(?:(?:pair|kind|sort|bit|piece) of )?{PLAIN_NAME})"
"""Regular expression for one name, with or without an article or "a pair of"."""
_ROOM_KIND = rf"(?:(?:{phrase_of('room of')}|living|dining|family|sitting) )?{phrase_of('room')}"
EACH_ROOM = (
    rf"(?:(?:every|each)(?: single)? {_ROOM_KIND}|(?:every one of|each(?: one)? of|all(?: of)?|"
    rf"both(?: of)?)(?: (?:the|our|my|your|these|those))? {_ROOM_KIND}e?s)"
)
"""Regular expression for several rooms: "every room", "all the bedrooms"."""
EACH_ROOM_AND = re.compile(rf"(?:, | and | or |, and ){_ROOM_KIND}(?:e?s)?\b", re.I)
"""Regular expression for a second room without an article: "every bedroom and bathroom"."""
_EACH_OF = re.compile(
    r"(?:every|each|all|both)(?: one)?(?: of)?(?: single)?(?: (?:the|our|my|your|these|those))? ",
    re.I,
)
_ROOM_HEAD = re.compile(
    rf"(?:.* )?{phrase_of('room')}"
    rf"(?: (?:number )?(?:\d+\w?|[a-z]|{'|'.join(number_words.SMALL_NUMBERS)}))?"
    "|toilet",
    re.I,
)
_ARTICLED = re.compile(rf"^(?:{ARTICLE} )?(?:(?:pair|kind|sort|bit|piece) of )?", re.I)


def is_room(name: str) -> bool:
    """Return True if a name without an article names a room, a kind of rooms, or a known place.

    >>> is_room("living room"), is_room("room 12"), is_room("kitchen table")
    (True, True, False)
    """
    by_name = is_marked(name) or _ROOM_HEAD.fullmatch(name) is not None
    return by_name or kind_of_room(name) is not None


def each_kind(name: str) -> str:
    """Return the kind of several rooms; "" if a name means something else.

    >>> each_kind("all the bedrooms"), each_kind("every room"), each_kind("all kitchen")
    ('bedroom', 'room', '')
    """
    several = re.fullmatch(EACH_ROOM, name, re.I)
    return names.singular(_EACH_OF.sub("", name.lower(), count=1)) if several else ""


def refuse_each(name: str) -> NoReturn:
    """Refuse a search in several rooms of a kind."""
    hint = "a search is in one room or everywhere; name one room, or say 'in every room'"
    raise unclear(name, hint)


def bare(name: str) -> str:
    """Return a name in lower case without its article.

    >>> bare("The pair of glasses")
    'glasses'
    """
    plain = _ARTICLED.sub("", name.strip()).lower()
    return "person" if plain in ("somebody", "someone", "anybody", "anyone") else plain


_STATES = nouns.split_entries(
    """clear open closed locked unlocked free busy ready broken full empty clean dirty safe
    dangerous far near close alone warm cold hot dry wet missing awake asleep charged running
    working okay ok"""
)
NOWHERE = nouns.split_entries(
    """way foot own order point least most floor floors last path road route place places spot area
    position location side one ones bit moment while"""
)
"""Last words of phrases that name no object: "at some point", "on the way"."""
# Words with which a name means no certain object.
_UNNAMED = {
    "no", "other", "another", "same", "every", "each", "all", "both", "anything", "something",
    "very", "really", "quite", "whatever", "whichever",
}  # fmt: skip


def is_vague(name: str) -> bool:
    """Return True if a name says too little ("the other side") or is a state ("open")."""
    words = bare(name).split()
    quality = words[-1] in nouns.QUALITIES - nouns.NOUNS and len(words) > 1  # "sofa red"
    no_object = quality or words[-1] in nouns.PLAIN_WORDS | _STATES or words == ["room"]
    return no_object or bool(_UNNAMED & set(words))
