"""Text from outside, made safe to log, print and send on."""

from __future__ import annotations

MAX_CHARS = 200


def one_line(text: object, limit: int = MAX_CHARS) -> str:
    """One line without control characters, of at most `limit` characters.

    What a peer, a server or a file says may hold line breaks that forge log lines, escapes that
    drive a terminal, or a novel. Whatever does not print becomes a space, runs of spaces become
    one, and what is too long ends in `…`.

    >>> one_line("stuck\\n12:00 info mission:\\x1b[31m reached")
    'stuck 12:00 info mission: [31m reached'
    """
    # Ten times the limit is looked at: a novel costs no more than a letter.
    line = " ".join(_printable(str(text)[: 10 * limit]).split())
    return line if len(line) <= limit else line[: limit - 1] + "…"


def printable_lines(text: object) -> str:
    """The lines of a text of ours that quotes others' words, without control characters.

    >>> printable_lines("robot.yaml: one fault\\nrobot.yaml: \\x1b[2J")
    'robot.yaml: one fault\\nrobot.yaml:  [2J'
    """
    return "\n".join(map(_printable, str(text).splitlines()))


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
