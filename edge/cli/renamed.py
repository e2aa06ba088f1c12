"""Commands whose name has changed: the old one is taken for one release, with a warning."""

from __future__ import annotations

from collections.abc import Sequence

RENAMED = {
    "motion": "sim --motion-only",
    "recover": "replay --recover",
    "trace": "replay --trace",
    "fleet watch": "fleet list --watch",
    "fleet new": "mission new --fleet",
    "fleet status": "mission status --fleet",
    "fleet pause": "mission pause --fleet",
    "fleet resume": "mission resume --fleet",
    "fleet cancel": "mission cancel --fleet",
    "install-service": "run --install",
    "models check": "models list --check",
    "models quantize": "models export --quantize",
    "models bench": "bench --models",
    "eval compare": "eval episodes --compare",
}
"""New words by old ones. What followed the old words follows the new ones."""


def renew(argv: Sequence[str]) -> tuple[list[str], str | None]:
    """Return the arguments with today's words, and a line that says so if others were given."""
    at = 0  # of the command, behind options of `edge` itself
    while at < len(argv) and argv[at].startswith("-"):
        at += 1 + (argv[at] == "--log-level")
    for n in (1, 2):
        if new := RENAMED.get(old := " ".join(argv[at : at + n])):
            argv = [*argv[:at], *new.split(), *argv[at + n :]]
            return argv, f"edge {old} is now: edge {new}"
    return list(argv), None
