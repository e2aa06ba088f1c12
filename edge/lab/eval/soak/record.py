"""Record of a run of `edge soak`, as JSON lines (`record.jsonl`)."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]
"""A line of the record."""


class SoakRecord:
    """Writes rows to a file. The file is complete at any time.

    Each row has `t_s` since the begin, and its `kind`: `begin`, `sample` (once a second), `fault`,
    `mission`, `broken`, `recordings`, `growth`, `end`.

    Attributes:
        rows: all rows so far.
        began_s: `time.monotonic` of the begin; the run sets it when it begins.
    """

    def __init__(self, path: Path) -> None:
        self.rows: list[Row] = []
        self.began_s = time.monotonic()
        self._file = path.open("w", encoding="utf-8")

    def add(self, kind: str, **fields: Any) -> None:
        """Add a row."""
        row = {"t_s": round(time.monotonic() - self.began_s, 2), "kind": kind, **fields}
        self.rows.append(row)
        self._file.write(json.dumps(row, ensure_ascii=False) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def rows_of_kind(rows: Sequence[Row], kind: str) -> list[Row]:
    """Return the rows of a kind."""
    return [row for row in rows if row["kind"] == kind]


def verdict(rows: Sequence[Row]) -> str:
    """Return the result in one line: the first broken rule, or that all held."""
    broken, minutes = rows_of_kind(rows, "broken"), rows[-1]["t_s"] / 60.0
    if broken:
        more = f" ({len(broken) - 1} more)" if len(broken) > 1 else ""
        return (
            f"check failed after {broken[0]['t_s']:.0f} s: {broken[0]['rule']}: "
            f"{broken[0]['why']}{more}"
        )
    faults, missions = len(rows_of_kind(rows, "fault")), rows_of_kind(rows, "mission")
    reached = sum(row["phase"] == "reached" for row in missions)
    return (
        f"all checks passed for {minutes:.0f} min: {faults} faults, {len(missions)} missions, "
        f"{reached} of them reached"
    )
