"""Scripts of this folder that measure their own process.

Each runs in a fresh process: other tests leave threads and garbage in pytest's own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil

HERE = Path(__file__).parent


def run_fresh(script: str, *arguments: object) -> Any:
    """Return the JSON that `python script arguments` prints."""
    done = subprocess.run(
        [sys.executable, HERE / script, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(HERE.parent)}, stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def resident_mb() -> float:
    return psutil.Process().memory_info().rss / 1e6


def descriptors() -> int:
    """Return the number of open file descriptors of this process."""
    return psutil.Process().num_fds()
