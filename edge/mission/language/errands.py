"""Rewriting of everyday errands into plain orders with quoted propositions.

Checks, explorations, patrols, waits and objects with a relation become `go to "check stove"`,
`go to "explored kitchen"`, `go to "wait 30 s"`, `find "mug in the kitchen"`. Each quoted
proposition is the canonical text of a destination (see `edge.mission.destinations`). `spell_out`
applies the rules in a fixed order; the translators read its result.

A text begins with a space while the rules rewrite it, so each word of a pattern follows a space.
The slots of a match are its named groups; see `templates`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Union

from edge import names
from edge.mission.language import nouns
from edge.mission.language.errand_parts import PARTS
from edge.mission.language.everyday_words import (
    AFTER_A_NAME,
    ARTICLE,
    MARK,
    NAME,
    NOWHERE,
    PLAIN_NAME,
    bare,
    is_room,
    is_vague,
    phrase_of,
)
from edge.mission.language.impossible import refuse_impossible
from edge.mission.language.lexicon import TABLE
from edge.mission.language.places import (
    EXPLORED,
    HERE,
    START,
    is_marked,
    mark_places,
    restore_places,
)  # fmt: skip
from edge.mission.language.spans import COUNT, DURATION, number_of, seconds_of
from edge.mission.language.templates import END, STOP, compile_templates
from edge.mission.language.tokens import UnclearError
from edge.mission.language.unsupported import BEYOND_NAMES

WAIT, CHECK = "wait", "check"
"""First words of propositions; see also `places`."""
CALLER = "caller"
"""Name of the pose of the person who gives the order."""
MAX_ROUNDS = 10
"""Largest number of rounds of a patrol that becomes one sequence of stops."""

_CHECKS = """
    {then} {drive} {over} (in|into|to|inside|down|along|through) <into> and [then] {check}
            ({if} there (is|are)|[if] (is|are) there) {still} <thing> [there|around|here]
    {then} {drive} {over} (in|into|to|inside) <into> and [then] {check} {if} <thing> (is|are)
            {still} (there|in there)
    {then} {drive} {over} (in|into|to|inside|down) <into> , [and] [then] check [on|for] <thing>
            there
    {then} {goes} {check} {if} there (is|are) {still} <thing> {at} [there|around|here]
    {then} {goes} {check} {if} <thing> (is|are) {still} (there|here|around|in place|at home|present)
    {then} {goes} {check} {if} <thing> (is|are) {at}
    {then} {goes} {check} {if} (i|we) [have] (left|put|forgot|forgotten|dropped) <thing> {at}
    {then} {goes} {check} {if} you [can] see <thing> {at} [there|around|here]
    {then} {goes} {check} [if] (is|are) [there] <thing> {at} [there]
    {then} {goes} check for <thing> {at}
    {then} {goes} check [on] <thing> {at} [for me|for us]*
    {then} {goes} {check} <room> for <thing>
"""
_SEARCHES = """
    (search|scan|look|(have|take) a [good|quick|little|proper|close]* look)
            [around|round|in|at|inside|through]* <room> for <thing>
    (search|look) {whole} for <thing>
"""
_EXPLORES = """
    {goes} ({look}|look) {whole} [{whole}] [and|then] [map|scan|look at|explore]
            [everything] {time}
    {goes} {look} <stops> {time}
    {goes} (see|look|check|find out) what is (in|inside) <room>
    {goes} {look} <room> [, (only|just) (this|that) (room|one)] {time}
    give (<room>|{whole}) a [good|proper|quick|thorough|full|little|complete]*
            (once-over|once over|look|scan|sweep|look over|check|going over|look-over|inspection)
            {time}
    (have|take|make) a [good|proper|quick|close]* (look|scout|nose|wander)
            (round|around|in|at|inside) (<room>|{whole})
            {time}
"""
_EXPLORES_HERE = """
    {then} {goes} (explore|exploring|look around|look round|scan|survey|wander|wander around|
            have a look around|take a look around|roam around|drive around|go exploring|map|
            be [an|a|the] explorer|make [an] exploration) {time}
"""
_PATROLS = """
    {patrol} <stops> , [for] <count> {rounds} [each|please|in total]
    {patrol} <stops> , <often>
    {patrol} <stops> , [and] [keep it up] [for|during] <span> [long]
    {patrol} <stops> , (forever|until (told|further notice)|until (i|we|you hear) ...|
            all (day|night|the time)|over and over [again]|again and again)
    ({patrol}|(go|drive) to) <stops> , [and] [just|then]* (forever [and ever]|keep
            (doing|repeating) (it|that|this) [forever|over and over|again]*)
    {patrol} <count> {rounds} (of|between|around|through|from|in|at) <stops>
    (do|make|drive|go|run|walk) <count> {rounds} [of|between|around|through|from|in] , <stops>
"""
_ROUNDS_FIRST = (
    "<count> {rounds} [of|between|around|through|from|in|[you] make (the|a) (tour|round|loop)]* , "
    "<stops>"
)
_ERRAND_AND_BACK = """
    {drive} {over} to <thing> , {back} , <often>
    {drive} {over} to <thing> , {back} , [for] <count> {rounds}
"""
_STARTS = """
    {then} ((come|go|get|drive|head|run|return|move) [yourself] [back|home]*|back) to {home}
    {then} (come|go|get|drive|head|run|return|move) [back|home]* to [the|your] (start|beginning|
            (start|starting) (point|place|position|pose|spot))
"""
_BACK_TO = "{then} (return|[come|go|get|drive|head|run|move|be] [straight|right] back) to <thing>"
_CALLS = (
    "[over here [mate|robot|to me|to us] ,] (come|drive|get|move|roll) [over|right|up|here]* "
    "(here|to me|to us|to (where|wherever) (i am|we are)) "
    "[[for] (a|one) (minute|moment|second|sec|bit)]"
)
_BACKS = "{then} {back}"
_WAITS = """
    {then} {hold} [for] <span> {where} <thing>
    {then} {hold} {there} [for] <span> [there|here]
    {then} {hold} {where} <thing> [for] <span>
    {then} wait [for (me|us)] {where} <thing>
    {then} stay [for (me|us)] (at|by|near|next to|in front of) <thing>
    {then} (wait|stay) (there|here|in there) [for me|until i (come|am there|get there|call|say) ...]
"""
# "the mug on the desk in the kitchen" (slot `within`), "the chair between the bed and the sofa"
# (`other`), "the mug on the desk or by the bed" (`again`, `else`)
_RELATED = re.compile(
    rf" (?P<thing>{NAME})(?: {phrase_of('standing')})? (?P<relation>{phrase_of('relation')})"
    rf" (?P<anchor>{NAME})(?P<within> (?:in|inside) {NAME})?(?: and (?P<other>(?:the|a) {NAME})"
    rf"| or (?:(?P<again>{phrase_of('relation')}) )?(?P<else>{NAME}))?(?=[ ,.;!?]|$)",
    re.I,
)
# "we need the mug. Please find it.", "the mug next to the sofa: go to it", "a cup or a mug: find
# either", "I lost the mug, look for it in the hall". The slot `order` has the words before the
# pronoun, `any` is "either" or the like, and `later` and `at` are the relation at the end.
_INTRODUCED = re.compile(
    r"^ (?P<opening>there (?:is|are) |(?:we|i) (?:need|want|am looking for|can not find|"
    r"(?:am |are )?miss(?:ing)?|can not (?:think|remember) where (?:i|we) (?:put|left)|"
    r"(?:think (?:that )?i )?(?:seem to )?(?:have )?(?:lost|left|misplaced|forgot|forgotten)) "
    r"|either )?"
    rf"(?P<thing>{NAME})(?: {phrase_of('standing')}|"
    r" (?:(?:should|must|ought to|will) be|is|are)(?: still| probably)*)?"
    rf"(?: (?P<relation>{phrase_of('relation')}) (?P<anchor>{NAME})| or (?P<other>{NAME}))?"
    r"(?: (?:somewhere|anywhere|again))?"
    r"(?:[,.;!:]+|(?= (?:find|look|go|search)\b)) "
    r"(?:so |please |kindly |and |(?:can|could|would|will) you )*"
    r"(?P<order>[^,.;!?]*?) (?:it|them|that|(?P<there>there)|(?P<any>either(?: of them)?|"
    r"one of (?:them|these|those|this)|whichever(?: (?:one )?you (?:can )?find)?))(?: there)?"
    rf"(?: (?P<later>{phrase_of('relation')}) (?P<at>{NAME}))?(?=[,.;!?]|$)",
    re.I,
)
_GO_THERE = re.compile(r"^(?:go|drive|head|get|run|move|park)(?: yourself| over| up)?$", re.I)
_FIND = rf"(?:{phrase_of('find')}|find|get to|go to|locate)"
# "reception, but not through the hall", "room 3 first, then room 5"
_ROOM_FIRST = re.compile(
    rf"^ (?P<name>{NAME})(?=(?: first)?(?:,? (?:and )?then |,? but |,? without )| first, )", re.I
)
# "find the mug, it should be on the desk"
_HINTED = re.compile(
    rf"(?P<order> {_FIND}) (?P<thing>{NAME})(?:[,.;]|(?= it| they)) (?:(?:it|they|he|she)"
    rf" (?:is|are|(?:should|must|will) be)|i (?:have )?(?:left|put) (?:it|them))"
    rf"(?: {phrase_of('standing')})? (?P<relation>"
    rf"{phrase_of('relation')}) (?P<anchor>{NAME})(?: i think)?{END}",
    re.I,
)
# "I need the mug to be found"
_WANTED_FOUND = re.compile(
    rf"^ (?:i|we) (?:need|want|would like) (?P<thing>{NAME}(?: {phrase_of('relation')} {NAME})?)"
    r" (?:to be )?found(?=[.!]*$)",
    re.I,
)
# "the nearest chair to the desk"
_NEAREST = re.compile(
    rf" (?:the )?(?:nearest|closest) (?P<thing>{PLAIN_NAME})"
    rf" (?:to|from|of) (?P<anchor>{NAME}){END}",
    re.I,
)
# "the room with a piano"
_ROOM_WITH = re.compile(
    rf" (?P<thing>(?:the )?room) (?:with|that has) (?P<anchor>{NAME}){END}", re.I
)
# "so you can go into the kitchen again"
_PERMITS = re.compile(
    r"(?:so |and )?(?:you|the robot) (?:now )?(?:can|may|are (?:allowed|free|welcome) to) (?:now )?"
    rf"(?:go|come|drive|enter|move|get)(?: (?:back|in|into|to|inside))* {NAME}(?: again)?[.!?]*$",
    re.I,
)
# Other spelling of a relation → the relation.
_RELATIONS = {
    "near of": "near", "near to": "near", "nearby": "near", "next of": "next to",
    "beside of": "beside", "behind of": "behind",
}  # fmt: skip
# A word after which a name without an article may come.
_LEADS_TO_NAME = re.compile(
    r"\b(?:find|to|for|me|us|or|avoid|near|reach|visit|locate|spot|see|seek|get)$", re.I
)
_WHICH_ROOM = re.compile(r" (?:the )?(?P<which>next|largest|biggest|smallest) room(?! \d)\b", re.I)
# `"wait 30 s" and go on`
_AFTER_WAIT = re.compile(r'(?P<wait>"wait[^"]*")(?:,? and(?: then)?|,)(?= (?!then)\w)')
_EXPLORED_TWICE = re.compile(r'( go to "explored")(?:,? and(?: then)? go to "explored")+')
# "rooms 3, 4 and 5", and not "bays 2 and 3 times"
_NUMBERED = re.compile(
    r"\b(?P<kind>room|aisle|bay|ward|unit)s (?P<numbers>\d+\w?(?:(?:,? (?:and|or|then) |, )"
    r"\d+\w?)+)\b(?! (?:times|rounds|min|sec|hour))",
    re.I,
)
_FIRST_REWRITES = (
    # "afterwards to the hall", "and then into the hall"
    (re.compile(r",? after(?:wards)? to\b(?! the (?:right|left))", re.I), ", then to"),
    (re.compile(r",? (?:and )?(?:(?:after|afterwards|then) (?:in|into)|at the end (?:in|into|to))"
                rf" (?={ARTICLE} |{phrase_of('room')}\b|{MARK})", re.I), ", then to "),
    # "and keep going until …"
    (re.compile(r",?(?: and)? (?:keep (?:going|on|at it|driving|doing (?:it|that))|carry on|"
                r"go on|repeat (?:it|that|this)|over and over(?: again)?|again and again)"
                r"(?=,? (?:until|forever)\b)", re.I), ""),
    # "three rounds: the hall and …", "patrol the hall and the office. Three rounds."
    (re.compile(r"\b(rounds|laps|loops|circles|tours|times):(?= )", re.I), r"\1,"),
    (re.compile(rf"[.;](?= (?:for )?{COUNT} (?:rounds|laps|loops|times)[.!]*$)", re.I), ","),
    # "for ten minutes, patrol the hall and …"
    (re.compile(rf"^ (?:for|during) (?P<span>{DURATION}),? (?P<order>(?:patrol|explore|guard)\b"
                r"[^.;!?]*)", re.I), r" \g<order> for \g<span>"),
    # "and when you are done, come back"
    (re.compile(r",? and (?:when|once|after) you (?:are|have) (?:finish|finished|done|ready),?"
                r"(?= (?:go|come|drive|return|find|look|visit)\b)", re.I), ", then"),
    # "somewhere in the hall", "go really fast and …", "…, have a look for it"
    (re.compile(r"\bsomewhere (?=(?:in|on|at|under|near) )", re.I), ""),
    (re.compile(r" (?:super |very |really )(?:fast|quick)(?=,? and\b)", re.I), ""),
    (re.compile(r"(?<=, )(?:can you |could you )?have a look for (?=it\b|them\b)", re.I), "find "),
    # "and after go to …"
    (re.compile(r"(?:,|,? and) after(?: you)?(?= (?:go|come|drive|return|find|look)\b)", re.I),
     ", then"),
    # "a cup or one mug", "find me one mug"
    (re.compile(r"\bor one (?=\w)(?!of\b|more\b)", re.I), "or a "),
    (re.compile(r"\bfind(?: for)?(?: me| us)? one (?!of\b|or\b|more\b)", re.I), "find a "),
    (_NUMBERED, lambda found: re.sub(r"(?=\b\d)", f"{found['kind']} ", found["numbers"])),
    # "before you have been to the hall", "passing close to it", "and stop right there."
    (re.compile(r"\b(before|until|unless) you have been (?:past|to|by|through|at|in)\b", re.I),
     r"\1 you have visited"),
    (re.compile(r"\bpass(ing)? (?:near|close)(?: to| by)?\b", re.I), r"pass\1 by"),
    (re.compile(r",? (?:and|then|and then) stop (?:right )?there(?=[.!]*$)", re.I), ""),
)  # fmt: skip
"""Replacements before all others: lists of numbered rooms, and other words for known ones."""
_THERE_AND = re.compile(
    rf"(?P<go>(?:go|drive) to (?P<room>(?:the )?{NAME})|find {NAME}),? and"
    rf"(?= (?:(?P<finds>find|look for)|look at|inspect|examine|{phrase_of('work')}) )",
    re.I,
)
_UNCLEAR = (
    (  # `"explored hall", then the bed`, `"red mug" or under the …`, `"mug on the desk" and the …`
        re.compile(
            rf'"(?:{EXPLORED}|{CHECK}|{WAIT})\b[^"]*"(?:,| and then| and| or| then)+ '
            rf'(?:{ARTICLE} |")'
            rf'|"[^"]* [^"]*" (?:and|or) {phrase_of("relation")} '
            rf'|"[^"]* {phrase_of("relation")} [^"]*" (?:and|or) '
            rf"(?:{ARTICLE}|{phrase_of('room')}) ",
            re.I,
        ),
        "unclear what to do with the second thing; name it in a sentence of its own",
    ),
    (
        re.compile(r'\bon (?:the|your) way,? (?:there,? )?(?:then )?go to "', re.I),
        "unclear order; say first what the robot does first",
    ),
    (
        re.compile(r"(?<=\w) stop (?=(?:go|come|drive|find|look|return)\b)", re.I),
        "unclear if the robot stops there or goes there instead; use two sentences",
    ),
    (  # "go to the room and …"
        re.compile(
            rf"\b(?:{ARTICLE}|every|each|any|all) rooms?"
            r"(?=[.,;!?]|$| (?:and|then|but|or|again|for)\b)",
            re.I,
        ),
        "unclear which room; name it",
    ),
    (
        re.compile(r"\b(?:check|see|look|find out|verify) (?:if|whether)\b", re.I),
        "the robot can only check whether a thing is there; say for example 'check whether the "
        "stove is in the kitchen'",
    ),
)
"""Pattern of a text that is still unclear after all rules, and the hint of its refusal."""
_NO_OBJECT = re.compile(rf"(?:{EXPLORED}|{WAIT})\b|(?:{HERE}|{START}|{CALLER})$")
# Between the names of "mug on the desk", "room with a piano".
_BETWEEN_NAMES = re.compile(rf" (?:{phrase_of('relation')}|with|and)(?: the)? ")
# The mark or word before a clause.
_CLAUSE_START = r"(?P<lead>(?:^|[.;,!?]|\b(?:and|then|or)) )"
_GOES_TO = re.compile(rf"{_CLAUSE_START}{phrase_of('go to')} (?P<name>\"[^\"]*\"|{NAME})", re.I)
_GOES_ROOM = re.compile(rf"{_CLAUSE_START}(?:go|drive|come) (?P<name>{NAME})", re.I)
_IN_TURN = "go to <stops>"
_FINDS = re.compile(rf"{_CLAUSE_START}{phrase_of('find')} (?P<name>\"[^\"]*\"|{NAME})", re.I)
_COMPOUND = re.compile(rf" (?P<name>{NAME})(?= {AFTER_A_NAME}\b|[,.;!?]|$)", re.I)
_Change = Callable[[re.Match[str]], Union[str, None]]  # None keeps the match
_JOINT = r",? (?:and then|and|then|or) |, "  # between the stops of an exploration


def spell_out(text: str, places: Iterable[str] = ()) -> str:
    """Return an errand in plain words with its destinations as quoted propositions.

    Raises:
        UnclearError: a part is unclear, or the robot cannot do it with wheels, a camera and text.

    Example:
        >>> spell_out("go and check whether the kettle is in the kitchen, then come back")
        'go to "check kettle in the kitchen", then go to "here"'
    """
    if permits := _PERMITS.match(text):
        hint = "unclear if an order or a permission; say 'go to …', or 'you may go to … again'"
        raise UnclearError(f"instruction: {permits[0]!r}: {hint}", permits[0])
    marked, known = mark_places(text, places)
    text = f" {marked}"
    for pattern, plain in _FIRST_REWRITES:
        text = pattern.sub(plain, text)
    for patterns, change in _rules():
        for pattern in patterns:
            text = _rewrite_outside_quotes(pattern, change, text)
    text = _EXPLORED_TWICE.sub(r"\1", text)
    _refuse_unknown_names(text)
    text = restore_places(text, known)
    text = _AFTER_WAIT.sub(r"\g<wait>, then", text)
    for unclear, hint in _UNCLEAR:
        if found := unclear.search(text):
            part = found[0].strip()
            raise UnclearError(f"instruction: {part!r}: {hint}", part)
    refuse_impossible(text.strip())
    return text.strip()


@cache
def _rules() -> list[tuple[list[re.Pattern[str]], _Change]]:
    """Return the patterns of each rule and the function that replaces a match.

    The order matters: each rule sees the text of the rules before it, and none changes what is in
    quotes already. The templates are compiled at the first call, which takes 0.2 s.
    """
    rules: tuple[tuple[str | list[re.Pattern[str]], _Change], ...] = (
        ([_HINTED], _rewrite_hinted),
        ([_WANTED_FOUND], lambda found: f" find {found['thing']}"),
        ([_NEAREST], lambda found: f" the {found['thing']} nearest to {found['anchor']}"),
        ([_INTRODUCED], _rewrite_introduced),
        ([_ROOM_FIRST], _rewrite_room_first),
        (_SEARCHES, _rewrite_search),
        (_PATROLS, _rewrite_patrol),
        # Only at the start of the text.
        (_ROUNDS_FIRST, lambda found: None if found.start() else _rewrite_patrol(found)),
        (_ERRAND_AND_BACK, _rewrite_errand_and_back),
        (_CHECKS, _rewrite_check),
        (_EXPLORES, _rewrite_exploration),
        (_EXPLORES_HERE, _rewrite_exploration_here),
        ([_ROOM_WITH, _RELATED], _quote_related),
        ([_WHICH_ROOM], _quote_which_room),
        ([_GOES_ROOM], _insert_to),
        ([_GOES_TO], lambda found: f"{found['lead']}go to {_with_article(found['name'])}"),
        (_IN_TURN, _rewrite_list_in_turn),
        ([_FINDS], lambda found: f"{found['lead']}find {found['name']}"),
        ([_THERE_AND], _insert_then),
        ([_COMPOUND], _quote_compound),
        (_STARTS, lambda found: _go_to(START, found)),
        (_BACK_TO, _rewrite_back_to),
        (_BACKS, _rewrite_back),
        (_CALLS, lambda found: f' go to "{CALLER}"' if not found.start() else None),
        (_WAITS, _rewrite_wait),
    )
    return [(compile_templates(p, PARTS) if isinstance(p, str) else p, change)
            for p, change in rules]  # fmt: skip


def _refuse_unknown_names(text: str) -> None:
    """Refuse a quoted proposition with a word that is no known object, such as a typing error."""
    for phrase in text.split('"')[1::2]:  # the texts in quotes
        if _NO_OBJECT.match(phrase):
            continue
        for name in _BETWEEN_NAMES.split(phrase.removeprefix(f"{CHECK} ")):
            if name.strip() and not _is_name(name):
                words = name.split()
                odd = words[nouns.unknown_in(words) or 0]
                slip = f" ({meant}?)" if (meant := nouns.suggest_word(odd)) else ""
                hint = (
                    f"not a known object or room{slip}; if it is an object, "
                    f'write "{phrase}" in double quotes'
                )
                raise UnclearError(f"instruction: {name!r}: {hint}", name)


def _is_name(name: str) -> bool:
    """Return True for a known name, or a new one for a kind of a known thing: "crash trolley"."""
    words = bare(name).partition(" of ")[0].split()
    if re.fullmatch(MARK, name) or is_room(bare(name)) or nouns.unknown_in(words) is None:
        return True
    # "crash trolley": the known noun begins at word 1, and "crash" may stand before it.
    head = next((i for i in range(len(words)) if nouns.is_noun(" ".join(words[i:]))), None)
    return head is not None and all(map(_modifies, words[:head]))


def _rewrite_outside_quotes(pattern: re.Pattern[str], change: _Change, text: str) -> str:
    """Replace the matches of a pattern outside quotes.

    Args:
        pattern: the pattern.
        change: returns the replacement of a match; None keeps the match.
        text: the text.
    """

    def replace(found: re.Match[str]) -> str:
        # The match begins in quotes, or only one of its ends is in quotes.
        if text.count('"', 0, found.start()) % 2 or found[0].count('"') % 2:
            return found[0]
        new = change(found)
        return found[0] if new is None else new

    return pattern.sub(replace, text)


def _go_to(proposition: str, found: re.Match[str] | None = None) -> str:
    """Return `go to "proposition"`; with "then" if the match is not at the start of the text."""
    later = found is not None and found.start() > 0
    return f'{", then" if later else ""} go to "{proposition}"'


def _rewrite_introduced(found: re.Match[str]) -> str | None:
    """Put the thing that the first clause names in place of the second clause's pronoun."""
    slots = found.groupdict()
    thing = bare(found["thing"])
    relation, anchor = slots["relation"] or slots["later"], slots["anchor"] or slots["at"]
    where = _relation_text(relation, anchor)
    # Without an article, "look" is a verb.
    verb = thing == slots["thing"].lower() and TABLE.get((thing.split()[0],)) == "verb"
    known = slots["opening"] or (_is_name(thing) and not verb)
    if slots["relation"] and slots["later"]:
        return None
    if where is None or not known or bool(slots["any"]) != bool(slots["other"]):
        return None
    other = f" or the {bare(slots['other'])}" if slots["other"] else ""
    # "there is a mug on the desk, go there" asks to go to it; "look there" stays as it is.
    order = _GO_THERE.sub("go to", found["order"]) if slots["there"] else found["order"]
    if slots["there"] and order == found["order"]:
        return None
    return f" {order} the {thing}{where}{other}"


def _rewrite_room_first(found: re.Match[str]) -> str | None:
    """Put "go to" before a room or place at the beginning."""
    name = bare(found["name"])
    return f" go to {_with_article(found['name'])}" if is_room(name) else None


def _rewrite_hinted(found: re.Match[str]) -> str | None:
    """Return "find the mug, it should be on the desk" as the order to find the mug on the desk."""
    thing, where = bare(found["thing"]), _relation_text(found["relation"], found["anchor"])
    if where is None or is_room(thing) or is_marked(thing) or is_vague(thing):
        return None
    return f"{found['order']} the {thing}{where}"


def _rewrite_search(found: re.Match[str]) -> str | None:
    """Return "search the kitchen for a mug" as the order to find the mug in the kitchen."""
    room = found.groupdict().get("room") or ""
    if (room and not is_room(bare(room))) or is_vague(found["thing"]):
        return None
    where = _relation_text("in", room)
    return None if where is None else f' find "{bare(found["thing"])}{where}"'


def _rewrite_check(found: re.Match[str]) -> str | None:
    """Return "see if the mug is on the desk" as `go to "check mug on the desk"`."""
    slots = found.groupdict()
    thing = bare(found["thing"])
    if is_vague(thing) or thing in ("it", "them"):
        return None
    if not slots.get("relation") and found[0].rstrip().endswith(found["thing"]):
        known = is_marked(thing) or nouns.unknown_in(thing.split()) is None
        # An unknown thing needs an article other than "any" and "some".
        named = known or re.match(r"(?!any|some)\w+ ", found["thing"][: -len(thing)])
        nowhere = thing.startswith("rooms ") or thing.split()[-1] in NOWHERE
        if is_room(thing) or nowhere or not named:
            return None  # "check the kitchen" is no check of a thing, nor "check for any messages"
    if slots.get("into") and not is_room(bare(slots["into"])):
        return None
    if slots.get("room") or slots.get("into"):
        where = _relation_text("in", slots.get("room") or slots["into"])
    else:
        where = _relation_text(slots.get("relation"), slots.get("anchor"))
    if slots.get("within"):
        if where is None or not is_room(bare(slots["within"])):
            return None
        where += _relation_text("in", slots["within"]) or ""
    if re.match(r" (?!and |then |but |when |while |in order )\w", found.string[found.end() :]):
        return None  # "check if the heater is on"
    return None if where is None else _go_to(f"{CHECK} {thing}{where}", found)


def _relation_text(
    relation: str | None, anchor: str | None, other: str | None = None
) -> str | None:
    """Return " next to the desk"; "" without a relation, None if the anchor is no object."""
    if not relation or not anchor:
        return ""
    name = bare(anchor)
    words = name.split()
    phrase = f"{relation} {anchor}".lower().split()
    # A phrase of the lexicon that is longer than the relation, such as "at some point".
    idiom = any(
        tuple(phrase[:n]) in TABLE for n in range(len(relation.split()) + 1, len(phrase) + 1)
    )
    verb = name == anchor.lower() and TABLE.get((words[0],)) == "verb" and len(words) > 1
    bare_by = relation == "by" and name == anchor.lower() and not is_marked(name)  # "by bus"
    if idiom or verb or bare_by or is_vague(anchor) or words[-1] in NOWHERE:
        return None  # "at some point", "by passing the desk"
    if names.number(words) is not None:
        return None  # "between the two"
    relation = _RELATIONS.get(relation.lower(), relation.lower())
    the = "" if re.search(r" (?:\d+\w?|[a-z])$", name) else "the "
    more = f" and the {bare(other)}" if other else ""
    return f" {relation} {the}{name}{more}"


def _rewrite_exploration(found: re.Match[str]) -> str | None:
    """Return "explore the kitchen and the hall" as orders to go to `explored …`."""
    slots = found.groupdict()
    time = _for_duration(slots.get("span"))
    # Rooms, and the words between them; "" stands for the whole site.
    joints = re.findall(_JOINT, slots.get("stops") or "")
    rooms = [bare(stop) for stop in re.split(_JOINT, slots.get("stops") or slots.get("room") or "")]
    rooms = ["" if re.fullmatch(r"(?:every|each|all) rooms?", room) else room for room in rooms]
    if not all(is_room(room) for room in rooms if room) or (time and len(rooms) > 1):
        return None
    if vague := [room for room in rooms if room and is_vague(room)]:
        raise UnclearError(f"instruction: {vague[0]!r}: unclear which room; name it", vague[0])
    orders = [_go_to(f"{EXPLORED}{f' {room}' * bool(room)}{time}") for room in rooms]
    return orders[0] + "".join(
        j.rstrip() + order for j, order in zip(joints, orders[1:], strict=True)
    )


def _rewrite_exploration_here(found: re.Match[str]) -> str | None:
    """Return the order to explore the whole site, or the room that the text before goes to."""
    room, before = "", found.string[: found.start()]
    if before:
        last = re.search(rf"(?:to|in|into) (?P<name>{NAME}),?$", before, re.I)
        if last is None or not is_room(bare(last["name"])):
            raise UnclearError(f"instruction: {found[0].strip()!r}: unclear where; name the room")
        room = f" {bare(last['name'])}"
    return _go_to(f"{EXPLORED}{room}{_for_duration(found['span'])}", found)


def _for_duration(span: str | None) -> str:
    return f" for {_duration_text(seconds_of(span))}" if span else ""


def _duration_text(seconds: float) -> str:
    """Return a length of time [s] in the format of propositions: `90 s`, `10 min`."""
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min" if minutes and not rest else f"{seconds:.0f} s"


def _rewrite_patrol(found: re.Match[str]) -> str | None:
    """Return a patrol as the stops of all its rounds, or as one round with "repeat …".

    Return None if it is no patrol.
    """
    slots = found.groupdict()
    stops = [bare(stop) for stop in re.split(STOP, found["stops"])]
    if re.search(r"\bor\b", found["stops"]) or any(is_vague(stop) for stop in stops):
        return None
    if len(stops) < 2:
        return None
    often = (slots.get("count") or slots.get("often") or "").lower()
    rounds = number_of(often) if often else None
    if often and rounds is None:
        return None
    if rounds is not None and 1 <= rounds <= MAX_ROUNDS:
        return _go_to_each(stops * rounds)
    if found.start() or found.string[found.end() :].strip(" .!?"):
        order = "send what comes before it first" if found.start() else "send the rest afterwards"
        raise UnclearError(
            "instruction: a patrol for some time, or with more than "
            f"{MAX_ROUNDS} rounds, must be the whole instruction; {order}"
        )
    end = f"{rounds} times" if rounds is not None else "until told"
    end = f"for {_duration_text(seconds_of(slots['span']))}" if slots.get("span") else end
    return f"{_go_to_each(stops)}; repeat {end}"


def _rewrite_errand_and_back(found: re.Match[str]) -> str | None:
    """Return "go to the door and back, three times" as a sequence of stops."""
    slots = found.groupdict()
    times = number_of((slots.get("count") or slots.get("often") or "").lower())
    if times is None or not 1 <= times <= MAX_ROUNDS:
        return None
    return _go_to_each([bare(found["thing"]), f'"{HERE}"'] * times)


def _quote_related(found: re.Match[str]) -> str | None:
    """Quote a thing with its relation: the mug on the desk becomes "mug on the desk"."""
    slots = found.groupdict()
    thing = found["thing"]
    words = thing.split()
    # "find mug on the desk": the name begins after the verb.
    while words and TABLE.get((words[0].lower(),)) in ("verb", "avoid") and len(words) > 1:
        words = words[1:]
    before = thing[: len(thing) - len(" ".join(words))]
    relation = (slots.get("relation") or "with").lower()
    articled = bare(thing) != thing.lower()
    led = before or _LEADS_TO_NAME.search(found.string[: found.start()])
    if not articled and (nouns.unknown_in(words) is not None or not led):
        return None  # "park at the dock": a verb, no thing
    if (
        words[-1] in NOWHERE
        or (is_vague(" ".join(words)) and relation != "with")
        or (is_room(bare(thing)) and relation in ("by", "near", "at"))
    ):
        return None
    if slots.get("relation") and TABLE.get((words[-1].lower(),)) in ("verb", "do"):
        return None
    other = slots.get("other") if relation == "between" else None
    where = _relation_text(relation, found["anchor"], other)
    within = slots.get("within")  # " in the kitchen": the name begins at the third part
    if where is None or (within and not is_room(bare(within.split(" ", 2)[2]))):
        return None
    where += _relation_text("in", within.split(" ", 2)[2]) or "" if within else ""
    rest = f" and {slots['other']}" if slots.get("other") and not other else ""
    name = bare(" ".join(words))
    if slots.get("else"):
        rest = f" or {slots['else']}"
        if slots["again"] or (is_room(bare(slots["else"])) and is_room(bare(found["anchor"]))):
            rest = f' or "{name}{_relation_text(slots["again"] or relation, slots["else"])}"'
    return f' {before}"{name}{where}"{rest}'


def _quote_which_room(found: re.Match[str]) -> str:
    which = {"biggest": "largest"}.get(found["which"].lower(), found["which"].lower())
    return f' "{which} room"'


def _insert_then(found: re.Match[str]) -> str | None:
    """Insert "then" between "go to the kitchen" or "find the mug" and the work there."""
    in_order = is_room(bare(found["room"])) if found["room"] else not found["finds"]
    return f"{found['go']}, then" if in_order else None


def _insert_to(found: re.Match[str]) -> str | None:
    """Insert the "to" that children and learners of English leave out: "go kitchen"."""
    name = bare(found["name"])
    first = name.split()[:-1]
    known = is_marked(name) or (is_room(name) and all(map(_modifies, first)))
    return f"{found['lead']}go to {found['name']}" if known else None


def _rewrite_list_in_turn(found: re.Match[str]) -> str | None:
    """Return a list of stops that comes back to one as a sequence: "kitchen, hall, kitchen"."""
    stops = [bare(stop) for stop in re.split(STOP, found["stops"])]
    if len(set(stops)) == len(stops) or re.search(r"\bor\b", found["stops"]):
        return None
    return _go_to_each(stops)


def _go_to_each(stops: Sequence[str]) -> str:
    """Return the order to go to each of the stops in sequence."""
    goals = (stop if is_marked(stop) or stop[0] == '"' else f"the {stop}" for stop in stops)
    return " " + ", then ".join(f"go to {goal}" for goal in goals)


def _with_article(name: str) -> str:
    """Return the name of a room with an article, which learners leave out: "go to kitchen"."""
    articled = name.startswith('"') or bare(name) != name.lower() or is_marked(name)
    return name if articled or not is_room(name) or name[-1].isdigit() else f"the {name}"


def _quote_compound(found: re.Match[str]) -> str | None:
    """Quote a name of several words that is in no list, if no word is a typing error."""
    name = found["name"]
    words = bare(name).split()
    articled = bare(name) != name.lower()
    if len(words) < 2 or nouns.unknown_in(words) is None:
        return None
    if words[1] == "of" and articled:
        return f' "{" ".join(words)}"'
    head = nouns.is_noun(words[-1]) and not nouns.is_plural(words[-1])
    if not is_room(" ".join(words)) and not (articled and head):
        return None
    if not all(_modifies(word) for word in words[:-1]) or all(map(names.is_known, words[-2:])):
        return None
    return f' "{" ".join(words)}"'


def _modifies(word: str) -> bool:
    """Return True if a word may stand before a noun, and is no slip of a known word."""
    if re.fullmatch(phrase_of("room of"), word):
        return True
    kind = TABLE.get((word,))
    if word in BEYOND_NAMES or word in nouns.ORDINALS or word in ("whole", "entire"):
        return False
    if is_vague(word) or is_room(word) or kind not in (None, "word", "verb"):
        return False
    if kind == "verb" and not word.endswith("ing") and not nouns.is_noun(word):
        return False
    return word.strip("'").isalpha() and nouns.suggest_word(word) is None


def _rewrite_back_to(found: re.Match[str]) -> str | None:
    """Return "back to the kitchen" as an order; None if it names no room or place."""
    thing = found["thing"]
    if not (is_marked(thing) or is_room(bare(thing))):
        return None
    return f"{', then' * bool(found.start())} go to {_with_article(thing)}"


def _rewrite_back(found: re.Match[str]) -> str | None:
    """Return "come back" as the order to go where the mission began; None before a destination."""
    after = found.string[found.end() :]
    if re.match(r" ?(?:to|\"|into|and forth)", after) or re.match(
        r" +(?!then|and|when|once)\w", after
    ):
        return None
    return _go_to(HERE, found)


def _rewrite_wait(found: re.Match[str]) -> str | None:
    """Return "wait for ten minutes at the door" as orders with `wait 10 min`."""
    slots = found.groupdict()
    wait = f"{WAIT} {_duration_text(seconds_of(slots['span']))}" if slots.get("span") else WAIT
    if slots.get("thing"):
        return f'{", then" * bool(found.start())} go to {slots["thing"]}, then go to "{wait}"'
    return _go_to(wait, found) if found.start() or slots.get("span") else None
