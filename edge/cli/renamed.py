"""Old names of commands, which are accepted with a warning for one release."""

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
"""Old command words → new ones. The arguments after them stay."""


def translate_renamed(argv: Sequence[str]) -> tuple[list[str], str | None]:
    """Return the arguments with the new command words, and a warning if the old ones were given."""
    at = 0  # index of the command, after the options of `edge` itself
    while at < len(argv) and argv[at].startswith("-"):
        at += 1 + (argv[at] == "--log-level")
    for n in (1, 2):
        if new := RENAMED.get(old := " ".join(argv[at : at + n])):
            argv = [*argv[:at], *new.split(), *argv[at + n :]]
            return argv, f"edge {old} is now: edge {new}"
    return list(argv), None
