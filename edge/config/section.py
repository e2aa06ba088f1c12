"""What every section is made of."""

from __future__ import annotations

import importlib
import os
import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from edge import names
from edge.errors import UserError
from edge.text import one_line

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]


def _named(text: str) -> str:
    names.normalise(text)  # NotANameError is a ValueError, as pydantic wants it
    return text


Name = Annotated[str, AfterValidator(_named)]


class ConfigError(UserError):
    """A configuration that cannot be used; the message names file, key and choices."""

    exit_code = os.EX_CONFIG


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def own_or(*known: str) -> AfterValidator:
    """Lets one of these names through, and `module:Class` for what somebody wrote himself."""

    def check(kind: str) -> str:
        if kind not in known and not re.fullmatch(r"[\w.]+:\w+", kind):
            raise ValueError(f"unknown (choices: {', '.join(known)}, module:Class of your own)")
        return kind

    return AfterValidator(check)


def own_class(path: str, where: str) -> Any:
    """What `module:Class` names.

    Args:
        where: file and key that it stands under, for the error's line.

    Raises:
        ConfigError: there is no such module or class, or the module fails.
    """
    module, _, name = path.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except Exception as error:
        said = one_line(f"{type(error).__name__}: {error}")
        raise ConfigError(f"{where}: {path}: {said}; is it on PYTHONPATH?") from None
