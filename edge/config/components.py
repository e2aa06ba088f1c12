"""Construction of components that a configuration names, such as sinks and policies.

Our components have short names; plugins of the user are named `module:Class`.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from operator import attrgetter
from types import MappingProxyType
from typing import Any

from edge.errors import ConfigError, UserError
from edge.text import bounded_repr, one_line, redact

_PLAIN_TYPES: Mapping[str, tuple[str, Any]] = {
    "float": ("a number", (int, float)),
    "int": ("a number", (int, float)),
    "str": ("a text", str),
    "bool": ("true or false", bool),
}
"""Annotation of an option → the value to expect, in words and as types; others are not checked."""


def component_factory(
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
    """Return a function that makes a component, such as a sink, from keyword arguments.

    The returned function takes the arguments of `given`. It passes the options to the class, and
    those arguments of `given` for which the class has a parameter.

    A class that lacks a method of `needs` is refused here, before it is called. If the class has a
    method `check_options`, this method is called here, with the options and those arguments of
    `known` for which it has a parameter. So wrong options are refused before anything is opened.

    Args:
        what: kind of component, such as `sink`, for errors.
        kind: short name, or `module:Class`.
        options: arguments from the configuration.
        registry: short name → `module:Class`; a module is imported only if it is named.
        where: file and key of the component's section, for errors.
        needs: attributes that the component must have; names of methods end with `()`.
        given: names of the arguments that the caller will pass.
        functions: True: accept a function that returns the component, too.
        known: arguments of `given` that exist already.

    Raises:
        ConfigError: the class does not exist, is no such component, or an option is missing or
            unknown. The returned function raises it if the class fails, or if the component lacks
            an attribute of `needs`. One line.
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
    _check_options(signature, options, given, f"{where}.options")
    try:
        signature.bind(**dict.fromkeys(takes), **options)
    except TypeError as error:
        choices = ", ".join(name for name in signature.parameters if name not in given) or "none"
        raise ConfigError(f"{where}.options: {one_line(error)} (choices: {choices})") from None

    if (check := getattr(make, "check_options", None)) is not None:
        takes_known = inspect.signature(check).parameters.keys() & known.keys()
        try:
            check(**{name: known[name] for name in takes_known}, **options)
        except UserError:
            raise
        except Exception as error:
            raise ConfigError(f"{where}.options: {kind}: {_describe_error(error)}") from None

    def make_named(**parts: Any) -> Any:
        try:
            made = make(**{name: parts[name] for name in takes}, **options)
            missing = [name for name in needs if not _has(made, name)]
        except UserError:
            raise
        except Exception as error:  # a plugin may raise anything
            raise ConfigError(f"{where}.options: {kind}: {_describe_error(error)}") from None
        if missing:
            raise ConfigError(f"{where}.kind: {kind} is no {what}: it has no {missing[0]}")
        return made

    return make_named


def _check_options(
    signature: inspect.Signature, options: Mapping[str, Any], given: Sequence[str], where: str
) -> None:
    """Raise ConfigError if an option is unknown, or no number or text as its annotation says."""
    parameters = signature.parameters
    takes_any = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    for name, value in options.items():
        if name not in parameters:
            if takes_any:
                continue
            names = [key for key in parameters if key not in given]
            close = difflib.get_close_matches(str(name), names, n=1)
            choices = ", ".join(names) or "none"
            hint = f"did you mean {close[0]!r}?" if close else f"choices: {choices}"
            raise ConfigError(f"{where}.{one_line(name)}: unknown option ({hint})")
        if value == parameters[name].default:
            continue
        annotation = parameters[name].annotation
        annotation = getattr(annotation, "__name__", annotation)
        expected, types = _PLAIN_TYPES.get(str(annotation), ("", object))
        if not isinstance(value, types) or (expected == "a number" and isinstance(value, bool)):
            shown = bounded_repr(redact(value))
            raise ConfigError(f"{where}.{name}: expected {expected}, got {shown}")


def _find_class(kind: str, registry: Mapping[str, str], where: str) -> Any:
    """Import and return the class of a name; raise ConfigError if that fails."""
    module, colon, name = registry.get(kind, kind).partition(":")
    if not colon:
        choices = ", ".join(registry)
        raise ConfigError(
            f"{where}: unknown {bounded_repr(kind)} (choices: {choices}, or module:Class)"
        )
    try:
        return getattr(import_module(module), name)
    except Exception as error:  # the import of a plugin may raise anything
        missing = isinstance(error, ModuleNotFoundError)
        raise ConfigError(
            f"{where}: {bounded_repr(kind)} cannot be imported: {_describe_error(error)}"
            + ("; the folder of the module must be on PYTHONPATH" if missing else "")
        ) from None


def _has(part: object, name: str) -> bool:
    try:
        attrgetter(name.removesuffix("()"))(part)
    except AttributeError:
        return False
    return True


def _describe_error(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {error}")
