"""The vocabulary of the English grammar, by kind; any other word can only be part of a name.

Every verb means "reach" (ViTL IV-A1 reduces all action verbs to it). A phrase has one kind. The
longest matching phrase wins.
"""

from __future__ import annotations

import re

from edge import names
from edge.mission.language.words import nouns
from edge.number_words import SMALL_NUMBERS, TENS

# Kind → its phrases, separated by `;`; "(a|b) c" is both "a c" and "b c".
_ROWS: dict[str, str] = {
    # Words for the robot, moods, and words without meaning.
    "you": """
        you; we; i; the robot; you robot; the drone; the agent; the rover; the bot; the quadcopter;
        the vehicle; the delivery robot
    """,
    "ensure": """
        make sure (|that); making sure (|that); (ensure|ensuring) (|that); (be|being) sure;
        be sure that; remember; remembering; please make sure; take care; taking care; (be|
        being) careful; (see|seeing) to it that; do not forget; never forget; without forgetting;
        do not fail; never fail; go ahead and; (i want|i need|i would like|we want|we need|i like|
        i would love|we would like|i expect|i should like|we should like) (you|the robot|the drone|
        the agent|the car|the vehicle); (your|the) (task|mission|goal|job|objective|aim|
        assignment) is
    """,
    "addressed": "drone; rover; bot; quadcopter; droid",
    "must": """
        must; should; shall; have; has; had; need; needs; need to; ought; will; (|are|is) required;
        (|are|is) supposed; (|are) obliged; it is (necessary|needed|required|mandatory|essential|
        important) to
    """,
    "can": """
        can; may; could; would; might; (|are|is|be) allowed; (|are) permitted; are (free|welcome|
        good)
    """,
    "needless": """
        it is not (necessary|required|needed|mandatory|forbidden|prohibited|banned|compulsory); (is|
        are) not (off limits|out of bounds)
    """,
    "do": "do; does; did; let; let us",
    "be": "be; is; are; was; were; been; being",
    "not": """
        not you dare; not dare; not even think about; (i|we) do not want (you|the robot|the drone);
        not; never; not ever; no; don; (don|doesn|isn|can|won) t; never ever; (|are|is) not welcome;
        (|are) prohibited from; are forbidden; (|are) not (allowed|permitted); at no (point|time|
        stage); under no (circumstances|circumstance); on no account; in no case; by no means;
        it is (forbidden|prohibited|not allowed|not permitted|banned) to; (is|are|be|being|
        ) (forbidden|banned|barred|prohibited) from
    """,
    "banned": """
        (is|are) (prohibited|forbidden|banned|off limits|out of bounds); is not (allowed|permitted)
    """,
    "neither": "neither",
    # Reviewed: only these words can be removed from any sentence without changing its meaning.
    "filler": """
        at any point of time; whatever you do; whatever happens; so; listen; attention; today;
        be a dear and; be a pal and; buddy; my dear; dear; dude; my friend; hey there; hi there;
        hello there; good morning; me; us; for me; please; kindly; thanks; thank you;
        thank you very much; hi; hello; hey; ok; okay; alright; all right; robot; now; just; simply;
        also; too; as well; already; (would you|could you|) be so (kind|good) as to; (please|
        ) help (me|us); in a straight line; it would be (nice|good|great|kind|lovely) if you (could|
        would); (just|) to be (on the safe side|safe|sure); directly; (would|do) you mind;
        if you do not mind; when you have (a minute|time|the chance); whenever you can;
        as many times as you want; on your travels; eventually; in the future; (sometime|some time|
        at some point) (|in the future); at some time; ever; at all (|costs); at any (time|point|
        point in time|stage); in any way; no matter what (|happens); under any (circumstances|
        circumstance|condition|conditions); completely; totally; entirely; (sometime|some time|
        at some point|at some time|any time) today; on (your|this|the) (trip|journey|tour|round);
        there can be other (locations|landmarks|waypoints|places|stops) in between
    """,
    # Redundant in a ban or a condition; impossible for a goal.
    "always": """
        the whole way through; the (whole|entire) (time|way); throughout; all along;
        at every (point|moment|step); at any moment; always; at all times; all the time;
        each time you do; (for|during|throughout) the (whole|entire) (trip|mission|time|flight|
        journey); (for|during|throughout) the (trip|mission|flight|journey)
    """,
    "in the end": "in the end; at the end; at the very end; last",
    # Words that join clauses.
    "and": "and; plus; as well as; &",
    "or": "or; or else; or alternatively; alternatively; nor",
    "but": "but; however; though; yet",
    "then": """
        (and|) (that|this) done; and than; (|and) (then|finally|next|after that|afterwards|
        afterward|after this|later|from there|later on); then finally; lastly; sometime (afterward|
        afterwards); and sometime (afterward|afterwards); followed by; thereafter; secondly;
        thirdly; fourthly; some time later; and then some time later; (|and|then|
        and then) sometime later; subsequently; move on; and then finally; second; third; fourth;
        fifth; then next; and lastly; after which; (|and) then after that; move on to;
        from there on; from here; (|and) then from there; then followed by; (|and) then later;
        next up; last of all; at last; (|and) from then on; (when|once|after|and when|and once|
        as soon as) (you are done|you are done there|that is done|this is done|done|done there|
        you are finished|you are finished there|you have done that|you have done so|there|
        you get there|you are there|you arrive there|you have arrived there); (|and|then|
        and then) (sometime|some time|at some point|at some time|soon|shortly|any time|eventually|
        not long) (after that|after this|afterwards|thereafter|later on); at (some|a) later (point|
        time|stage|moment); (your|the|and your|and the|) (second|third|fourth|fifth|next) (stop|
        destination|target|goal|waypoint|place|place to go|place to visit) (is|should be|will be|
        must be)
    """,
    "only then": "(|and) only then; (|and) only after that; only afterwards",
    "first": "first; beforehand; first of all; to begin with; firstly; initially",
    # Conditions.
    "before": "before; prior to; ahead of; earlier than",
    "after": "after; following; having",
    "until": "until; till; up until; until after",
    "unless": "unless; if not; except after",
    "when": "when; as soon (|as); whenever; (every|each|any) time; if; if ever",
    "while": "while; whilst; during which; as long as",
    "without": """
        (|but) nowhere near; without (|ever); with no; instead of; (with|) no (stops at|stop at|
        visits to|visit to|stopping at|detour through); without (any|a|) (stops at|stop at|
        visits to|visit to|detour through); (not|but not) (through|via|past|near|over|across|along|
        by way of)
    """,
    "via": """
        via; by way of; that crosses; which crosses; (by|by first|while|while first|when) (going|
        moving|passing|walking|driving|flying|traveling|travelling|heading) (through|via|past|along|
        by|across); (by|by first) (entering|visiting|crossing|using|going to|taking|following|
        traversing|stopping at|stopping by|passing); while (passing|crossing|traversing); (that|
        which) (goes|leads|passes|runs|takes you) (through|via|past)
    """,
    "bound": """
        (while|when) (heading|bound) for; (en route|on way|on route) to; while (moving|going|
        heading|traveling|travelling) to; (when|while) on (the|your) way to; (on the way|
        on your way|on its way|along the way|on your trip|on the trip|on your journey|on the road|
        on the route|on your route|on the path|on your path|on its path|along your path) (to|into|
        towards|toward); (when|in) (going|moving|walking|driving|flying|heading|traveling|
        proceeding) (to|towards|toward); (in order to|so as to) (reach|get to|go to|enter|get into);
        (while|as) you (go|head|move|drive|fly|walk|travel|make your way|are going|are heading|
        are moving|are flying|are on your way) (to|towards|toward)
    """,
    "bound there": """
        for this; to do (so|this|that); (|in order) to get there; to reach it; to get to it
    """,
    "on the way": """
        (while|as) you are getting there; on the (road|route); along the path; in (the|your|
        its) way; (on|in|along) (your|its|our|their) (path|route); on (the|your|its) way (|there);
        along (the|your) way; en route; as you go; as you do so; (while|in) doing so;
        while you do (it|so); as you do it; (while|as) you are (driving there|going there|
        heading there|moving there|on your way|at it|doing it|doing so)
    """,
    "around": "around; by going around; going around; by driving around; by walking around",
    "origin": """
        (start|starting) (on|from|at|in|off at|out from); (begin|beginning) (on|at|in);
        beginning from
    """,
    "opener": """
        (start|starting|begin|beginning) (by|with); start off by; (your|the|) first (stop|
        destination|target|goal|waypoint|place|place to go|place to visit) (is|should be|will be|
        must be)
    """,
    "halt": """
        stay put; you are done; you can stop; you can stop there; (stay|stop|wait|remain|rest|
        be) there
    """,
    "onward": """
        (keep going|keep moving|keep walking|keep driving|keep flying|continue|proceed|go on|
        carry on|go|move|drive|walk|fly|continue on|move on|do not stop|never stop) (until|till)
    """,
    "immediately": """
        immediately; right; straight; (straight|right) away; immediately in the next time step; (at|
        in) (the next|the very next) (step|instant|time step|time instant|instance)
    """,
    # Counting.
    "once": "once",
    "times n": "twice; thrice",
    "number": """
        zero; one; two; three; four; five; six; seven; eight; nine; ten; eleven; twelve; thirteen;
        fourteen; fifteen; sixteen; seventeen; eighteen; nineteen; twenty; thirty; forty; fifty;
        sixty; seventy; eighty; ninety; single; a single; one single
    """,
    "times": """
        (trip|trips|visits|distinct visits|separate visits) (|to); visit to; (|distinct|separate|
        different) times; time; instances; (separate|different) instances; occasion; (|separate|
        different) occasions; times (in total|overall); (distinct|separate) visit;
        separate instance; in total
    """,
    "at least": """
        minimum; (|a) minimum of; (|on) at least; (no|not) less than; no fewer than; equal (|
        to) or more than; (greater|more) than or equal to
    """,
    "at most": """
        (|on) at most; a maximum of; (no|not) more than; up to; maximum; (equal|
        equal to) or less than; less than or equal to
    """,
    "quota": """
        (the maximum|the minimum|the required|maximum|minimum) (number of|allowable|allowed|
        allowable number of|allowed number of|permitted) (visits to|separate visits to|
        distinct visits to|passes through|separate passes through|times you can visit|
        times you can reach|times you may visit|times you must visit|times you must reach|
        times you visit|times you should visit|times to visit)
    """,
    "exactly": "exactly; precisely; on exactly; just exactly; no more no less; no more and no less",
    "more than": "more than; greater than; any more than; more often than",
    "less than": "less than; fewer than; any less than; any fewer than",
    "more or less": """
        more or less than; any more or (less|fewer) than; no fewer or greater than; (|
        any) greater or fewer than; any more or any (fewer|less) than
    """,
    "or more": "or more; or more than; or more often; and more",
    "or less": "or less; or fewer; or less often; or fewer times",
    "only": "only; solely",
    "out of turn": "out of turn; out of order; out of sequence",
    "no return": """
        no (revisiting|revisits|going back|turning back); repeated visits are not (permitted|
        allowed); (no|without any|without) (repetition|repetitions|repeats|repeated visits);
        no (revisiting|revisits|returning|going back|turning back|repeated visits|
        repetitions) (is allowed|are allowed|allowed|is permitted|are permitted|permitted)
    """,
    "repeat": "repeat; repeat this; repeat that; repeat it; do this; do that; do it",
    "again": """
        again; anymore; any more; any longer; a second time; another time; once again; once more
    """,
    # Order.
    "any order": """
        (either|either one) (first|can be first|may come first|can come first); in any order (|
        you like|you want|required); in no (particular|specific|set|fixed) order; in (arbitrary|
        an arbitrary|a random|either) order; any order; regardless of order; in (whatever|
        whichever) order (|you like|suits you); (whatever|whichever) order you like; (the|
        ) order (is not important|does not matter|is up to you|is arbitrary);
        it can be done in any order; (in whatever|in whichever) order (is|seems) (quickest|easiest|
        fastest|shortest|best); (any|whatever|whichever|either) order (is|will be) (fine|okay|ok|
        good|all right|alright); (any|whatever|whichever) order (works|will do|goes|suits you|
        you want|you prefer); (it does not matter|does not matter|it makes no difference|
        i do not care|i do not mind|no matter|you can choose|you can pick|you can decide|you choose|
        you pick|you decide) (in which order|in what order|which order|what order|the order|
        which first|which one first|where you start|which to visit first|(which one|
        which) (you visit|is|comes|goes|you do|you go to|you take|you start with) first|
        which one you start with); start with (whichever|whichever one) you (like|want|prefer)
    """,
    "whichever": """
        any one; either one; or both; your pick; your choice; the choice is yours; you choose;
        you decide; either is fine; either one is fine; either will do; either one will do;
        (whichever|whichever one) (you like|you prefer|you want|you choose|suits you|is closer|
        is closest|is nearer|is nearest|is easier|is quicker|is faster|is first|comes first|
        you find first|you see first|you (get to|come to|reach|spot|meet|come across|notice) first|
        you can find|you find|you see|works|will do); (the first|first) (you see|you find|you spot|
        you get to|one you see|one you find|one you spot|one you get to|one you come across);
        (one of them|one of these|one of the two|just one of them|only one of them|one|
        just one) (is|will be|would be) (enough|fine|okay|ok|good); one of them will do;
        one will do; (any|any one|either) of (them|the two|these) (is fine|is okay|will do|works);
        either (works|is okay|is ok|is good); (both|both of them) are (fine|okay|ok) (the one|
        any one|either one) (you like|you prefer|you want|that you prefer|you choose);
        (it does not matter|i do not care|i do not mind) (which|which one)
    """,
    "in order": """
        in order; in (that|this|the given) order; in the order given; in turn; in sequence;
        sequentially; consecutively; one after (another|the other); in (this|that) sequence;
        one by one
    """,
    "strict order": """
        in (strict|exact) order; in the (strict|exact) order; in (this|that) (strict|exact|
        specific) order; in (this|that) exact sequence; in exactly (this|that) order;
        in strictly this order; strictly in (|this) order
    """,
    # Parts of noun phrases.
    "article": """
        (any|each|every|a) trip to; each visit to; the; an; some; any; my; our; your; his; her;
        their; any visit to; any visits to; a visit to; every visit to
    """,
    "pronoun": "it; that; there; them; this; those; these; that one; this one; the same",
    "either": "either; one of; either one of; either of; any of; any one of; at least one of",
    "all of": "both (|of); all (|of|the following); the following; every one of; each (|of); every",
    "group": """
        locations; location; place; places; landmarks; landmark; waypoints; objects; targets; rooms;
        things
    """,
    "place": """
        near; next to; beside; in; inside; on; under; below; above; behind; in front of; close to;
        opposite; against; of
    """,
    "to": "to; towards; toward; over to; through; into; onto; in to; inside of",
    "happen": """
        happen; happens; happened; happening; occur; occurs; occurred; occured; occurring; (hold|
        holds) (|true); (become|becomes|be|is) true; (is|should be|will be|must be) (your|
        the) (goal|target|destination|final destination|final goal|objective|final target);
        is where you (finish|end|end up|need to be|have to be|should be|must be|must go|need to go|
        have to go|are going|should go|should finish|should end up)
    """,
    # Only known to be refused with a reason, see `tokens.REASONS`.
    "endless": """
        keep visiting; continuously; repeatedly; infinitely; endlessly; perpetually;
        again and again; over and over (|again); patrol; cycle through; back and forth; infinite;
        an infinite number of; (do not|never) stop (visiting|going); do not ever stop; can not stop;
        not stop (visiting|going)
    """,
    "going on": "continue; keep going; keep moving; keep on; go on; carry on",
    "stay": """
        stay; stays; staying; wait; waits; waiting; remain; remains; remaining; leave; leaving
    """,
    "stray": "got it; in case; regardless of; the (second|third|next|last) time you",
    "goal": "(your|the) (destination|goal|target|final destination|next stop|last stop)",
    "picture": "(take|taking|took) (a|some) (picture|pictures|photo|photos)",
    # Redundant in a ban; impossible for a goal.
    "forever": "forever; indefinitely; for ever",
    # In addition to the single words below.
    "verb": """
        show up; turn up; (swing|swinging) (past|through|into|over to); (end|finish|conclude) (your|
        the|this) (trip|journey|tour|route|way) (at|in|on|with|by); (make|making|made) your way;
        (go|going|come|get) near; (make|makes|making) it; continue (to|on to|into|through|on into);
        keep (going|moving|walking) to; (go|carry) on to; (make|making|take) a detour; (make|
        making) (a pass through|a delivery); find yourself (in|at); (cut|cutting) through;
        cut across; (set|setting) (a wheel|foot); (check|checking) in; (deliver|delivering) to;
        (make|do) a round of; do the rounds of; find your way; (get|bring|take) yourself;
        pay a visit; (drop|swing|stop|stopping) by; drop in at; stop off; gain access; (end|ends|
        ending) up; (go|come|get|going|coming) anywhere near; deliver (this|the|a|my) (package|
        parcel|letter|order) (to|at); (your|the|) (final destination|destination|last stop|
        last place|last place to go|last place to visit|final stop|final place) (is|will be|
        should be|must be); (move|drive|send|steer|guide|fly|navigate|take|bring|get|direct|moving|
        driving|taking) (the robot|the drone|the agent|yourself|itself); (take|use|follow|
        choose) (a|any|the) (road|path|route|way) (through|past|along|across|via); (take|taking|
        have|having) a (look|peek|glance); your (path|route|way|tour|trip|journey) (ends|should end|
        must end|will end) (at|in|on|with); (make|making) (a|any|any single) (stop|visit); (take|
        find|follow|choose|use) (a|any|the|some|the shortest|the quickest|the fastest) (path|route|
        road|way); (end|ends|ending|finish|finishes|finishing|stop) (up at|up in|up on|at|in|on|
        up by|by|with|up with)
    """,
    "avoid": """
        (stay|staying|keep|keeping|steer|steering) (well|far|right) (clear of|away from|out of);
        avoid; avoids; avoiding; avoided; (|by) bypassing; by avoiding; bypass; keep avoiding;
        (stay|staying|keep|keeping) (away from|out of); (keep|keeping|stay) off; (stay|staying|
        steer|steering|keep|keeping) clear of; (keep|stay) well away from; skip; skipping;
        go anywhere (but|except|other than); visit anywhere but; refrain from; ignore; (leave|
        leaving) out; getting around; (that|which) (avoids|bypasses|skips); (taking|by taking|using|
        by using|following) (a|any|the) (path|route|road|way) (that avoids|which avoids|
        that does not go through|that does not pass through); (by|on|along|via|using|only on|
        only along|only by) (a|any) (road|path|route|way) (that avoids|which avoids|that bypasses|
        that does not go through|that does not pass through); (that|which) (does not|
        never) (go past|go over|go through|pass through|goes through|passes through|enter|enters|
        cross|crosses|pass|touch|use|uses|lead through|take you through)
    """,
}

_REGULAR_VERBS = """
    peek
    visit reach approach enter explore check inspect examine clean wipe wash dust vacuum mop tidy
    polish scrub water open close lock unlock touch press use fetch grab collect watch observe spot
    locate discover charge load unload empty fill photograph scan search view greet feed iron
    attend cross navigate travel walk move head proceed drive return arrive pass step roll look zip
    tour pop hop nip hurry rush race glide hover land ascend descend soar float march stroll cruise
    journey trek advance dash zoom turn switch stop pick plug sanitize disinfect activate start
    repair service contact access fly follow climb traverse progress
"""

_IRREGULAR_VERBS = """
    go goes going went gone find finds finding found see sees seeing saw seen get gets getting got
    gotten take takes taking took taken bring brings bringing brought sweep sweeps sweeping swept
    meet meets meeting met run runs running ran come comes coming came make makes making made sit
    sits sitting sat shut shuts shutting hit hits hitting revisit revisits revisiting revisited fly
    flies flying flew flown ride rides riding rode
"""

_PARTICLES = """
    to on off at by up in over for out through from into inside with back down toward towards past
    along across
    """
AFTER_VERB = tuple(_PARTICLES.split())
"""Particles that belong to the preceding verb: "turn on", "look for", "stop at"."""


_CHOICE = re.compile(r"\(([^()]*)\)")  # a choice without another one inside


def expand_choices(phrases: str) -> list[str]:
    """Return all phrases of a row; "(a|b) c" becomes two phrases."""
    todo, done = [phrase for phrase in phrases.split(";") if phrase.strip()], []
    for phrase in todo:  # grows in the loop
        if choice := _CHOICE.search(phrase):
            before, after = phrase[: choice.start()], phrase[choice.end() :]
            todo += [f"{before}{option}{after}" for option in choice[1].split("|")]
        else:
            done.append(" ".join(phrase.split()))
    return done


PHRASES = {kind: tuple(expand_choices(row)) for kind, row in _ROWS.items()}
"""Kind → its phrases."""
AVOIDING = frozenset(PHRASES["avoid"])
"""Phrases that mean "avoid"."""


def _forms(verb: str) -> list[str]:
    """Return the forms of a regular verb.

    The order is: infinitive, third person, participle, past; and the last two with a doubled last
    letter ("stopping").
    """
    stem = verb[:-1] if verb.endswith("e") else verb
    third = verb + ("es" if verb.endswith(("ch", "sh", "ss", "x")) else "s")
    past, doubled = f"{stem}ed", verb + verb[-1]
    if verb.endswith("y") and verb[-2] not in "aeiou":
        third, past = f"{verb[:-1]}ies", f"{verb[:-1]}ied"
    return [verb, third, f"{stem}ing", past, f"{doubled}ing", f"{doubled}ed"]


_IRREGULAR_PAST = (
    "went gone found saw seen took taken brought swept met ran came made sat flew flown rode"
)
PAST = frozenset(_forms(verb)[3] for verb in _REGULAR_VERBS.split()) | frozenset(
    [*(_forms(verb)[5] for verb in _REGULAR_VERBS.split()), *_IRREGULAR_PAST.split()]
)
"""Past-tense forms of verbs."""


def _table() -> dict[tuple[str, ...], str]:
    """Build `TABLE`; where two rows have a phrase, the later rule here wins."""
    phrases = {
        tuple(phrase.split()): kind
        for kind, split_entries in PHRASES.items()
        for phrase in split_entries
        if kind not in ("verb", "avoid")
    }
    verbs = [form for verb in _REGULAR_VERBS.split() for form in _forms(verb)]
    for verb in (*verbs, *_IRREGULAR_VERBS.split(), *PHRASES["verb"]):
        phrases.setdefault(tuple(verb.split()), "verb")
    for phrase in AVOIDING:
        phrases[tuple(phrase.split())] = "avoid"
    known = {word for phrase in phrases for word in phrase}
    aliases = [name for entry in names.ALIASES.items() for name in (entry[0], *entry[1])]
    for name in (*aliases, *nouns.NOUNS):  # "can" in "trash can" is no auxiliary
        phrase = name.split()
        if len(phrase) > 1 and known & set(phrase):
            phrases[tuple(phrase)] = "word"
            phrases[(*phrase[:-1], f"{phrase[-1]}s")] = "word"
    return phrases


TABLE = _table()
"""Words of a phrase → its kind."""

LONGEST = max(map(len, TABLE))
"""Number of words of the longest phrase."""

# Word of a count → its value.
NUMBERS = {
    "once": 1, "twice": 2, "thrice": 3, "single": 1, "a single": 1, "one single": 1,
    **{word: n for n, word in enumerate(SMALL_NUMBERS)},
    **{word: 10 * n for n, word in enumerate(TENS, 2)},
}  # fmt: skip
