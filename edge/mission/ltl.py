"""Linear temporal logic over finite words (LTLf): formulas, their text, their meaning.

A word is what the robot reached, one object or nothing per step (ViTL IV-A). Semantics as in
De Giacomo and Vardi, "Linear temporal logic and linear dynamic logic on finite traces" (IJCAI
2013), extended to the empty word: a proposition, X, F, U and M are false of it; WX, G, R and W
are true; ! negates.

>>> f = parse("F ((chair | couch) & F tv)")
>>> holds(f, ["couch", None, "tv"]), holds(f, ["tv", "couch"])
(True, False)
"""

from __future__ import annotations

from edge.mission.logic.formula import (
    FALSE,
    TRUE,
    Formula,
    always,
    ap,
    conj,
    disj,
    eventually,
    iff,
    implies,
    neg,
    next_,
    postorder,
    propositions,
    release,
    strong_release,
    to_text,
    until,
    weak_next,
    weak_until,
)
from edge.mission.logic.ltl_parser import FormulaError, parse, parse_prefix
from edge.mission.logic.semantics import holds

__all__ = [
    "FALSE", "TRUE", "Formula", "FormulaError", "always", "ap", "conj", "disj", "eventually",
    "holds", "iff", "implies", "neg", "next_", "parse", "parse_prefix", "postorder",
    "propositions", "release", "strong_release", "to_text", "until", "weak_next", "weak_until",
]  # fmt: skip
