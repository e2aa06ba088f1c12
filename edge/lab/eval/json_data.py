"""Figures as JSON data."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def json_data(value: Any, digits: int | None = None) -> Any:
    """Return data that `json.dumps` takes: named tuples become objects, inf and NaN null.

    Numbers are rounded to `digits` after the point; None: not at all.

    Example:
        >>> json_data({"rate": (0.12345, float("nan"))}, digits=2)
        {'rate': [0.12, None]}
    """
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {str(key): json_data(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_data(item, digits) for item in value]
    if isinstance(value, (float, np.floating)):
        if not math.isfinite(value):
            return None
        return float(value) if digits is None else round(float(value), digits)
    return value
