"""Old names of commands and options, which are accepted with a warning for one release."""

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

OPTIONS = {
    "mission new --anew": "--restart",
    "eval episodes --column": "--arm",
    "eval episodes --columns": "--arms",
}
"""Command words and an old option → the new option."""


def translate_renamed(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments with the new names, and a warning for each old one."""
    at = 0  # index of the command, after the options of `edge` itself
    while at < len(argv) and argv[at].startswith("-"):
        at += 1 + (argv[at] == "--log-level")  # this option has a value, which is skipped, too
    before, command, warnings = list(argv[:at]), list(argv[at:]), []
    for n in (1, 2):  # an old name has one or two words
        if new := RENAMED.get(old := " ".join(command[:n])):
            command = [*new.split(), *command[n:]]
            warnings.append(f"edge {old} is now: edge {new}")
            break
    words = " ".join(command[:2])
    for i, argument in enumerate(command):
        if argument == "--":
            break
        old, equals, value = argument.partition("=")
        if new := OPTIONS.get(f"{words} {old}"):
            command[i] = new + equals + value
            warning = f"edge {words} {old} is now: {new}"
            if warning not in warnings:
                warnings.append(warning)
    return [*before, *command], warnings
