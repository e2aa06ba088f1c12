"""Controlled English to LTL, offline; the same sentence always gives the same formula.

    instruction = sentence { ("." | ";") sentence }
    sentence    = sequence { "or" sequence }        ("…; or …" also across a semicolon)
    sequence    = step { "then" step }
    step        = clause { (",", "and", "but", nothing) clause }

Clauses, adjuncts, noun phrases, counts and moods, and the vocabulary have their own modules
(`clauses`, `adjuncts`, `noun_phrases`, `clause_parts`, `lexicon`). Clauses have these meanings:

- An order ("visit x") is a goal. Every verb of the lexicon means "reach", including "see"; other
  verbs are refused. After an article, any words are a name; without an article, only known names.
- A duty with a condition ("once you visit x you must visit y") is G(x -> F y). A permission
  ("you can visit x") asks for nothing.
- "Do not x until y", and the same with "before", is the weak until `!x W y`: y need not happen.
  ViTL writes U, but its tables II and III are right only with W.
- "x before y" as an order asks for both, and y not before x; or for x only; or only for x, then
  y. "x only after y" asks for x, and not before y.
- "x while avoiding y" is x, and no y before it.
- An object on the way ("x via y", "through y to x", "visit y on the way to x") is y, then x. For
  "through y and z" the user is asked for the order. "From y" is refused, because a mission starts
  at the robot.
- For "do not x until y" without a goal, the user is asked: y, or both, may be meant. A chain of
  them ("not c until b, not b until a") asks for a, then b, then c.
- Goals without "then" between them may come in any order. A list with only commas before "then"
  ("a, b, then c") is in order.
- "In order" is "then" between all. "In exactly this order" also forbids each before the previous.
- "n times" means at least n separate visits. In a sequence, "exactly once" and "at most once"
  hold until the next step.
- "Each place only once", "no revisiting", "none out of turn" apply to all goals. In a sequence,
  each place is reached once until the next step, and not before its turn.
- "Go to a. drive to b." is in order, unless "then", "also" or "any order" occurs anywhere.

Staying, leaving, places in a house, relations between objects, and times are refused before
parsing (`unsupported`). Other unknown parts are refused with a message that names them. No word is
skipped or guessed.
"""

from __future__ import annotations

import re

from edge.mission.language.grammar.discourse import Discourse
from edge.mission.language.grammar.unsupported import refuse_unsupported
from edge.mission.language.words.nouns import is_foreign
from edge.mission.language.words.tokens import (
    TokenReader,
    TranslationError,
    not_understood,
    tokenise,
)
from edge.mission.logic.ltl import Formula

_GROUPED = re.compile(r"\d,\d{3}\b")  # "1,000"

__all__ = ["TranslationError", "readings"]

MAX_READINGS = 12
"""Largest number of readings of one instruction; more are refused."""


def readings(text: str) -> tuple[Formula, ...]:
    """Return the formulas that an instruction may ask for, the usual one first.

    The text is parsed once for each combination of choices at ambiguous tokens. Propositions are
    canonical names.

    Raises:
        TranslationError: a part is not understood (the message names it), or there are more than
            `MAX_READINGS` readings.

    Example:
        >>> [str(formula) for formula in readings("Go to the bed, then to the sofa.")]
        ['F (bed & F sofa)']
    """
    if grouped := _GROUPED.search(text):
        hint = "write numbers without commas"
        raise not_understood(grouped[0], grouped.start() + 1, hint)
    tokens = tokenise(text)
    refuse_unsupported(TokenReader(text, tokens))
    found: list[Formula] = []
    todo: list[dict[int, int]] = [{}]  # combinations of choices, by offset of the token
    for picks in todo:  # grows in the loop
        reader = TokenReader(text, tokens, picks)
        try:
            found.append(Discourse(reader).formula())
        except TranslationError:
            if picks:
                continue  # this choice leads to no reading
            if is_foreign(text):
                hint = "instructions are read in English only"
                raise not_understood(text, 1, hint) from None
            raise
        # Add choices only at later tokens, so that each combination comes once.
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
