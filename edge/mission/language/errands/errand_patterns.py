"""Patterns of the everyday errands that `errands` rewrites.

A text begins with a space while the rules rewrite it, so each word of a pattern follows a space.
The slots of a match are its named groups; see `templates`.
"""

from __future__ import annotations

import re

from edge.mission.language.errands.timed_orders import lasts_before
from edge.mission.language.words.everyday_words import (
    AFTER_A_NAME,
    ARTICLE,
    EACH_ROOM,
    MARK,
    NAME,
    PLAIN_NAME,
    phrase_of,
)
from edge.mission.language.words.places import EXPLORED, HERE, START
from edge.mission.language.words.spans import COUNT, DURATION
from edge.mission.language.words.templates import END

WAIT, CHECK = "wait", "check"
"""First words of propositions; see also `places`."""
CALLER = "caller"
"""Name of the pose of the person who gives the order."""
MAX_COUNT = 5
"""Largest number of objects of a kind that one order may ask for."""
MAX_ROUNDS = 10
"""Largest number of rounds of a patrol that becomes one sequence of stops."""

CHECKS = """
    {then} {drive} {over} (in|into|to|inside|down|along|through) <into> and [then] {check} ({if}
            there (is|are)|[if] (is|are) there) {still} <object> [there|around|here]
    {then} {drive} {over} (in|into|to|inside) <into> and [then] {check} {if} <object> (is|
            are) {still} (there|in there)
    {then} {drive} {over} (in|into|to|inside|down) <into> , [and] [then] check [on|
            for] <object> there
    {then} {goes} {check} {if} there (is|are) {still} <object> {at} [there|around|here]
    {then} {goes} {check} {if} <object> (is|are) {still} (there|here|around|in place|at home|
            present)
    {then} {goes} {check} {if} <object> (is|are) {at}
    {then} {goes} {check} {if} (i|we) [have] (left|put|forgot|forgotten|dropped) <object> {at}
    {then} {goes} {check} {if} you [can] see <object> {at} [there|around|here]
    {then} {goes} {check} [if] (is|are) [there] <object> {at} [there]
    {then} {goes} check for <object> {at}
    {then} {goes} check [on] <object> {at} [for me|for us]*
    {then} {goes} {check} <room> for <object>
    {then} {goes} {check} {if} <into> (has|have|contains|has got) {still} <object> [(in|inside) it|
            there]
"""
SEARCHES = """
    (search|scan|look|(have|take) a [good|quick|little|proper|close]* look) [around|round|in|at|
            inside|through]* <room> for <object>
    (search|look) {whole} for <object>
    {goes} (search|look|check) <relation> <anchor> for <own>
    {goes} (search|look (in|into|through)) <stops> for <object>
    (look|search) for <object> in <stops>
    [keep [on]] {goes} ((explore|exploring|searching|look|looking) [around]|{look}) [{whole}|<room>]
            until you [can|have]* (find|found|see|seen|spot|discover) <object>
    {goes} (check|(look|search) [in|into|inside|through]) <each> [and look|and search] for <object>
    (look|search) for <object> in <each>
    find <own> in <each>
    (visit|{drive} {over} (in|to|into|through)) <each> ([and] (look|looking|search|searching) for|
            to (find|(look|search) for)) <object>
"""
EVERY_ROOM = """
    {then} {goes} (visit|enter|tour|see|check [on|out|in]|{drive} {over} (in|to|into|through)|
            look (in|into|inside|at)|(have|take) a look (in|into|inside|at)|{look}) <each> [{turn}]
"""
_TOUR_WORDS = r"\b(?: (?!not|never|avoid|except)[^ .;!?]+)*?"
# "patrol the house except the bathroom", "visit all rooms, but not the kitchen"
ALL_BUT = re.compile(
    r"^(?P<lead>(?:.*(?:[.;,]| and| then))?)(?P<order> (?:(?:go|drive|visit|enter|tour|see|check|"
    rf"look|search){_TOUR_WORDS} (?:{EACH_ROOM}|everything|everywhere|all(?: the| our| my)? rooms)|"
    rf"(?:explore|patrol|guard|scan|map|survey|inspect|scout){_TOUR_WORDS} (?:{EACH_ROOM}|"
    r"everything|everywhere|(?:the|this|our|my|all)(?: whole| entire)? (?:house|home|flat|"
    r"apartment|building|floor|place|ward|warehouse|rooms)))\b"
    r"(?: (?!then\b|before\b|after)[^ .;!?,]+)*?),? "
    r"(?:(?:except|excluding|other than|apart from)(?: for)?|but(?: not)?|"
    r"without (?:going|driving|entering)(?: (?:in|into|to|inside))?)"
    rf" (?P<left_out>{NAME}(?:(?:,? (?:and|or) |, ){NAME})*)"
    r"(?=[,.;!?]|$| (?:and|then|for|until|once|twice|\w+ times)\b)",
    re.I,
)
"""An order to go everywhere but into some rooms."""
# "and wait there for 10 seconds"
IN_EACH = re.compile(
    r",?(?: and| then)+ (?:wait|stay|stop|look|check|search|find)\b[^.;!?]*"
    r" (?:there|in (?:each|it|every one|all of them))\b[^.;!?]*",
    re.I,
)
# "…, every bedroom and each bathroom"
EVERY_ROOM_TOO = re.compile(rf"(?:,? (?:and then|and|then)|,) (?P<each>{EACH_ROOM}){END}", re.I)
EXPLORES = """
    {goes} ({look}|look) {whole} [{whole}] [and|then] [map|scan|look at|explore] [everything] {time}
    {goes} {look} <stops> {time}
    spend <span> (exploring|looking around|looking round|looking about|wandering [around|
            round]) [in] [<room>|{whole}]
    {goes} (see|look|check|find out) what is (in|inside) <room>
    {goes} {look} <room> [, (only|just) (this|that) (room|one)] {time}
    give (<room>|{whole}) a [good|proper|quick|thorough|full|little|complete]* (once-over|once over|
            look|scan|sweep|look over|check|going over|look-over|inspection) {time}
    (have|take|make) a [good|proper|quick|close]* (look|scout|nose|wander) (round|around|in|at|
            inside) (<room>|{whole}) {time}
"""
EXPLORES_HERE = """
    {then} {goes} (explore|exploring|look around|look round|scan|survey|wander|wander around|
            have a look around|take a look around|roam around|drive around|go exploring|map|be [an|
            a|the] explorer|make [an] exploration) {time}
"""
PATROLS = """
    {patrol} <stops> , [for] <count> {rounds} [each|please|in total]
    {patrol} <stops> , <often>
    {patrol} <stops> , [and] [keep it up] [for|during] <span> [long]
    {patrol} <stops> , (forever|until (told|further notice)|until (i|we|you hear) ...|all (day|
            night|the time)|over and over [again]|again and again)
    ({patrol}|(go|drive) to) <stops> , [and] [just|then]* (forever [and ever]|keep (doing|
            repeating) (it|that|this) [forever|over and over|again]*)
    {patrol} <count> {rounds} (of|between|around|through|from|in|at) <stops>
    (do|make|drive|go|run|walk) <count> {rounds} [of|between|around|through|from|in] , <stops>
    {house} , [for] <count> {rounds}
    {house} , <often>
    {house} , [for|during] <span>
    {house} [, (forever|until (told|further notice)|until (i|we) ...)]
    {patrolling} <stops>
"""
ROUNDS_FIRST = (
    "<count> {rounds} [of|between|around|through|from|in|[you] make (the|a) (tour|round|loop)]* , "
    "<stops>"
)
ERRAND_AND_BACK = """
    {drive} {over} to <object> , {back} , <often>
    {drive} {over} to <object> , {back} , [for] <count> {rounds}
"""
STARTS = """
    {then} ((come|go|get|drive|head|run|return|move) [yourself] [back|home]*|back) to {home}
    {then} (come|go|get|drive|head|run|return|move) [yourself] [straight|right|back]* (home|to [the|
            your] [home] base)
    {then} (come|go|get|drive|head|run|return|move) [back|home]* to [the|your] (start|beginning|
            (start|starting) (point|place|position|pose|spot))
"""
BACK_TO = "{then} (return|[come|go|get|drive|head|run|move|be] [straight|right] back) to <object>"
CALLS = (
    "[over here [mate|robot|to me|to us] ,] (come|drive|get|move|roll) [over|right|up|here]* "
    "(here|to me|to us|to (where|wherever) (i am|we are)) "
    "[[for] (a|one) (minute|moment|second|sec|bit)]"
)
BACKS = "{then} {back}"
WAITS = """
    {then} {hold} [for] <span> {where} <object>
    {then} {hold} {there} [for] <span> [there|here]
    {then} {hold} {where} <object> [for] <span>
    {then} {hold} {where} <object> until <clock>
    {then} {hold} {there} until <clock> [{where} <object>]
    {then} {hold} (next to|by|near|at|beside|with|in front of) (it|them|him|her) until <clock>
    {then} go to <object> [and (stay|remain|wait) [there]] until <clock>
    {then} wait [for (me|us)] {where} <object>
    {then} (stay|remain) [for (me|us)] (at|by|near|next to|in front of) <object> [{until_told}]
    {then} (wait|stay|remain|stand by) [put] (there|here|in there) [for me|{until_told}]
    {then} go to <object> [and (stay|remain|wait) [there]] for <span>
    {then} {hold} (next to|by|near|at|beside|with|in front of) (it|them|him|
            her) [for] [<span>] [{until_told}]
    {then} (wait|stay|remain) {until_told}
"""
# "the mug on the desk in the kitchen" (slot `within`), "the chair between the bed and the sofa"
# (`two`, `other`), "the mug on the desk or by the bed" (`joint`, `again`, `else`), but not "the mug
# on the desk or the lamp by the bed"
_BY = phrase_of("relation")
RELATED = re.compile(
    rf" (?P<object>{NAME})(?: {phrase_of('standing')})? (?P<relation>(?P<two>between\b)|{_BY})"
    rf" (?P<anchor>{NAME})(?P<within> (?:in|inside) {NAME})?(?(two)"
    rf"(?: and (?P<other>(?:the|a) {NAME}))?|(?: (?P<joint>or|and(?= {_BY} ))"
    rf" (?:(?P<again>{_BY}) )?(?=(?P<else>{NAME}))(?P=else)(?(again)|(?! {_BY} )))?)(?=[ ,.;!?]|$)",
    re.I,
)
# "we need the mug. Please find it.", "the mug next to the sofa: go to it", "a cup or a mug: find
# either", "I lost the mug, look for it in the hall". The slot `order` has the words before the
# pronoun, `any` is "either" or the like, and `later` and `at` are the relation at the end.
INTRODUCED = re.compile(
    r"^ (?P<opening>there (?:is|are) |(?:we|i) (?:need|want|am looking for|can not find|"
    r"(?:am |are )?miss(?:ing)?|can not (?:think|remember) where (?:i|we) (?:put|left)|"
    r"(?:think (?:that )?i )?(?:seem to )?(?:have )?(?:lost|left|misplaced|forgot|forgotten)) "
    r"|either )?"
    rf"(?P<object>{NAME})(?: {phrase_of('standing')}|"
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
# A word of a ban.
BAN = re.compile(r"\b(?:not|never|avoid\w*|without|except|away|out of)\b", re.I)
GO_THERE = re.compile(r"^(?:go|drive|head|get|run|move|park)(?: yourself| over| up)?$", re.I)
_FIND = rf"(?:{phrase_of('find')}|find|get to|go to|locate)"
# "reception, but not through the hall", "room 3 first, then room 5"
ROOM_FIRST = re.compile(
    rf"^ (?P<name>{NAME})(?=(?: first)?(?:,? (?:and )?then |,? but |,? without )| first, )", re.I
)
# "find the mug, it should be on the desk"
HINTED = re.compile(
    rf"(?P<order> {_FIND}) (?P<object>{NAME})(?:[,.;]|(?= it| they)) (?:i think )?(?:(?:it|they|he|"
    rf"she) (?:is|are|(?:should|must|will) be)|i (?:have )?(?:left|put) (?:it|them))"
    rf"(?: {phrase_of('standing')})? (?P<relation>"
    rf"{phrase_of('relation')}) (?P<anchor>{NAME})(?: i think)?{END}",
    re.I,
)
# "find my mug, it is a white one"
COLOURED = re.compile(
    rf"(?P<order> {_FIND}) (?P<object>{NAME})(?:[,.;]|(?= it| they)) (?:(?:it|they|he|she)"
    r" (?:is|are) )(?:the |an? )?(?P<colour>\w+)(?: ones?)?(?=[.!]*$)",
    re.I,
)
# "I need the mug to be found"
WANTED_FOUND = re.compile(
    rf"^ (?:i|we) (?:need|want|would like) (?P<object>{NAME}(?: {phrase_of('relation')} {NAME})?)"
    r" (?:to be )?found(?=[.!]*$)",
    re.I,
)
# "the nearest chair to the desk"
NEAREST = re.compile(
    rf" (?:the )?(?:nearest|closest) (?P<object>{PLAIN_NAME})"
    rf" (?:to|from|of) (?P<anchor>{NAME}){END}",
    re.I,
)
# "the nearest chair": to the robot
NEAREST_TO_ROBOT = re.compile(
    rf" (?:the )?(?:nearest|closest) (?=(?P<object>{PLAIN_NAME}))(?P=object){END}"
    r"(?! (?:to|from|of)\b)",
    re.I,
)
# "the room with a piano"
ROOM_WITH = re.compile(
    rf" (?P<object>(?:the )?room) (?:with|that has) (?P<anchor>{NAME}){END}", re.I
)
# "so you can go into the kitchen again"
PERMITS = re.compile(
    r"(?:so |and )?(?:you|the robot) (?:now )?(?:can|may|are (?:allowed|free|welcome) to) (?:now )?"
    rf"(?:go|come|drive|enter|move|get)(?: (?:back|in|into|to|inside))* {NAME}(?: again)?[.!?]*$",
    re.I,
)
# Other spelling of a relation → the relation.
RELATIONS = {
    "near of": "near", "near to": "near", "nearby": "near", "next of": "next to",
    "beside of": "beside", "behind of": "behind",
}  # fmt: skip
# Before a name: any of several places will do for "look for a mug on the desk and on the table".
LOOKS_FOR = re.compile(r"\b(?:look|search|hunt)(?:ing)?(?: \w+)? for$", re.I)
# A word after which a name without an article may come.
LEADS_TO_NAME = re.compile(
    r"\b(?:find|to|for|me|us|or|avoid|near|reach|visit|locate|spot|see|seek|get)$", re.I
)
WHICH_ROOM = re.compile(r" (?:the )?(?P<which>next|largest|biggest|smallest) room(?! \d)\b", re.I)
# `"wait 30 s" and go on`
AFTER_WAIT = re.compile(r'(?P<wait>"wait[^"]*")(?:,? and(?: then)?|,)(?= (?!then)\w)')
EXPLORED_TWICE = re.compile(r'( go to "explored")(?:,? and(?: then)? go to "explored")+')
# "rooms 3, 4 and 5", and not "bays 2 and 3 times"
_NUMBERED = re.compile(
    r"\b(?P<kind>room|aisle|bay|ward|unit)s (?P<numbers>\d+\w?(?:(?:,? (?:and|or|then) |, )"
    r"\d+\w?)+)\b(?! (?:times|rounds|min|sec|hour))",
    re.I,
)
# "visit rooms 1 to 5", and not "search rooms 1 to 5 for a mug"
_RANGE = re.compile(
    r"(?P<lead>^ [^.;!?]*)\b(?P<kind>room|aisle|bay|ward|unit)s (?P<first>\d{1,4})"
    r"(?: ?- ?| to | through )(?P<last>\d{1,4})\b",
    re.I,
)
_MOST_MEMBERS = 12


def _name_range(found: re.Match[str]) -> str:
    """Return "visit room 1, room 2 and room 3"; a search, exceptions and a long range stay."""
    first, last = int(found["first"]), int(found["last"])
    has_exception = re.search(r"\b(?:not|except\w*|without|avoid)\b", found.string[found.end() :])
    if has_exception or re.search(r"\b(?:search|look|find)\b", found["lead"], re.I):
        return found[0]
    if not first < last < first + _MOST_MEMBERS:
        return found[0]
    members = [f"{found['kind']} {number}" for number in range(first, last + 1)]
    return f"{found['lead']}{', '.join(members[:-1])} and {members[-1]}"


def _wait_first(found: re.Match[str]) -> str:
    """Return "…, then wait a minute, then" for "…, and after a minute".

    After an order that lasts, the time may be its limit, so nothing is changed.
    """
    if not found["joint"]:
        return f" wait {found['span']}, then"
    return found[0] if lasts_before(found) else f", then wait {found['span']}, then"


def _rounds(count: str | None) -> str:
    return f", {count} rounds" if count and count != "a" else ""


FIRST_REWRITES = (
    # "in ten minutes, go to the hall, and after one minute come back"
    (re.compile(rf"(?P<joint>^|,? and(?: then)?|,? then|[,;.])(?P<when> after|(?<=^) in)"
                rf" (?P<span>{DURATION}),?(?= (?:go|come|drive|head|return|find|look|visit|check|"
                r"explore|patrol|search)\b)", re.I),
     _wait_first),
    # "the room where the tv is"
    (re.compile(rf"\bthe room (?:where|in which) (?P<anchor>(?:the|my|our) {PLAIN_NAME}) "
                r"(?:is|are|stands)(?=[,.;!?]|$)", re.I), r"the room with \g<anchor>"),
    # "do your rounds", "make two rounds"
    (re.compile(r"^ (?:go and )?(?:do|make|start|begin|go on)(?: (?:your|the|some|a|"
                rf"(?P<count>{COUNT})))?(?: usual| daily)* (?:rounds?|patrol)"
                r"(?=[.!]*$| (?:for|twice|until|\d+ times)\b)", re.I),
     lambda found: f" patrol the house{_rounds(found['count'])}"),
    # "go to where the tv is"
    (re.compile(r" (?P<go>go|drive|come|move|head|run|get)(?: over)?(?: to)? where (?P<anchor>"
                rf"(?:the|my|our) {PLAIN_NAME}) (?:is|are)(?=[,.;!?]|$| (?:and|then)\b)", re.I),
     r" \g<go> to \g<anchor>"),
    # "I lost my keys"
    (re.compile(r"^ (?:i|we)(?: have)?(?: just)? (?:lost|mislaid|misplaced)"
                r"(?= (?:my|our|the) [^,.;!?]*[.!?]*$)", re.I), " find"),
    # "look around the house, every room"
    (re.compile(r"\b(house|home|flat|apartment|building|place), (?:every|each) (?:single )?room\b",
                re.I), r"\1"),
    # "afterwards to the hall", "and then into the hall"
    (re.compile(r",? after(?:wards)? to\b(?! the (?:right|left))", re.I), ", then to"),
    (re.compile(r",? (?:and )?(?:(?:after|afterwards|then)(?: out| over| on| back)? (?:in|into)|"
                r"then out to|at the end (?:in|into|to))"
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
    # "first the hall, then the bed, in that order", "on this floor"
    (re.compile(r"(?<= then )([^.;!?]*?),? in (?:that|this) order(?=[.!]*$)", re.I), r"\1"),
    (re.compile(r"(?<!stay)(?<!remain)(?<!keep)(?<!drive)(?<!go)(?<!move)(?<!wait)(?<!only)(?<!be)"
                r" (?:on this floor|in this (?:building|house|flat|apartment))(?=[,.;!?]|$)", re.I),
     ""),
    # "start at the hall, then …"
    (re.compile(rf"^ (?:start|begin)(?: off)? (?:at|in|by|with|from) (?={NAME}(?:,| and| then))",
                re.I), " first go to "),
    # "a cup or a mug, I do not care which"
    (re.compile(r"(?<= or )([^,.;!?]+), (?:i|we) do not (?:care|mind) which(?: one)?\b", re.I),
     r"\1"),
    # "whichever is closer, the sofa or the bed"
    (re.compile(r"\b(?:whichever|whatever)(?: one)? is (?:closer|closest|nearer|nearest|quicker)"
                r"[,:]? (?=\S.* or )", re.I), ""),
    # "…, and tell me when you are there": the answer says it
    (re.compile(r"(?:,|,? and| then)+ (?:let (?:me|us) know|tell (?:me|us)|"
                r"report(?: back)?(?: to me)?|"
                r"(?:send|give|drop) (?:me|us) a (?:message|note|text)|message (?:me|us))"
                r"(?: (?:when|once|as soon as) (?:you (?:are (?:there|done|finished)|arrive|"
                r"get there|(?:have )?f(?:ind|ound) (?:it|them|one))|it is done)|"
                r" (?:where|(?:in )?(?:which|what) room) (?:it|they) (?:is|are|was|were)(?: in)?)?"
                r"(?=[.!]*$)", re.I), ""),
    # "count the chairs", "go and see how many chairs there are in the hall"
    (re.compile(r"\bcount(?: up)?(?: all)?(?: of)? (?=(?:the|our|my|these|those) |\w+s\b)", re.I),
     "find all "),
    (re.compile(r"(?<= )(?:count|(?:go (?:and )?)?(?:find out|see|check|work out|determine|count)) "
                rf"how many (?P<object>{PLAIN_NAME})(?: (?:there are|are there|you (?:can )?(?:see|"
                r"find))| are(?= (?:in|on|at|under|next|near)))", re.I), r"find all \g<object>"),
    # "a cup or one mug", "find me one mug"
    (re.compile(r"\bor one (?=\w)(?!of\b|more\b)", re.I), "or a "),
    (re.compile(r"\bfind(?: for)?(?: me| us)? one (?!of\b|or\b|more\b)", re.I), "find a "),
    (_RANGE, _name_range),
    (_NUMBERED, lambda found: re.sub(r"(?=\b\d)", f"{found['kind']} ", found["numbers"])),
    # "before you have been to the hall", "passing close to it", "and stop right there."
    (re.compile(r"\b(before|until|unless) you have been (?:past|to|by|through|at|in)\b", re.I),
     r"\1 you have visited"),
    (re.compile(r"\bpass(ing)? (?:near|close)(?: to| by)?\b", re.I), r"pass\1 by"),
    (re.compile(r",? (?:and|then|and then) stop (?:right )?there(?=[.!]*$)", re.I), ""),
)  # fmt: skip
"""Replacements before all others: lists of numbered rooms, and other words for known ones."""
THERE_AND = re.compile(
    rf"(?P<go>(?:go|drive) to (?P<room>(?:the )?{NAME})|find {NAME}),? and"
    rf"(?= (?:(?P<finds>find|look for)|look at|inspect|examine|{phrase_of('work')}) )",
    re.I,
)
UNCLEAR = (
    (  # `"explored hall", then the bed`, `"red mug" or under the …`, `"mug on the desk" and the …`
        re.compile(
            rf'"(?:{EXPLORED}|{CHECK}|{WAIT})\b[^"]*"(?:,| and then| and| or| then)+ '
            rf'(?:{ARTICLE} |")'
            rf'|"[^"]* [^"]*" (?:and|or) {phrase_of("relation")} '
            rf'|"[^"]* {phrase_of("relation")} [^"]*" (?:and|or) '
            rf"(?:{ARTICLE}|{phrase_of('room')}) ",
            re.I,
        ),
        "unclear what to do with the second object; name it in a sentence of its own",
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
            r"(?=[.,;!?]|$| (?:and|then|but|or|again|for|once|twice|in turn|one by one|one after)"
            r"\b)",
            re.I,
        ),
        "unclear which room; name it",
    ),
    (
        re.compile(
            r"\b(?:check|see|look|find out|verify) (?:if|whether)\b|"
            r"\b(?:check|verify|confirm) that (?:(?:the|all|every|no|there)\b|\")",
            re.I,
        ),
        "the robot can only check whether an object is there; say for example 'check whether the "
        "stove is in the kitchen'",
    ),
)
"""Pattern of a text that is still unclear after all rules, and the hint of its refusal."""
NO_OBJECT = re.compile(rf"(?:{EXPLORED}|{WAIT})\b|(?:{HERE}|{START}|{CALLER})$")
# Between the names of "mug on the desk", "room with a piano".
BETWEEN_NAMES = re.compile(rf" (?:{phrase_of('relation')}|with|and)(?: the)? ")
# The mark or word before a clause.
_CLAUSE_START = r"(?P<lead>(?:^|[.;,!?]|\b(?:and|then|or)) )"
EVERYTHING = phrase_of("everything")
# "go to the kitchen, and then …"
GONE_TO = re.compile(
    rf"{_CLAUSE_START}(?:{phrase_of('go to')}|(?:go|drive|move|head) (?:to|into)) (?:the )?"
    rf"(?P<name>{PLAIN_NAME}),?(?: and)? ?$",
    re.I,
)
# "find two chairs in the kitchen", "find all chairs"
COUNTED = re.compile(
    r"(?P<lead>(?:^|[.;,!?]|\b(?:and|then)) )(?:(?:go|drive|head|move|run|roll)(?: over)? to|"
    rf"{phrase_of('find')}|find|go find|visit|reach|see|go and see)"
    r"(?: all)?(?: the| my| our)?(?: any| at least)? "
    rf"(?P<count>{COUNT}|both|all|each|every(?: single)?)(?: of)?(?: the| my| these| those| our)?"
    rf"(?: (?:different|separate|distinct))? (?P<object>{PLAIN_NAME})"
    rf"(?: (?P<relation>{phrase_of('relation')}) (?P<anchor>{NAME}))?"
    r"(?=[.;!?]|$|,(?! (?:and |or )?(?:the|an?|my|our|both|but not|not|\d|"
    r"two|three|four|five)\b)| (?:and|then)\b(?! (?:the|an?|my|our|both|two|three|four|five)\b))",
    re.I,
)
# "… and every chair"
EACH_OBJECT = re.compile(
    r"(?:,|\b(?:and|or|then|to|visit|find|reach|pass)) (?:every|each)(?: single)? "
    rf"(?P<object>{PLAIN_NAME})",
    re.I,
)
_ANOTHER = r"(?:another|an other|(?:a|one) (?:different|second|further|new)|one more)"
_WHERE = rf"(?: (?P<%s>{phrase_of('relation')}) (?P<%s>{NAME}))?"
# "find a chair in the hall, then wait and find another one", also "…, then another"
ANOTHER = re.compile(
    rf"{_CLAUSE_START}(?P<first>{phrase_of('go to')}|go to|{phrase_of('find')}|find|visit) "
    rf"(?:an?|the|any|some) (?P<object>{PLAIN_NAME}){_WHERE % ('relation', 'anchor')}"
    rf"(?P<between>[^;!?]*?)(?P<joint>,| and| then|[.])+ "
    rf"(?P<order>(?:(?:{phrase_of('go to')}|go to|to|{phrase_of('find')}|find|visit) )?){_ANOTHER}"
    rf"(?: (?P<same>one|(?P=object)))?{_WHERE % ('later', 'at')}(?=[.,;!?]|$| (?:and|then)\b)",
    re.I,
)
GOES_TO = re.compile(rf"{_CLAUSE_START}{phrase_of('go to')} (?P<name>\"[^\"]*\"|{NAME})", re.I)
SEARCHED_ROOM = re.compile(rf"^ search (?P<room>{NAME})(?=[.!]*$)", re.I)
GOES_ROOM = re.compile(rf"{_CLAUSE_START}(?:go|drive|come) (?P<name>{NAME})", re.I)
IN_TURN = "go to <stops>"
FINDS = re.compile(rf"{_CLAUSE_START}{phrase_of('find')} (?P<name>\"[^\"]*\"|{NAME})", re.I)
COMPOUND = re.compile(rf" (?P<name>{NAME})(?= {AFTER_A_NAME}\b|[,.;!?]|$)", re.I)
