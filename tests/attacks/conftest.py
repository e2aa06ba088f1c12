"""Attacks on real processes, which are those of `tests/integration`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "integration"))

from edge_processes import edge, endpoint  # noqa: F401, fixtures
