"""Kernels of a first start, compiled by two processes."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

FIRST_START = """
from simulated import simulated
from edge.loop import warmup
from edge.mapping.update import apply_scan
from edge.perception.tracking.back_projection_kernels import back_project_boxes
# What both would not share takes half a minute more.
warmup.warm_rooms = warmup.warm_policy = warmup.warm_tasks = lambda *_: None
warmup.warm_up(simulated())
print([sum(kernel.stats.cache_misses.values()) for kernel in (apply_scan, back_project_boxes)])
"""


@pytest.mark.slow
def test_a_first_start_has_another_process_compile_for_perception(tmp_path):
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    compiled, program = [], [sys.executable, "-c", FIRST_START]
    for _ in range(2):
        ran = subprocess.run(program, capture_output=True, text=True, check=True, env=env)
        compiled.append(ran.stdout.strip())
    assert compiled == ["[1, 0]", "[0, 0]"]
