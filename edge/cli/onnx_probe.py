"""A test of onnxruntime in a separate process.

Its binaries may crash on a computer for which they were not built: at import, or in the first
session.
On arm64 this happened with cores switched off, as in power modes of a Jetson
(microsoft/onnxruntime#24221, #25103), on older cores (#24112), and under emulation. The separate
process keeps the caller alive.
"""

from __future__ import annotations

import functools
import json
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import util
from typing import Any

from edge.host import resources
from edge.host.children import python_module
from edge.text import one_line

MODEL = "mini-house-256x320-int8-cpu.onnx"
"""Model of the test: the smallest detector, which is part of the package."""
CPU = "CPUExecutionProvider"
TRIED = (CPU, "CUDAExecutionProvider")
"""Providers to test. Not TensorRT, which needs minutes to build an engine.

An available provider was compiled in; only a run shows if it has code for this GPU.
"""
LIMIT_S = 120.0
"""Time for the entire test."""


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """Result of the test.

    Attributes:
        version: version of onnxruntime; "" if the import failed.
        ran: providers of `TRIED` that ran the model.
        fault: verb phrase for a message, such as `crashes (SIGILL) when it is imported`; "" if all
            went well.
    """

    version: str
    providers: tuple[str, ...]
    ran: tuple[str, ...]
    fault: str = ""


@functools.cache
def probe() -> ProbeResult | None:
    """Return the result of the test, which runs once per process.

    Returns:
        None if onnxruntime is not installed.
    """
    if util.find_spec("onnxruntime") is None:
        return None
    try:
        done = subprocess.run(
            python_module(__name__), capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
        output, code = done.stdout, done.returncode
        last_line = done.stderr.strip().rpartition("\n")[2]
    except subprocess.TimeoutExpired as error:
        output, code = (error.stdout or b"").decode(), 1
        last_line = f"no answer within {LIMIT_S:g} s"
    return _make_result([json.loads(line) for line in output.splitlines()], code, last_line)


def _make_result(steps: list[dict[str, Any]], code: int, last_line: str) -> ProbeResult:
    """Return the result from the process's output, exit code and last line on stderr.

    The steps are as `_run_test` yields them: first the import, then each provider that ran the
    model. The exit code -N means that signal N ended it.
    """
    imported = steps[0] if steps else {"version": "", "providers": ()}
    ran = tuple(step["ran"] for step in steps[1:])
    missing = [p for p in TRIED if p in imported["providers"] and p not in ran]
    # The step at which the process failed, if it failed.
    when = "when it is imported" if not steps else "when it ends"
    when = f"when it runs a model on {missing[0]}" if missing else when
    fault = ""
    if code < 0:
        fault = f"crashes ({signal.Signals(-code).name}) {when}"
    elif code:
        fault = f"fails {when}: {one_line(last_line)}"
    return ProbeResult(imported["version"], tuple(imported["providers"]), ran, fault)


def _run_test() -> Iterator[dict[str, Any]]:
    """Import onnxruntime and run the model on each provider; yield the result of each step."""
    import numpy as np
    import onnxruntime as ort

    available = ort.get_available_providers()
    yield {"version": ort.__version__, "providers": available}
    path = str(resources.data_dir("models") / MODEL)
    for provider in TRIED:
        if provider not in available:
            continue
        session = ort.InferenceSession(path, providers=[provider], enable_fallback=0)
        if provider not in session.get_providers():
            raise RuntimeError(f"{provider} is installed but did not start; check the GPU driver")
        feeds = {
            model_input.name: np.zeros(
                [n if isinstance(n, int) else 1 for n in model_input.shape],
                np.uint8 if model_input.type == "tensor(uint8)" else np.float32,
            )
            for model_input in session.get_inputs()
        }
        session.run(None, feeds)
        yield {"ran": provider}


if __name__ == "__main__":
    for step in _run_test():
        print(json.dumps(step), flush=True)
