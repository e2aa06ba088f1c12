"""What a configuration names: a part of ours by a short name, one's own as `module:Class`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from operator import attrgetter
from types import MappingProxyType
from typing import Any

from edge.errors import ConfigError, UserError
from edge.text import bounded_repr, one_line


def find_named(
    what: str,
    kind: str,
    options: Mapping[str, Any],
    registry: Mapping[str, str],
    where: str,
    needs: Sequence[str],
    given: Sequence[str] = (),
    *,
    functions: bool = False,
    known: Mapping[str, Any] = MappingProxyType({}),
) -> Callable[..., Any]:
    """Return a function that makes the part of a name, from all that is `given`, by name.

    It calls the part's class with the options, and with what it has a parameter for of `given`. A
    class that lacks a method of `needs` is refused here, and never called: it may be any class.
    Its method `check_options`, if it has one, is called at once, with the options and with what
    that has a parameter for of `known`. It refuses what is wrong before anything is opened.

    Args:
        what: the part is, such as `sink`, for errors.
        registry: short name → `module:Class`, imported only where it is named.
        where: of the part's section, file and key, for errors.
        needs: what the part must have; methods end with `()`.
        functions: take a function that makes the part, too.
        known: what is there already of `given`.

    Raises:
        ConfigError: there is no such class, it is no such part, or an option is missing or unknown.
            Calling what is returned raises it too, when the class fails or what it makes lacks an
            attribute of `needs`. One line.
    """
    make = _find_class(kind, registry, f"{where}.kind")
    try:
        signature = inspect.signature(make)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}.kind: {kind} is no {what}: {one_line(error)}") from None
    if isinstance(make, type):
        methods = [name for name in needs if name.endswith("()") and "." not in name]
        missing = [name for name in methods if not callable(getattr(make, name[:-2], None))]
        if missing:
            raise ConfigError(f"{where}.kind: {kind} is no {what}: it has no {missing[0]}")
    elif not functions:
        raise ConfigError(f"{where}.kind: {kind} is no {what}: it is no class")
    takes = [name for name in given if name in signature.parameters]
    try:
        signature.bind(**dict.fromkeys(takes), **options)
    except TypeError as error:
        raise ConfigError(f"{where}.options: {one_line(error)}") from None

    if (check := getattr(make, "check_options", None)) is not None:
        takes_known = inspect.signature(check).parameters.keys() & known.keys()
        try:
            check(**{name: known[name] for name in takes_known}, **options)
        except UserError:
            raise
        except Exception as error:
            raise ConfigError(f"{where}.options: {kind}: {_said(error)}") from None

    def make_named(**parts: Any) -> Any:
        try:
            made = make(**{name: parts[name] for name in takes}, **options)
            missing = [name for name in needs if not _has(made, name)]
        except UserError:
            raise
        except Exception as error:  # whatever one's own class does
            raise ConfigError(f"{where}.options: {kind}: {_said(error)}") from None
        if missing:
            raise ConfigError(f"{where}.kind: {kind} is no {what}: it has no {missing[0]}")
        return made

    return make_named


def _find_class(kind: str, registry: Mapping[str, str], where: str) -> Any:
    """The class of a name, imported; raises ConfigError, in one line."""
    module, colon, name = registry.get(kind, kind).partition(":")
    if not colon:
        choices = ", ".join(registry)
        raise ConfigError(
            f"{where}: unknown {bounded_repr(kind)} (choices: {choices}, or module:Class)"
        )
    try:
        return getattr(import_module(module), name)
    except Exception as error:  # whatever the module does when it is imported
        raise ConfigError(
            f"{where}: {bounded_repr(kind)}: {_said(error)}; its folder must be on PYTHONPATH"
        ) from None


def _has(part: object, name: str) -> bool:
    try:
        attrgetter(name.removesuffix("()"))(part)
    except AttributeError:
        return False
    return True


def _said(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {error}")
