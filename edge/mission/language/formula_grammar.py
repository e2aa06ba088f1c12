"""The grammar that keeps a language model to formulas about given objects.

GBNF is the notation of llama.cpp; vLLM's grammars (xgrammar) are written the same way.
"""

from __future__ import annotations

from collections.abc import Sequence

from edge.mission.ltl import ap, to_text

MOST_NAMES = 100
MOST_NESTING = 8  # parentheses within parentheses: a sequence of n objects needs n - 1
MOST_OPERANDS = 12
SPARE = 3  # more of both than there are names: an object may be wanted several times

UNARY = ("!", "F ", "G ", "X ")
BINARY = (" W ", " U ")  # the other operators say nothing that these cannot
ANY_NAME = r'"\"" [^"\\\x00-\x1f] [^"\\\x00-\x1f]{0,39} "\""'


def gbnf(phrases: Sequence[str]) -> str:
    """GBNF of the formulas whose propositions are among `phrases`.

    Nesting and the number of operands are bounded by how many phrases there are, so that a model
    which repeats itself comes to an end. With more than `MOST_NAMES`, every name in quotes is
    allowed.

    >>> print(gbnf(["tv", "potted plant"]).splitlines()[1])
    name ::= "tv" | "\\"potted plant\\""
    """
    texts = dict.fromkeys(to_text(ap(phrase)) for phrase in phrases)
    name = ANY_NAME if len(texts) > MOST_NAMES else " | ".join(map(_literal, texts))
    nesting = min(len(texts) + SPARE, MOST_NESTING)
    operands = min(len(texts) + SPARE, MOST_OPERANDS)
    rules = {
        "root": f"first{nesting} (and{nesting} | or{nesting})?",
        "name": name,
        "unary": " | ".join(map(_literal, UNARY)),
        "binary": " | ".join(map(_literal, BINARY)),
    }
    for n in range(nesting + 1):
        rules |= _level(n, operands)
    return "\n".join(f"{rule} ::= {body}" for rule, body in rules.items()) + "\n"


def _level(n: int, operands: int) -> dict[str, str]:
    """The rules of formulas with at most `n` parentheses within each other, `operands` per & or |.

    Within a pair of parentheses stands one kind of &, | or ->, so that nobody has to know which
    binds tighter. One step reaches one object, so only the first part of a conjunction may be a
    bare name, and none a conjunction of its own: `a & b` contradicts itself, and small models
    like to go on with it for ever.
    """
    times = f"{{1,{operands - 1}}}"
    rules = {
        f"first{n}": f"name | timed{n}",
        f"and{n}": f'(" & " timed{n}){times}',
        f"or{n}": f'(" | " first{n}){times} | " -> " timed{n}',
        f"timed{n}": f"signed{n} (binary first{n})?",
        f"signed{n}": "unary{1,3} name",
    }
    if n > 0:
        rules[f"both{n}"] = f'"(" first{n - 1} and{n - 1} ")"'
        rules[f"either{n}"] = f'"(" (first{n - 1} or{n - 1} | timed{n - 1}) ")"'
        rules[f"first{n}"] = f"name | timed{n} | both{n}"
        rules[f"signed{n}"] = f"unary{{1,3}} (name | both{n} | either{n}) | either{n}"
    return rules


def _literal(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
