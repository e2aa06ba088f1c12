"""Scripts of this folder that measure their own process, in one of their own: other tests leave
threads and garbage in that of pytest."""

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
    """What `python script arguments` prints, which is JSON."""
    done = subprocess.run(
        [sys.executable, HERE / script, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(HERE.parent)}, stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def resident_mb() -> float:
    """Of this process."""
    return psutil.Process().memory_info().rss / 1e6


def descriptors() -> int:
    """How many this process has open."""
    return psutil.Process().num_fds()
