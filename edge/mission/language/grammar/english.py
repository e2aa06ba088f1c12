"""Description of a formula in plain English, to show what was understood.

Sequences, sets, choices, counts, bans and untils become sentences that `instruction` reads back as
the same language. Any other formula is read out operator by operator, in brackets.

>>> from edge.mission.logic.ltl import parse
>>> describe(parse("F((chair | sofa) & F television) & (!bed W television)"))
'Reach either the chair or the sofa, then the television. Do not reach the bed until the \
television is reached.'
"""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import pairwise, product

from edge import number_words
from edge.mission.language.grammar.goal_tree import Visit
from edge.mission.language.words.noun_phrases import Antecedents, NounPhrase, take_noun_phrase
from edge.mission.language.words.tokens import TokenReader, TranslationError
from edge.mission.logic.ltl import Formula, conj, postorder, propositions, to_text

MAX_ALTERNATIVES = 32
"""Largest number of alternatives of a formula; one with more is read out literally."""


# A chain is a sequence of visits. A formula becomes alternatives of sets of chains:
# F(a & (F b | F c) & F d) asks for "a, then d", and for "a, then b" or "a, then c". Sequences
# distribute over & and |, because a chain that asks for something later also asks for its earlier
# part.
Chain = tuple[Visit, ...]
Alternatives = list[tuple[Chain, ...]]


def options_of(f: Formula) -> tuple[str, ...] | None:
    """Return the names of a proposition or of a disjunction of propositions; None for others."""
    parts = f.args if f.op == "|" else (f,)
    return tuple(part.name for part in parts) if all(p.op == "ap" for p in parts) else None


def alternatives_of(f: Formula) -> Alternatives | None:
    """Return sets of chains, of which any one set fulfils the formula; None for other formulas."""
    if f.op == "|":
        each = [alternatives_of(part) for part in f.args]
        if any(a is None for a in each):
            return None
        found = [chains for a in each if a is not None for chains in a]
        return found if len(found) <= MAX_ALTERNATIVES else None
    if f.op == "&":
        return _alternatives_of_all(f.args)
    return _alternatives_of_sequence(f) if f.op == "F" else None


def _alternatives_of_all(parts: tuple[Formula, ...]) -> Alternatives | None:
    """Return the alternatives of a conjunction; None if a part has none, or if too many."""
    found: Alternatives = [()]
    for part in parts:
        more = alternatives_of(part)
        if more is None or len(found) * len(more) > MAX_ALTERNATIVES:
            return None
        found = [(*a, *b) for a, b in product(found, more)]
    return found


def _alternatives_of_sequence(f: Formula) -> Alternatives | None:
    """Return the alternatives of F(p & …), of F((p | q) & …), and of several visits to p."""
    body = f.args[0]
    options = options_of(body)
    if options is not None:
        return [((Visit(options),),)]
    if body.op != "&":
        return None
    first, *rest = body.args
    options = options_of(first)
    if options is None:
        return None
    again = _once_more(first, rest)
    if again is not None:
        later = _alternatives_of_sequence(again)
        # Each chain of the rest begins with visits to p: count one more.
        return later and [
            tuple((Visit(s.options, s.times + 1), *more) for s, *more in chains) for chains in later
        ]
    found = _alternatives_of_all(tuple(part.args[0] if part.op == "X" else part for part in rest))
    # Without X, one visit could fulfil both p and a later part that also begins with p.
    strict = all(part.op == "X" for part in rest)
    if found is None or not all(
        strict or not set(chain[0].options) & set(options) for chains in found for chain in chains
    ):
        return None
    return [tuple((Visit(options), *chain) for chain in chains) for chains in found]


def _once_more(first: Formula, rest: list[Formula]) -> Formula | None:
    """Return g of F(p & F(!p & g)), g of the form F(p …); None for other forms."""
    if len(rest) != 1 or rest[0].op != "F" or rest[0].args[0].op != "&":
        return None
    gap, *more = rest[0].args[0].args
    # `gap` is !p, `more` is F(p …), of which `starts` is p.
    if gap != Formula("!", (first,)) or len(more) != 1 or more[0].op != "F":
        return None
    body = more[0].args[0]
    starts = body.args[0] if body.op == "&" else body
    return more[0] if starts == first else None


MAX_NODES = 600
"""Largest number of nodes of a formula that is put into words; longer sentences do not help."""

_NUMBERED = re.compile(rf".* (?:\w?\d+\w?|\w|{'|'.join(number_words.SMALL_NUMBERS)})")
_MAX_DEPTH = 60  # levels of operators in a formula that is put into words
_SHOWN = 2000  # characters of a formula that is too long for words
_TIMES = {1: "once", 2: "twice"}
_NUMBERS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]


def describe(formula: Formula) -> str:
    """Return one or more English sentences that say what a formula asks for."""
    if is_too_long(formula):
        text = to_text(formula)
        cut = text if len(text) <= _SHOWN else text[:_SHOWN] + " …"
        return f"Fulfil this formula, which is too long to put into words: {cut}"
    if formula.op == "true":
        return "Nothing needs to be done."
    if formula.op == "false":
        return "This cannot be done."
    parts = tuple(dict.fromkeys(formula.args)) if formula.op == "&" else (formula,)
    sentences = [*_goal_sentences(parts), *_rule_sentences(parts)]
    return " ".join(f"{sentence[0].upper()}{sentence[1:]}." for sentence in sentences)


def is_plain(formula: Formula) -> bool:
    """Return True if a formula has plain sentences, without operators that are read out."""
    return _READ_OUT_START not in describe(formula).lower()


def is_too_long(formula: Formula) -> bool:
    """Return True if a formula has more than `MAX_NODES` nodes, or is too deep for words."""
    depth: dict[int, int] = {}
    for count, f in enumerate(postorder(formula)):
        depth[id(f)] = 1 + max((depth[id(arg)] for arg in f.args), default=0)
        if count >= MAX_NODES or depth[id(f)] > _MAX_DEPTH:
            return True
    return False


def _goal_sentences(parts: tuple[Formula, ...]) -> list[str]:
    """Return sentences for the parts that ask for something, single visits first."""
    singles = [part for part in parts if part.op == "F" and options_of(part.args[0])]
    exact = [part for part in parts if _is_exact_count(part, parts)]
    sentences = [f"reach {_stop_text(*_count_of(part), word='exactly')}" for part in exact]
    singles = [part for part in singles if part not in exact]
    if singles:
        stops = [Visit(options_of(part.args[0]) or ()) for part in singles]
        sentences.append(f"reach {_any_order_text(stops)}")
    for part in parts:
        if part in singles or part in exact:
            continue
        found = alternatives_of(part)
        if found is None and part.op == "|":
            sentences += [_alternatives_text(part)]
        elif found is not None and len(found) == 1:
            sentences += [f"reach {_chain_text(chain)}" for chain in _merge_chains(found[0])]
        elif found is not None:
            sentences.append(_alternatives_text(part))
    return sentences


def _rule_sentences(parts: tuple[Formula, ...]) -> list[str]:
    counted = {_count_of(part) for part in parts if _is_exact_count(part, parts)}
    return [
        _rule_text(part) or _read_out(part)
        for part in parts
        if alternatives_of(part) is None
        and part.op != "|"
        and not (_limit_of(part) and _limit_of(part) in counted)
    ]


def _alternatives_text(f: Formula) -> str:
    """Return `reach …; or reach …`, each with its own rules.

    If an alternative has no such sentence, the formula is read out literally.
    """
    phrases: list[str] = []
    for option in f.args if f.op == "|" else (f,):
        parts = option.args if option.op == "&" else (option,)
        asked = tuple(part for part in parts if alternatives_of(part) is not None)
        rules = [_rule_text(part) for part in parts if part not in asked]
        found = alternatives_of(conj(*asked)) if asked else None
        if found is None or None in rules or any(_needs_a_sentence(r, asked) for r in parts):
            return _read_out(f)
        for chains in found:
            merged = _merge_chains(chains)
            if len(merged) != 1:
                return _read_out(f)
            phrases.append(", but ".join([f"reach {_chain_text(merged[0])}", *map(str, rules)]))
    return "; or ".join(phrases)


def _needs_a_sentence(f: Formula, asked: tuple[Formula, ...]) -> bool:
    """Return True if a rule could be misread in one sentence with the goals of its alternative."""
    if f in asked:
        return False
    names = {name for part in asked for name in propositions(part)}
    return f.op == "U" or (f.op in ("G", "!") and bool(names & set(propositions(f))))


_Merged = tuple[Chain, tuple[Visit, ...]]


def _merge_chains(chains: tuple[Chain, ...]) -> list[_Merged]:
    """Merge chains that differ only in their last stop; return pairs (common part, last stops)."""
    groups: dict[Chain, list[Visit]] = {}
    for chain in dict.fromkeys(chains):
        groups.setdefault(chain[:-1], []).append(chain[-1])
    merged: list[_Merged] = []
    for shared, last in groups.items():
        if len({stop.times for stop in last}) == 1 and last[0].times == 1:
            merged.append((shared, tuple(last)))
        else:
            merged += [(shared, (stop,)) for stop in last]
    return merged


def _chain_text(merged: _Merged) -> str:
    """Return `the bed, then the sofa` for a chain with its last stops."""
    shared, last = merged
    stops = [*(_stop_text(s.options, s.times) for s in shared), _any_order_text(list(last))]
    each = [*(s.options for s in shared), last[0].options if len(last) == 1 else ()]
    for i, (before, after) in enumerate(pairwise(each), 1):
        stops[i] += " again" if before == after else ""
    return ", then ".join(stops)


def _any_order_text(stops: list[Visit]) -> str:
    """Return `the bed and the sofa in any order`."""
    if len(stops) == 1:
        return _stop_text(stops[0].options, stops[0].times)
    *most, last = (_choice_text(stop.options) for stop in stops)
    return f"{', '.join(most)} and {last} in any order"


def _stop_text(options: tuple[str, ...], times: int = 1, word: str = "at least") -> str:
    """Return `the bed`, or `the bed at least twice`."""
    if times == 1 and word == "at least":
        return _choice_text(options)
    return f"{_choice_text(options)} {word} {_often_text(times)}"


def _often_text(n: int) -> str:
    return _TIMES.get(n) or f"{_NUMBERS[n] if n < len(_NUMBERS) else n} times"


def _choice_text(options: tuple[str, ...], joint: str = "or") -> str:
    """Return `either the bed or the sofa`; without "either" if `joint` is "nor"."""
    *most, last = map(_name_text, options)
    if not most:
        return last
    either = "either " if joint == "or" else ""
    return f"{either}{', '.join(most)} or {last}"


def is_numbered(name: str) -> bool:
    """Return True for a name that ends in a number or a letter, as "room 12" does."""
    return _NUMBERED.fullmatch(name) is not None


@lru_cache(maxsize=4096)
def _name_text(name: str) -> str:
    """Return `the bed`, `a` (a letter), or the name in quotes if it could be misread."""
    spoken = name if len(name) == 1 or is_numbered(name) else f"the {name}"
    try:
        reader = TokenReader(spoken)
        if take_noun_phrase(reader, Antecedents()) == NounPhrase(((name,),)) and reader.is_at(
            "end"
        ):
            return spoken
    except TranslationError:
        pass
    return f'"{name}"'


def _rule_text(f: Formula) -> str | None:
    """Return a ban, an until, a limit or a reaction in words; None for other formulas."""
    if f.op == "G":
        return _always_text(f.args[0])
    if (
        f.op in ("W", "U")
        and (banned := _banned_names(f.args[0]))
        and (until := options_of(f.args[1]))
    ):
        if set(banned) & set(until):
            return None
        end = _choice_text(until)
        phrase = f"do not reach {_choice_text(banned, 'nor')} until {end} is reached"
        return phrase if f.op == "W" else f"{phrase}, and {end} must be reached"
    if limit := _limit_of(f):
        options, n = limit
        return (
            f"never reach {_choice_text(options, 'nor')}"
            if n == 0
            else (f"reach {_stop_text(options, n, word='at most')}")
        )
    return _limit_until_text(f)


def _banned_names(f: Formula) -> tuple[str, ...] | None:
    """Return x and y of !x, of !(x | y) and of !x & !y; None for other formulas."""
    if f.op == "&":
        each = [_banned_names(part) for part in f.args]
        return None if None in each else tuple(name for names in each for name in names or ())
    return options_of(f.args[0]) if f.op == "!" else None


def _always_text(f: Formula) -> str | None:
    """Return words for G f: a ban, or a reaction to something reached; None for other formulas."""
    if banned := _banned_names(f):
        return f"never reach {_choice_text(banned, 'nor')}"
    if f.op != "->" or (when := options_of(f.args[0])) is None:
        return None
    then = f.args[1]
    names = set(when)
    if then.op == "F" and (asked := options_of(then.args[0])) and not names & set(asked):
        return (
            f"whenever {_choice_text(when)} is reached, {_choice_text(asked)} must be reached later"
        )
    if then.op == "X" and (asked := options_of(then.args[0])):
        must = f"{_choice_text(asked)} must be reached at the next step"
        return f"whenever {_choice_text(when)} is reached, {must}"
    weak = then.op == "WX"
    ban = then.args[0] if weak else then
    if (
        ban.op == "G"
        and (banned := _banned_names(ban.args[0]))
        and weak == bool(names & set(banned))
    ):
        return f"once {_choice_text(when)} is reached, never reach {_choice_text(banned, 'nor')}"
    return None


def _count_of(f: Formula) -> tuple[tuple[str, ...], int]:
    """Return (names, n) of "at least n times"; ((), 0) for other formulas."""
    alternatives = alternatives_of(f)
    if alternatives is None or len(alternatives) != 1 or len(alternatives[0]) != 1:
        return (), 0
    (chain,) = alternatives[0]
    return (chain[0].options, chain[0].times) if len(chain) == 1 else ((), 0)


def _limit_of(f: Formula) -> tuple[tuple[str, ...], int] | None:
    """Return (names, n) of "at most n times"; None for other formulas."""
    if f.op != "!":
        return None
    options, times = _count_of(f.args[0])
    return (options, times - 1) if options else None


def _is_exact_count(part: Formula, parts: tuple[Formula, ...]) -> bool:
    """Return True if a part asks for exactly the number of visits that another part allows."""
    count = _count_of(part)
    return bool(count[0]) and any(_limit_of(other) == count for other in parts)


def _limit_until_text(f: Formula) -> str | None:
    """Return words for `!x W (x W (!x W end))`: at most one visit until the end."""
    start, n = f, 0  # n: visits allowed so far; each takes two levels, `!x W (x W …)`
    while f.op == "W" and f.args[0].op == "!":
        here, rest = f.args[0].args[0], f.args[1]
        if (options := options_of(here)) is None:
            return None
        if n and (end := options_of(rest)):
            limit = _stop_text(options, n, word="at most")
            return f"reach {limit} until {_choice_text(end)} is reached"
        if rest.op != "W" or rest.args[0] != here or start.args[0] != f.args[0]:
            return None
        f, n = rest.args[1], n + 1
    return None


_READ_OUT_START = "see to it, from the first step on,"
_OPERATOR_WORDS = {
    "!": "it is not so that {0}",
    "X": "there is a next step, and at it {0}",
    "WX": "if there is a next step, then at it {0}",
    "F": "now or later {0}",
    "G": "now and always {0}",
    "U": "now or later {1}, and until then {0}",
    "W": "always or until {1}, {0}",
    "R": "always, or up to and including when {0}, {1}",
    "M": "now or later {0}, and up to and including then {1}",
    "->": "if {0}, then {1}",
    "<->": "{0} exactly if {1}",
}


def _read_out(formula: Formula) -> str:
    """Return the formula read out operator by operator, operands in brackets."""
    texts: dict[int, str] = {}
    for f in postorder(formula):
        parts = [texts[id(arg)] if arg.op == "ap" else f"({texts[id(arg)]})" for arg in f.args]
        if f.op == "ap":
            texts[id(f)] = f"{_name_text(f.name)} is reached at that step"
        elif f.op in ("&", "|"):
            texts[id(f)] = (" and " if f.op == "&" else " or ").join(parts)
        elif f.op in ("true", "false"):
            texts[id(f)] = "anything happens" if f.op == "true" else "the impossible happens"
        else:
            texts[id(f)] = _OPERATOR_WORDS[f.op].format(*parts)
    return f"{_READ_OUT_START} that {texts[id(formula)]}"
