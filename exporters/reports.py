"""Figures of a parity check, and their limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from exporters.files import ExportError

AT_MOST = ("score_error", "max_abs_diff")
"""Figures whose limit is a maximum; for all others it is a minimum."""
MAY_BE_UNKNOWN = ("rank_agreement",)
"""Figures that pass their limit if they are unknown."""


@dataclass(frozen=True)
class Report:
    """Figures of a comparison, one for each field; NaN if unknown."""

    def figures(self) -> dict[str, Any]:
        """Return the figures by name, rounded; None if unknown."""
        fields = asdict(self).items()
        return {
            k: None if v != v else v if isinstance(v, int) else float(f"{v:.6g}") for k, v in fields
        }

    def table(self) -> str:
        """Return one readable line per figure."""
        return "\n".join(f"  {name:<16}{value!s:>12}" for name, value in self.figures().items())


def check_limits(report: Report, limits: Mapping[str, float], what: str) -> None:
    """Raise ExportError if a figure of the report is worse than its limit.

    An unknown figure fails its limit, except for `MAY_BE_UNKNOWN`.
    """
    worse = []
    for name, limit in limits.items():
        value = getattr(report, name)
        if value != value and name in MAY_BE_UNKNOWN:
            continue
        if not (value <= limit if name in AT_MOST else value >= limit):
            worse.append(f"{name} {value:.4g} {'>' if name in AT_MOST else '<'} {limit:.4g}")
    if worse:
        raise ExportError(
            f"{what}: differs too much from the original model ({', '.join(worse)}); calibrate on "
            "more images like those that the robot sees, or keep the file anyway with --no-gate"
        )
