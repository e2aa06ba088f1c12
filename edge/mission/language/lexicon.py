"""The vocabulary of the English grammar, by kind; any other word can only be part of a name.

Every verb means "reach" (ViTL IV-A1 reduces all action verbs to it). A phrase has one kind. The
longest matching phrase wins.
"""

from __future__ import annotations

import re

from edge import names
from edge.mission.language import nouns

# Kind → its phrases, separated by `;`; "(a|b) c" is both "a c" and "b c".
_ROWS: dict[str, str] = {
    # Words for the robot, moods, and words without meaning.
    "you": """
        you; we; i; the robot; you robot; the drone; the agent; the rover; the bot; the
        quadcopter; the vehicle; the delivery robot
    """,
    "ensure": """
        make sure; make sure that; making sure; making sure that; ensure; ensure that; ensuring;
        ensuring that; be sure; be sure that; being sure; remember; remembering; please make sure;
        take care; taking care; be careful; being careful; see to it that; seeing to it that; do
        not forget; never forget; without forgetting; do not fail; never fail; go ahead and;
        (i want|i need|i would like|we want|we need|i like|i would love|we would like|i expect|i
        should like|we should like)
        (you|the robot|the drone|the agent|the car|the vehicle);
        (your|the) (task|mission|goal|job|objective|aim|assignment) is
    """,
    "addressed": "drone; rover; bot; quadcopter; droid",
    "must": """
        must; should; shall; have; has; had; need; needs; need to; required; are required; is
        required; ought; will; supposed; are supposed; is supposed; obliged; are obliged;
        it is (necessary|needed|required|mandatory|essential|important) to;
    """,
    "can": """
        can; may; could; would; might; are allowed; is allowed; be allowed; allowed; are
        permitted; permitted; are free; are welcome; are good
    """,
    "needless": """
        it is not (necessary|required|needed|mandatory|forbidden|prohibited|banned|compulsory);
        (is|are) not (off limits|out of bounds)
    """,
    "do": "do; does; did; let; let us",
    "be": "be; is; are; was; were; been; being",
    "not": """
        not you dare; not dare; not even think about; (i|we) do not want (you|the robot|the drone);
        not; never; not ever; no; don; don t; doesn t; isn t; can t; won t; never ever; not
        welcome; are not welcome; is not welcome; prohibited from; are prohibited from; are
        forbidden; not allowed; are not allowed; not permitted; are not permitted; at no point; at
        no time; at no stage; under no circumstances; under no circumstance; on no account; in no
        case; by no means;
        it is (forbidden|prohibited|not allowed|not permitted|banned) to;
        (is|are|be|being|) (forbidden|banned|barred|prohibited) from
    """,
    "banned": """
        is prohibited; is forbidden; is not allowed; is not permitted; are prohibited; are banned;
        is off limits; are off limits; is out of bounds; are out of bounds; are forbidden; is
        banned
    """,
    "neither": "neither",
    # Reviewed: only these words can be removed from any sentence without changing its meaning.
    "filler": """
        at any point of time;
        whatever you do; whatever happens; so; listen; attention; today; be a dear and; be a
        pal and; buddy; my dear; dear; dude; my friend; hey there; hi there; hello there;
        good morning;
        me; us; for me; please; kindly; thanks; thank you; thank you very much; hi; hello; hey;
        ok; okay; alright; all right; robot; now; just; simply; also; too; as well; already;
        (would you|could you|) be so (kind|good) as to; (please|) help (me|us); in a straight line;
        it would be (nice|good|great|kind|lovely) if you (could|would);
        (just|) to be (on the safe side|safe|sure);
        directly; would you mind; do you mind; if you do not mind; when you have a minute; when
        you have time; when you have the chance; whenever you can; as many times as you want; on
        your travels; eventually; sometime; some time; at some time; at some point; at any time;
        at any point; at any point in time; at any stage; in the future; at some point in the
        future; some time in the future; sometime in the future; ever; at all; at all costs; in
        any way; under any circumstances; under any circumstance; no matter what; completely;
        totally; entirely; under any condition; under any conditions; no matter what happens;
        (sometime|some time|at some point|at some time|any time) today;
        on (your|this|the) (trip|journey|tour|round);
        there can be other (locations|landmarks|waypoints|places|stops) in between
    """,
    # Redundant in a ban or a condition; impossible for a goal.
    "always": """
        the whole way through; the whole time; the entire time; throughout; all along; the whole
        way; the entire way; at every point; at any moment; at every step; always; at all times;
        all the time; each time you do; at every moment;
        (for|during|throughout) the (whole|entire) (trip|mission|time|flight|journey);
        (for|during|throughout) the (trip|mission|flight|journey)
    """,
    "in the end": "in the end; at the end; at the very end; last",
    # Words that join clauses.
    "and": "and; plus; as well as; &",
    "or": "or; or else; or alternatively; alternatively; nor",
    "but": "but; however; though; yet",
    "then": """
        (and|) (that|this) done;
        and than;
        then; and then; then finally; and finally; finally; lastly; next; and next; after that;
        and after that; afterwards; afterward; and afterwards; and afterward; sometime afterward;
        sometime afterwards; and sometime afterward; and sometime afterwards; after this; and
        after this; followed by; thereafter; secondly; thirdly; fourthly; later; later on; some
        time later; and later; subsequently; move on; and then finally; second; third; fourth;
        fifth; then next; and lastly; after which; then after that; move on to; from there; and
        from there; from there on; from here; then from there; and then from there; then followed
        by; and then after that; and then later; and later on; next up; last of all; at last;
        sometime later; and sometime later; then sometime later; and then sometime later; then
        later; and then some time later; from then on; and from then on;
        (when|once|after|and when|and once|as soon as) (you are done|you are done there|that is
        done|this is done|done|done there|you are finished|you are finished there|you have done
        that|you have done so|there|you get there|you are there|you arrive there|you have arrived
        there);
        (|and|then|and then) (sometime|some time|at some point|at some time|soon|shortly|any
        time|eventually|not long) (after that|after this|afterwards|thereafter|later on);
        at (some|a) later (point|time|stage|moment);
        (your|the|and your|and the|) (second|third|fourth|fifth|next)
        (stop|destination|target|goal|waypoint|place|place to go|place to visit) (is|should
        be|will be|must be)
    """,
    "only then": "only then; and only then; only after that; and only after that; only afterwards",
    "first": "first; beforehand; first of all; to begin with; firstly; initially",
    # Conditions.
    "before": "before; prior to; ahead of; earlier than",
    "after": "after; following; having",
    "until": "until; till; up until; until after",
    "unless": "unless; if not; except after",
    "when": "when; as soon; as soon as; whenever; every time; each time; any time; if; if ever",
    "while": "while; whilst; during which; as long as",
    "without": """
        nowhere near; but nowhere near;
        without; without ever; with no; instead of;
        (with|) no (stops at|stop at|visits to|visit to|stopping at|detour through);
        without (any|a|) (stops at|stop at|visits to|visit to|detour through);
        (not|but not) (through|via|past|near|over|across|along|by way of)
    """,
    "via": """
        via; by way of; that crosses; which crosses;
        (by|by first|while|while first|when)
        (going|moving|passing|walking|driving|flying|traveling|travelling|heading)
        (through|via|past|along|by|across);
        (by|by first) (entering|visiting|crossing|using|going
        to|taking|following|traversing|stopping at|stopping by|passing);
        while (passing|crossing|traversing);
        (that|which) (goes|leads|passes|runs|takes you) (through|via|past)
    """,
    "bound": """
        (while|when) (heading|bound) for;
        en route to; on way to; on route to; while moving to; while going to; while heading to;
        while traveling to; while travelling to; when on the way to; while on the way to; when on
        your way to; while on your way to;
        (on the way|on your way|on its way|along the way|on your trip|on the trip|on your
        journey|on the road|on the route|on your route|on the path|on your path|on its path|along
        your path) (to|into|towards|toward);
        (when|in) (going|moving|walking|driving|flying|heading|traveling|proceeding)
        (to|towards|toward);
        (in order to|so as to) (reach|get to|go to|enter|get into);
        (while|as) you (go|head|move|drive|fly|walk|travel|make your way|are going|are heading|are
        moving|are flying|are on your way) (to|towards|toward)
    """,
    "bound there": """
        for this; to do so; to do this; to do that; to get there; to reach it; to get to it; in
        order to get there
    """,
    "on the way": """
        (while|as) you are getting there;
        on the road; on the route; along the path; in the way; in your way; in its way;
        (on|in|along) (your|its|our|their) (path|route); on the way; on your way; on its
        way; along the way; en route; on the way there; on your way there; on its way there; along
        your way; as you go; as you do so; while doing so; in doing so; while you do it; while you
        do so; as you do it;
        (while|as) you are (driving there|going there|heading there|moving there|on your way|at
        it|doing it|doing so)
    """,
    "around": "around; by going around; going around; by driving around; by walking around",
    "origin": """
        starting on; start on; beginning on; begin on; starting off at; start off at; starting
        from; starting at; starting in; starting out from; start from; start at; start in; start
        out from; beginning at; beginning in; beginning from; begin at; begin in
    """,
    "opener": """
        start by; begin by; start off by; starting by; beginning by; start with; begin with;
        starting with; beginning with;
        (your|the|) first (stop|destination|target|goal|waypoint|place|place to go|place to visit)
        (is|should be|will be|must be)
    """,
    "halt": """
        stay put; you are done; you can stop; you can stop there;
        (stay|stop|wait|remain|rest|be) there
    """,
    "onward": """
        (keep going|keep moving|keep walking|keep driving|keep flying|continue|proceed|go on|carry
        on|go|move|drive|walk|fly|continue on|move on|do not stop|never stop) (until|till)
    """,
    "immediately": """
        immediately; right; straight; straight away; right away; immediately in the next time step;
        (at|in) (the next|the very next) (step|instant|time step|time instant|instance)
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
        trip; trips; trip to; trips to; time; times; instances; separate instances; distinct
        times; separate times; occasion; occasions; separate occasions; different times; different
        occasions; times in total; distinct visit; separate visit; separate instance; different
        instances; times overall; separate visits; visits; visits to; visit to; separate visits
        to; in total; distinct visits; distinct visits to
    """,
    "at least": """
        minimum; minimum of; at least; a minimum of; no less than; no fewer than; not less than;
        on at least; equal or more than; equal to or more than; greater than or equal to; more
        than or equal to
    """,
    "at most": """
        at most; a maximum of; no more than; not more than; up to; on at most; maximum; equal or
        less than; equal to or less than; less than or equal to
    """,
    "quota": """
        (the maximum|the minimum|the required|maximum|minimum) (number
        of|allowable|allowed|allowable number of|allowed number of|permitted) (visits to|separate
        visits to|distinct visits to|passes through|separate passes through|times you can
        visit|times you can reach|times you may visit|times you must visit|times you must
        reach|times you visit|times you should visit|times to visit)
    """,
    "exactly": "exactly; precisely; on exactly; just exactly; no more no less; no more and no less",
    "more than": "more than; greater than; any more than; more often than",
    "less than": "less than; fewer than; any less than; any fewer than",
    "more or less": """
        more or less than; any more or less than; any more or fewer than; no fewer or greater
        than; any greater or fewer than; greater or fewer than; any more or any fewer than; any
        more or any less than
    """,
    "or more": "or more; or more than; or more often; and more",
    "or less": "or less; or fewer; or less often; or fewer times",
    "only": "only; solely",
    "out of turn": "out of turn; out of order; out of sequence",
    "no return": """
        no revisiting; no revisits; no going back; no turning back; repeated visits are not
        permitted; repeated visits are not allowed;
        (no|without any|without) (repetition|repetitions|repeats|repeated visits);
        no (revisiting|revisits|returning|going back|turning back|repeated visits|repetitions) (is
        allowed|are allowed|allowed|is permitted|are permitted|permitted)
    """,
    "repeat": "repeat; repeat this; repeat that; repeat it; do this; do that; do it",
    "again": """
        again; anymore; any more; any longer; a second time; another time; once again; once more
    """,
    # Order.
    "any order": """
        either one first; either first;
        in any order; in any order you like; in no particular order; in no specific order; in
        arbitrary order; in an arbitrary order; in whatever order; any order; the order is not
        important; the order does not matter; order does not matter; it can be done in any order;
        regardless of order; in whichever order; in a random order; in whichever order you like;
        in any order you want; in whatever order you like; in either order; in any order required;
        the order is up to you; the order is arbitrary; order is not important; whatever order you
        like; whichever order you like; order is up to you; order is arbitrary; in whatever order
        suits you; in whichever order suits you; in no set order; in no fixed order; either one
        can be first; either can be first; either one may come first; either may come first;
        either one can come first; either can come first;
        (in whatever|in whichever) order (is|seems) (quickest|easiest|fastest|shortest|best);
        (any|whatever|whichever|either) order (is|will be) (fine|okay|ok|good|all right|alright);
        (any|whatever|whichever) order (works|will do|goes|suits you|you want|you prefer);
        (it does not matter|does not matter|it makes no difference|i do not care|i do not mind|
        no matter|you can choose|you can pick|you can decide|you choose|you pick|you decide)
        (in which order|in what order|which order|what order|the order|which first|
        which one first|where you start|which to visit first|
        (which one|which) (you visit|is|comes|goes|you do|you go to|you take|you start with)
        first|which one you start with);
        start with (whichever|whichever one) you (like|want|prefer)
    """,
    "whichever": """
        any one; either one; or both; your pick; your choice; the choice is yours; you choose; you
        decide; either is fine; either one is fine; either will do; either one will do;
        (whichever|whichever one) (you like|you prefer|you want|you choose|suits you|is closer|is
        closest|is nearer|is nearest|is easier|is quicker|is faster|is first|comes first|you find
        first|you see first|you (get to|come to|reach|spot|meet|come across|notice) first|
        you can find|you find|you see|works|will do);
        (the first|first) (you see|you find|you spot|you get to|one you see|one you find|
        one you spot|one you get to|one you come across);
        (one of them|one of these|one of the two|just one of them|only one of them|one|just one)
        (is|will be|would be) (enough|fine|okay|ok|good); one of them will do; one will do;
        (any|any one|either) of (them|the two|these) (is fine|is okay|will do|works);
        either (works|is okay|is ok|is good); (both|both of them) are (fine|okay|ok)
        (the one|any one|either one) (you like|you prefer|you want|that you prefer|you choose);
        (it does not matter|i do not care|i do not mind) (which|which one)
    """,
    "in order": """
        in order; in that order; in this order; in the order given; in the given order; in turn;
        in sequence; sequentially; consecutively; one after another; one after the other; in this
        sequence; in that sequence; one by one
    """,
    "strict order": """
        in strict order; in strictly this order; in this strict order; in that strict order; in
        this exact order; in that exact order; in exact order; in this specific order; in that
        specific order; in exactly this order; in exactly that order; strictly in order; strictly
        in this order; in the exact order; in the strict order; in that exact sequence; in this
        exact sequence
    """,
    # Parts of noun phrases.
    "article": """
        (any|each|every|a) trip to; each visit to;
        the; an; some; any; my; our; your; his; her; their; any visit to; any visits to; a visit
        to; every visit to
    """,
    "pronoun": "it; that; there; them; this; those; these; that one; this one; the same",
    "either": "either; one of; either one of; either of; any of; any one of; at least one of",
    "all of": """
        both; both of; all of; each of; all; all the following; the following; every one of; each;
        every
    """,
    "group": """
        locations; location; place; places; landmarks; landmark; waypoints; objects; targets;
        rooms; things
    """,
    "place": """
        near; next to; beside; in; inside; on; under; below; above; behind; in front of; close to;
        opposite; against; of
    """,
    "to": "to; towards; toward; over to; through; into; onto; in to; inside of",
    "happen": """
        happen; happens; happened; happening; occur; occurs; occurred; occured; occurring; hold;
        holds; hold true; holds true; become true; becomes true; be true; is true;
        (is|should be|will be|must be) (your|the) (goal|target|destination|final destination|final
        goal|objective|final target);
        is where you (finish|end|end up|need to be|have to be|should be|must be|must go|need to
        go|have to go|are going|should go|should finish|should end up)
    """,
    # Only known to be refused with a reason, see `tokens.REASONS`.
    "endless": """
        keep visiting; continuously; repeatedly; infinitely; endlessly; perpetually; again and
        again; over and over again; over and over; patrol; cycle through; back and forth;
        infinite; an infinite number of; do not stop visiting; do not stop going; never stop
        visiting; never stop going; do not ever stop; can not stop; not stop visiting; not stop
        going
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
        show up; turn up; (swing|swinging) (past|through|into|over to);
        (end|finish|conclude) (your|the|this) (trip|journey|tour|route|way) (at|in|on|with|by);
        make your way; making your way; made your way; go near; going near; come near; get near;
        continue to; continue on to; continue into; continue through; continue on into; keep going
        to; keep moving to; keep walking to; go on to; carry on to; make a detour; making a
        detour; take a detour; make a pass through; making a pass through; find yourself in; find
        yourself at; make it; makes it; making it; cut through; cutting through; cut across; set a
        wheel; setting a wheel; check in; checking in; deliver to; delivering to; make a delivery;
        making a delivery; make a round of; do a round of; do the rounds of; find your way; get
        yourself; bring yourself; take yourself; pay a visit; drop by; drop in at; swing by; stop
        by; stopping by; stop off; set foot; setting foot; gain access; end up; ends up; ending up;
        (go|come|get|going|coming) anywhere near;
        deliver (this|the|a|my) (package|parcel|letter|order) (to|at);
        (your|the|) (final destination|destination|last stop|last place|last place to go|last
        place to visit|final stop|final place) (is|will be|should be|must be);
        (move|drive|send|steer|guide|fly|navigate|take|bring|get|direct|moving|driving|taking)
        (the robot|the drone|the agent|yourself|itself);
        (take|use|follow|choose) (a|any|the) (road|path|route|way)
        (through|past|along|across|via);
        (take|taking|have|having) a (look|peek|glance);
        your (path|route|way|tour|trip|journey) (ends|should end|must end|will end)
        (at|in|on|with);
        (make|making) (a|any|any single) (stop|visit);
        (take|find|follow|choose|use) (a|any|the|some|the shortest|the quickest|the fastest)
        (path|route|road|way);
        (end|ends|ending|finish|finishes|finishing|stop) (up at|up in|up on|at|in|on|up
        by|by|with|up with)
    """,
    "avoid": """
        (stay|staying|keep|keeping|steer|steering) (well|far|right) (clear of|away from|out of);
        avoid; avoids; avoiding; avoided; bypass; bypassing; stay away from; staying away from;
        keep away from; keeping away from; keep avoiding; stay clear of; staying clear of; steer
        clear of; steering clear of; keep off; stay off; keep out of; stay out of; skip; skipping;
        keep clear of; go anywhere but; visit anywhere but; go anywhere except; go anywhere other
        than; by avoiding; by bypassing; refrain from; ignore; leave out; leaving out; staying out
        of; keeping out of; keeping off; keep well away from; stay well away from; keeping clear
        of; getting around;
        (that|which) (avoids|bypasses|skips);
        (taking|by taking|using|by using|following) (a|any|the) (path|route|road|way) (that
        avoids|which avoids|that does not go through|that does not pass through);
        (by|on|along|via|using|only on|only along|only by) (a|any) (road|path|route|way) (that
        avoids|which avoids|that bypasses|that does not go through|that does not pass through);
        (that|which) (does not|never) (go past|go over|go through|pass through|goes through|passes
        through|enter|enters|cross|crosses|pass|touch|use|uses|lead through|take you through)
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

# Contraction or informal spelling → its words.
CONTRACTIONS = {
    "can't": "can not",
    "ur": "your", "pls": "please", "plz": "please", "gotta": "have to", "wanna": "want to",
    "gonna": "going to", "lemme": "let me", "untill": "until", "'til": "until",
    "anytime": "any time", "thru": "through", "isnt": "is not", "dont": "do not",
    "didnt": "did not", "cant": "can not", "wont": "will not", "cannot": "can not",
    "won't": "will not", "shan't": "shall not", "let's": "let us", "i'm": "i am", "im": "i am",
    "ive": "i have", "youre": "you are", "where'd": "where did",
    "everything's": "everything is",
    **{f"{word}{end}": f"{word} is" for word in ("where", "what", "there", "that")
       for end in ("s", "'s")},
    **{f"{word}'s": f"{word} is" for word in ("it", "he", "she", "here", "how", "who")},
}  # fmt: skip
# "2nd", "twenty-one"
_NUMERAL = re.compile(r"(\d{1,2})(?:st|nd|rd|th)")
_COMPOUND = re.compile(rf"({'|'.join(names.TENS)})-({'|'.join(names.SMALL_NUMBERS[1:10])})")
# End of a contraction → the words that replace it.
ENDINGS = {"n't": " not", "'ve": " have", "'re": " are", "'ll": " will", "'d": " would"}


def expand_word(word: str) -> list[str]:
    """Return the words for which a word stands: `don't` is do, not; `2nd` is second."""
    if word in CONTRACTIONS:
        return CONTRACTIONS[word].split()
    if (numeral := _NUMERAL.fullmatch(word)) and 0 < int(numeral[1]) < len(nouns.NUMERALS):
        return [nouns.NUMERALS[int(numeral[1]) - 1]]
    if compound := _COMPOUND.fullmatch(word):
        return [compound[1], compound[2]]
    for ending, full in ENDINGS.items():
        if word.endswith(ending) and len(word) > len(ending):
            return (word[: -len(ending)] + full).split()
    return [word]


# Word of a count → its value.
NUMBERS = {
    "once": 1, "twice": 2, "thrice": 3, "single": 1, "a single": 1, "one single": 1,
    **{word: n for n, word in enumerate(names.SMALL_NUMBERS)},
    **{word: 10 * n for n, word in enumerate(names.TENS, 2)},
}  # fmt: skip

WORD = re.compile(r"[^\W_]+(?:['\-_][^\W_]+)*")
"""A word: letters and digits, with single ' - _ between them, as in "don't" and "twenty-one"."""
