"""What a configuration names: a part of ours by a short name, one's own as `module:Class`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from edge.errors import ConfigError
from edge.text import one_line


def find_class(kind: str, registry: Mapping[str, Any], where: str) -> Any:
    """The class of a short name, or one that is imported.

    Args:
        where: of the name, file and key, for errors.

    Raises:
        ConfigError: there is none, in one line.
    """
    module, colon, name = kind.partition(":")
    if not colon:
        if kind in registry:
            return registry[kind]
        choices = ", ".join(registry)
        raise ConfigError(f"{where}: unknown {kind!r:.80} (choices: {choices}, or module:Class)")
    try:
        return getattr(import_module(module), name)
    except Exception as error:  # whatever the module does when it is imported
        said = one_line(f"{type(error).__name__}: {error}")
        raise ConfigError(
            f"{where}: {kind!r:.80}: {said}; its folder must be on PYTHONPATH"
        ) from None


def check_call(
    make: Callable[..., Any], arguments: int, options: Mapping[str, Any], where: str
) -> None:
    """That something can be called with so many arguments and these options.

    Raises:
        ConfigError: an option is missing or unknown, in one line.
    """
    try:
        inspect.signature(make).bind(*[None] * arguments, **options)
    except TypeError as error:
        raise ConfigError(f"{where}: {one_line(error)}") from None
