"""Base class of the reports of parity checks."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from exporters.files import ExportError

AT_MOST = ("score_error", "max_abs_diff")
"""Figures whose limit is a maximum; for all others it is a minimum."""
MAY_BE_UNKNOWN = ("rank_agreement",)
"""Figures that are accepted if they are unknown."""


@dataclass(frozen=True)
class Report:
    """Base class of reports: a subclass has one field for each figure; NaN if unknown."""

    def figures(self) -> dict[str, Any]:
        """Return the figures by name, rounded; None if unknown."""
        return {name: _rounded(value) for name, value in asdict(self).items()}

    def table(self) -> str:
        """Return one readable line per figure."""
        return "\n".join(f"  {name:<16}{value!s:>12}" for name, value in self.figures().items())

    def accept(self, what: str, reference: str, limits: Mapping[str, float] | None) -> None:
        """Print the figures; raise ExportError if one is worse than its limit, if there are any.

        An unknown figure fails its limit, except for `MAY_BE_UNKNOWN`.
        """
        print(f"{what} against {reference}:\n{self.table()}", file=sys.stderr)
        worse = []
        for name, limit in (limits or {}).items():
            value = getattr(self, name)
            if math.isnan(value) and name in MAY_BE_UNKNOWN:
                continue
            is_within = value <= limit if name in AT_MOST else value >= limit  # False for NaN
            if not is_within:
                worse.append(f"{name} {value:.4g} {'>' if name in AT_MOST else '<'} {limit:.4g}")
        if worse:
            raise ExportError(
                f"{what}: differs too much from the original model ({', '.join(worse)}); calibrate "
                "on more images like those that the robot sees, or keep the file anyway with "
                "--no-gate"
            )


def _rounded(value: float) -> float | None:
    """Return a figure with six digits; None for NaN."""
    if math.isnan(value):
        return None
    return value if isinstance(value, int) else float(f"{value:.6g}")
