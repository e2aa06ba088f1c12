"""Whether onnxruntime works here, tried in a process of its own.

Its binaries may crash where they were not made for: when they are imported, or at their first
session. On arm64 that has happened with cores switched off, as a Jetson's power modes do
(microsoft/onnxruntime#24221, #25103), on older cores (#24112), and under emulation. Whoever only
asks whether it works must outlive the answer.
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
"""What is run: the smallest detector, which comes with the package."""
CPU = "CPUExecutionProvider"
TRIED = (CPU, "CUDAExecutionProvider")
"""Not TensorRT's, which builds an engine for minutes. That a provider is available only says that
it was compiled in; whether it has code for this GPU shows when a model runs."""
LIMIT_S = 120.0


@dataclass(frozen=True, slots=True)
class Probed:
    """What became of it.

    `providers` are those compiled in, `ran` those of `TRIED` that ran the model; `fault` goes on
    after the package's name, and is empty where nothing was wrong.
    """

    version: str
    providers: tuple[str, ...]
    ran: tuple[str, ...]
    fault: str = ""


@functools.cache
def probe() -> Probed | None:
    """Try it, once for each process of ours; None where it is not installed."""
    if util.find_spec("onnxruntime") is None:
        return None
    try:
        done = subprocess.run(
            python_module(__name__), capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
        said, code, last = done.stdout, done.returncode, done.stderr.strip().rpartition("\n")[2]
    except subprocess.TimeoutExpired as error:
        said, code, last = (error.stdout or b"").decode(), 1, f"no answer within {LIMIT_S:g} s"
    return _told([json.loads(line) for line in said.splitlines()], code, last)


def _told(said: list[dict[str, Any]], code: int, last: str) -> Probed:
    """From what the process said until it ended, its exit code and the end of its last words."""
    imported = said[0] if said else {"version": "", "providers": ()}
    ran = tuple(step["ran"] for step in said[1:])
    missing = [p for p in TRIED if p in imported["providers"] and p not in ran]
    when = "when it is imported" if not said else "when it ends"
    when = f"when it runs a model on {missing[0]}" if missing else when
    fault = ""
    if code < 0:
        fault = f"crashes ({signal.Signals(-code).name}) {when}"
    elif code:
        fault = f"fails {when}: {one_line(last)}"
    return Probed(imported["version"], tuple(imported["providers"]), ran, fault)


def _steps() -> Iterator[dict[str, Any]]:
    """What the process of its own does and says."""
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
            raise RuntimeError("it did not start; check the driver")
        feeds = {
            given.name: np.zeros(
                [n if isinstance(n, int) else 1 for n in given.shape],
                np.uint8 if given.type == "tensor(uint8)" else np.float32,
            )
            for given in session.get_inputs()
        }
        session.run(None, feeds)
        yield {"ran": provider}


if __name__ == "__main__":
    for step in _steps():
        print(json.dumps(step), flush=True)
