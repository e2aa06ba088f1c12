"""What was understood, in the words of a person: "Go to the kitchen, then look for the mug." """

from __future__ import annotations

import re
from collections.abc import Sequence

from edge.text import one_line

_IN_ENGLISH = (
    (r'"start"', "the start"),
    (r'"here"', "the place where this mission begins"),
    (r'"caller"', "the person who called"),
    (r'"explored(?: for ([^"]+))?"', r"the end of exploring"),
    (r'"explored ([^"]+?)"', r"the end of exploring the \1"),
    (r'"wait"', "the end of a wait until told to go on"),
    (r'"wait ([^"]+)"', r"the end of a wait of \1"),
    (r'"check ([^"]+)"', r"the answer if the \1 is there"),
)


def told_back(english: str, reasons: Sequence[str]) -> str:
    """Return the English of a formula, with destinations in plain words.

    Args:
        english: see `edge.mission.language.english`.
        reasons: clauses that were left out; they are named.
    """
    for pattern, plain in _IN_ENGLISH:
        english = re.sub(rf"(?:the )?{pattern}", plain, english)
    unused = "; ".join(f"'{one_line(reason)}'" for reason in reasons)
    return f"{english} (Not part of the order: {unused}.)" if unused else english
