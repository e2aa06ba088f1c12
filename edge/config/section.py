"""Base class of all sections of the configuration, and types of their values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from edge import names

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
CardName = Annotated[str, Field(min_length=1)]
FilePath = Annotated[str, Field(min_length=1)]


def _check_name(text: str) -> str:
    names.normalise(text)  # NotANameError is a ValueError, as pydantic needs
    return text


Name = Annotated[str, AfterValidator(_check_name)]

MODULE_CLASS = "module:Class"  # tag and placeholder of the kind of a plugin


def _check_plugin_kind(kind: str) -> str:
    module, _, name = kind.partition(":")
    if not (name.isidentifier() and all(part.isidentifier() for part in module.split("."))):
        raise ValueError(f"expected {MODULE_CLASS}, such as my_package.my_module:MyClass")
    return kind


PluginKind = Annotated[
    str, AfterValidator(_check_plugin_kind), Field(json_schema_extra={"pattern": ":"})
]
"""Kind of a plugin: a class of the user, on PYTHONPATH."""


def kind_of(section: Any) -> str | None:
    """Return the tag of a section in its union: its kind, or `MODULE_CLASS` for a plugin."""
    kind = section.get("kind") if isinstance(section, dict) else getattr(section, "kind", None)
    return MODULE_CLASS if isinstance(kind, str) and ":" in kind else kind


class Section(BaseModel):
    """Base of all sections: frozen; unknown keys, infinity and NaN are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OnnxModel(Section):
    """An ONNX model that onnxruntime runs.

    Attributes:
        model: name of its card.
        providers: execution providers of onnxruntime, best first.
        threads: CPU threads of the model.
        device_id: number of the GPU.
    """

    model: str
    providers: tuple[str, ...] = ("CPUExecutionProvider",)
    threads: Annotated[int, Field(ge=1, le=64)] = 2
    device_id: Annotated[int, Field(ge=0)] = 0


def plugin_kinds(section: Section, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield key and value of each `kind` in a section that names a plugin."""
    for name in type(section).model_fields:
        value = getattr(section, name)
        if name == "kind" and kind_of(section) == MODULE_CLASS:
            yield f"{prefix}{name}", value
        elif isinstance(value, Section):
            yield from plugin_kinds(value, f"{prefix}{name}.")
        elif isinstance(value, tuple):
            for i, part in enumerate(value):
                if isinstance(part, Section):
                    yield from plugin_kinds(part, f"{prefix}{name}.{i}.")
