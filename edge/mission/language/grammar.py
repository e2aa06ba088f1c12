"""Controlled English to LTL, offline: the same sentence always gives the same formula.

    instruction = sentence { ("." | ";") sentence }
    sentence    = sequence { "or" sequence }        ("…; or …" also across a semicolon)
    sequence    = step { "then" step }
    step        = clause { (",", "and", "but", nothing) clause }

Clauses, what may follow their verbs, noun phrases, moods and counts, and the words themselves have
files of their own (`clauses`, `adjuncts`, `things`, `spoken`, `lexicon`). How a clause is read:

- an order ("visit x") is a goal. Every verb of the lexicon means "reach", "see" included; other
  verbs are refused. After an article any words are a name; without one, known names are;
- a duty with a condition ("once you visit x you must visit y") is G(x -> F y); a permission
  ("you can visit x") asks for nothing;
- "do not x until y", and the like with "before", is the weak until `!x W y`: y need not happen.
  ViTL writes U, but its tables II and III hold only under W;
- "x before y" as an order asks for both, and y not before x; or for x only; or merely for x, then
  y. "x only after y" asks for x, and not before y;
- "x while avoiding y" is: x, and no y before it;
- what lies on the way ("x via y", "through y to x", "visit y on the way to x") is: y, then x; of
  "through y and z" the order is asked; "from y" is refused, as a mission starts where the robot is;
- "do not x until y" with nothing asked for beside it is asked about: y, or both, may be meant;
  a chain of them ("not c until b, not b until a") asks for a, then b, then c;
- goals without "then" between them may come in any order; a list with commas only that "then"
  ends ("a, b, then c") is in order;
- "in order" is "then" between all; "in exactly this order" also bans each before the one before;
- "n times" means at least n separate visits; in a sequence, "exactly once" and "at most once"
  hold until the next step;
- "each place only once", "no revisiting", "none out of turn" are said of all that is asked for: in
  a sequence each is reached once until the next step, and not before its turn;
- "go to a. drive to b." is in order, unless "then", "also" or "any order" is said somewhere;

Staying, leaving, places in a house, relations between things, and times are refused before anything
is parsed (`beyond`). Whatever fits none of this is refused by name, never skipped or guessed.
"""

from __future__ import annotations

import re

from edge.mission.language.beyond import refuse_beyond
from edge.mission.language.discourse import Discourse
from edge.mission.language.nouns import is_foreign
from edge.mission.language.words import Reader, TranslationError, not_understood, tokenise
from edge.mission.logic.ltl import Formula

_GROUPED = re.compile(r"\d,\d{3}\b")

__all__ = ["TranslationError", "readings"]

MAX_READINGS = 12
"""The most ways to read one instruction that anybody is asked to choose from."""


def readings(text: str) -> tuple[Formula, ...]:
    """The formulas that an instruction may ask for, over canonical names; the usual one first.

    The text is read once for each way to go at each token where English leaves it open.

    Raises:
        TranslationError: it has a part that is not understood, which the message names, or can be
            read in more than `MAX_READINGS` ways.
    """
    if grouped := _GROUPED.search(text):
        hint = "write numbers without commas"
        raise not_understood(grouped[0], grouped.start() + 1, hint)
    tokens = tokenise(text)
    refuse_beyond(Reader(text, tokens))
    found: list[Formula] = []
    todo: list[dict[int, int]] = [{}]
    for picks in todo:
        reader = Reader(text, tokens, picks)
        try:
            found.append(Discourse(reader).formula())
        except TranslationError:
            if picks:
                continue  # this way leads nowhere
            if is_foreign(text):
                hint = "instructions are read in English only"
                raise not_understood(text, 1, hint) from None
            raise
        last = max(picks, default=-1)
        todo += [
            {**picks, start: way}
            for start, ways in sorted(reader.forks.items())
            if start > last
            for way in range(1, ways)
        ]
        if len(todo) > MAX_READINGS:
            hint = "it has too many possible meanings; use several sentences"
            reader.refuse(hint, tokens[0])
    return tuple(found)
