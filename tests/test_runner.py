"""What the loop relies on from start-up."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

COMPILED_IN_THE_LOOP = """
import json, sys
from numba.core.registry import CPUDispatcher
from closed_loop import ClosedLoop
from edge.config import parse
from edge.warmup import warm_up

SERVICE = ("edge.mapping", "edge.perception", "edge.policies", "edge.wire", "edge.geometry")

def signatures():
    return {
        f"{d.py_func.__module__}.{d.py_func.__name__}": len(d.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("edge.")
        for d in vars(module).values()
        if isinstance(d, CPUDispatcher) and d.py_func.__module__.startswith(SERVICE)
    }

config = parse({"mission": {"target": "television"}, "loop": {"lockstep": True},
                "sim": {"lockstep": True}})
warm_up(config)
before = signatures()
loop = ClosedLoop(config).run(60)
after = signatures()
late = [name for name, n in after.items() if n > before.get(name, 0)]
print(json.dumps([loop.service.status.phase, sum(after.values()), late]))
"""


def test_nothing_is_compiled_once_the_loop_runs():
    """In a process of its own: here, other tests have compiled everything already."""
    tests = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", COMPILED_IN_THE_LOOP],
        capture_output=True,
        text=True,
        cwd=tests,
        check=True,
    )
    phase, kernels, late = json.loads(done.stdout.splitlines()[-1])
    assert phase == "reached"
    assert kernels > 20
    assert late == []
