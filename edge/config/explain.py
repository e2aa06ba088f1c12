"""Error messages for wrong YAML files, with the keys that the user wrote.

The configuration and the model cards are checked by pydantic, whose list of faults becomes one line
for each fault here.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from typing import Any, get_origin

from pydantic import BaseModel, ValidationError

from edge.text import bounded_repr, one_line, redact

MOST_FAULTS = 20  # faults that are listed; more are only counted

Origin = Callable[[str, tuple[str, ...]], str]
"""Function that returns the file, variable or option that set a key (`KeyOrigins.describe`).

Its arguments are the path of the file and the parts of the key.
"""


def _file_only(path: str, key: tuple[str, ...]) -> str:
    return path


def explain_all(
    error: ValidationError, path: str, root: type[BaseModel], origin: Origin = _file_only
) -> str:
    """Return one line for each fault, at most `MOST_FAULTS`, and a line that counts the rest."""
    faults = error.errors()
    lines = [explain(fault, path, root, origin) for fault in faults[:MOST_FAULTS]]
    if len(faults) > MOST_FAULTS:
        lines.append(f"{path}: {len(faults) - MOST_FAULTS} more faults")
    return "\n".join(lines)


def explain(fault: Any, path: str, root: type[BaseModel], origin: Origin = _file_only) -> str:
    """Return one line for one fault of pydantic's list."""
    loc = [part for part in fault["loc"] if part != "[key]"]  # pydantic's mark of a wrong key
    *sections, leaf = loc or ("",)
    shown, models = _walk(sections, root)
    key = one_line(".".join([*shown, one_line(leaf) or "''"]))
    kind, context = fault["type"], fault.get("ctx", {})
    tag = ("kind",) if kind == "union_tag_invalid" else ()
    path = origin(path, (*shown, str(leaf), *tag))
    where = f"{path}: {key}" if loc else path  # without a key: a fault of the entire file
    given = redact(fault.get("input"))
    if kind == "union_tag_invalid":
        choices = context["expected_tags"].replace("'", "")
        return f"{where}.kind: unknown {bounded_repr(context['tag'])} (choices: {choices})"
    no_section = kind == "union_tag_not_found" and not isinstance(fault["input"], dict)
    if no_section or kind in ("model_type", "model_attributes_type"):
        return f"{where}: expected a section of keys, got {bounded_repr(given)}"
    if kind == "tuple_type":
        return f"{where}: expected a list, got {bounded_repr(given)}"
    if kind in ("missing", "union_tag_not_found"):
        return f"{where}{_missing(fault, models, root)}"
    if kind == "literal_error":
        choices = context["expected"].replace("'", "").replace(" or ", ", ")
        return f"{where}: unknown {bounded_repr(given)} (choices: {choices})"
    if kind == "extra_forbidden":
        names = sorted({name for model in models for name in model.model_fields} - {"path"})
        close = difflib.get_close_matches(str(leaf), names, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"choices: {', '.join(names)}"
        return f"{where}: unknown key ({hint})"
    message = fault["msg"].removeprefix("Value error, ")
    got = "" if isinstance(given, dict) else f", got {bounded_repr(given)}"
    return f"{where}: {message[0].lower()}{message[1:]}{got}"


def _missing(fault: Any, models: list[Any], root: type[BaseModel]) -> str:
    """Return the end of the message for a missing key; for a union with its kinds and advice."""
    loc = fault["loc"]
    kinds = [
        m.model_fields["kind"].default
        for m in _walk(list(loc), root)[1]
        if "kind" in m.model_fields
    ]
    field = models[0].model_fields.get(str(loc[-1])) if models else None
    if not kinds or (field is not None and get_origin(field.annotation) is tuple):
        return ": missing"
    advice = field.description if field is not None else None
    # Without its kind a section is not checked further, so a misspelt `kind` is looked for here.
    given = fault["input"] if isinstance(fault["input"], dict) else {}
    close = difflib.get_close_matches("kind", [str(key) for key in given], n=1)
    instead = f", but there is {one_line(close[0])!r}" if close else ""
    choices = f"(choices: {', '.join(kinds)})"
    return f".kind: missing{instead} {choices}{': ' + advice if advice else ''}"


def _walk(sections: list[Any], root: type[BaseModel]) -> tuple[list[str], list[Any]]:
    """Return the sections as the user wrote them, and the models of the last section.

    pydantic adds the kind of a union after its key (`policy`, `hvl`), or the class if the models
    have no kind. The file has no such level, so this part is left out. The index of a list is kept.
    """
    shown: list[str] = []
    models: list[Any] = [root]
    for part in map(str, sections):
        if part.isdigit():
            shown.append(part)
        elif len(models) > 1:  # a union: this part is the kind, or the class if there is no kind
            models = [m for m in models if part == _tag(m)]
        else:
            shown.append(part)
            fields = models[0].model_fields if models else {}
            models = models_in(fields[part].annotation) if part in fields else []
    return shown, models


def _tag(model: Any) -> str:
    """Return pydantic's name for one model of a union: its kind, or its class."""
    return model.model_fields["kind"].default if "kind" in model.model_fields else model.__name__


def models_in(annotation: Any) -> list[Any]:
    """Return the pydantic models that a type annotation contains."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for arg in getattr(annotation, "__args__", ()) for m in models_in(arg)]
