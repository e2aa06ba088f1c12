"""Overrides: keys of the file that the environment or the command line sets to other values."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from edge.config.explain import models_in
from edge.config.yaml_text import YamlTooLargeError, parse_yaml
from edge.errors import ConfigError
from edge.logs import first_time
from edge.text import bounded_repr, one_line, redact

log = logging.getLogger("edge.config")

PREFIX = "EDGE__"
"""First characters of the variables that set a key."""
KNOWN_VARIABLES = ("EDGE_CACHE_DIR", "EDGE_VOCABULARY", "EDGE_TRUST_CACHE")
"""Variables that `edge` reads in addition to those that set a key."""


class KeyOrigins(dict[tuple[str, ...], str]):
    """Parts of each overridden key → the variable or option that set the key.

    All instances compare equal, so configurations with the same values are equal.

    Attributes:
        added_sections: sections that overrides added and the file does not have.
    """

    def __init__(self) -> None:
        super().__init__()
        self.added_sections: set[tuple[str, ...]] = set()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, KeyOrigins)

    def describe(self, path: str, *keys: tuple[str, ...]) -> str:
        """Return the sources to name in an error: the file, a variable, an option, or several."""
        return ", ".join(dict.fromkeys(name for key in keys for name in self._sources(path, key)))

    def _sources(self, path: str, key: tuple[str, ...]) -> list[str]:
        """Return the sources of one key: an override of it, else the file and related overrides."""
        starts = [key[:n] for n in range(len(key), 0, -1)]  # the key, then the sections around it
        if (origin := next(filter(None, map(self.get, starts)), None)) is not None:
            return [origin]
        # A key may be wrong because an override chose the kind of its section.
        kinds = {(*start, "kind") for start in starts}
        parts = [
            origin for other, origin in self.items() if other[: len(key)] == key or other in kinds
        ]
        return parts if key in self.added_sections else [path, *parts]


def apply_overrides(
    data: dict[str, Any], environ: Mapping[str, str], options: Mapping[str, str]
) -> KeyOrigins:
    """Write each `EDGE__A__B=value` of the environment to `data["a"]["b"]`, in place.

    Args:
        data: content of the configuration file.
        environ: the environment. Values are read as YAML.
        options: command line options that set a variable of `environ`, by variable.

    Returns:
        The variable or option that set each overridden key.

    Raises:
        ConfigError: a value cannot be read as YAML; one line.
    """
    origins = KeyOrigins()
    for name in sorted(name for name in environ if name.startswith(PREFIX)):
        origin = options.get(name, f"environment {name}")
        key = tuple(name[len(PREFIX) :].lower().split("__"))
        *sections, leaf = key
        node = data
        for n, section in enumerate(sections, start=1):
            child = node.get(section)
            if not isinstance(child, dict):
                child = node[section] = {}
                origins.added_sections.add(key[:n])
            node = child
        try:
            node[leaf] = parse_yaml(environ[name])
        except YamlTooLargeError as error:
            raise ConfigError(f"{origin}: {error}; give a shorter value") from None
        except ValueError:  # its message may quote a secret
            shown = bounded_repr(redact(environ[name]))
            raise ConfigError(
                f"{origin}: cannot be read as YAML: {shown}; put text with any of : # [ ] {{ }} in "
                "quotes"
            ) from None
        origins[key] = origin
    return origins


def is_ours(name: str) -> bool:
    """Return True if a variable has a name that `edge` could read."""
    return name.upper().startswith("EDGE_")


def warn_of_unknown_variables(environ: Mapping[str, str], root: type[BaseModel]) -> None:
    """Log a warning for each `EDGE_` variable that nothing reads, once in each process."""
    for name in sorted(environ):
        if (
            is_ours(name)
            and not name.startswith(PREFIX)
            and name not in KNOWN_VARIABLES
            and first_time(name)
        ):
            known = [*KNOWN_VARIABLES, *_variables(root, PREFIX)]
            close = difflib.get_close_matches(name.upper(), known, n=1, cutoff=0.8)
            hint = f"did you mean {close[0]}?" if close else f"{PREFIX}SECTION__KEY sets a key"
            log.warning("environment variable %s is not used: %s", one_line(name), hint)


def _variables(model: type[BaseModel], prefix: str) -> Iterator[str]:
    """Yield the name of the variable that sets each key."""
    for name, field in model.model_fields.items():
        variable = prefix + name.upper()
        yield variable
        for below in models_in(field.annotation):
            yield from _variables(below, f"{variable}__")
