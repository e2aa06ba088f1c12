"""A test of onnxruntime in a separate process.

Its binaries may crash on a computer for which they were not built: at import, or in the first
session.
On arm64 this happened with cores switched off, as in power modes of a Jetson
(microsoft/onnxruntime#24221, #25103), on older cores (#24112), and under emulation. The separate
process keeps the caller alive.
"""

from __future__ import annotations

import functools
from importlib.util import find_spec

from edge.perception.runtime.card_types import DetectCard
from edge.perception.runtime.cards import load_card_of
from edge.perception.runtime.model_file import ModelError

MODEL = "mini-house-256x320-int8-cpu"
"""Model of the test: the smallest detector, which is part of the package."""
CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"
"""Providers to test. Not TensorRT, which needs minutes to build an engine."""
LIMIT_S = 120.0
"""Time for the test of one provider."""


@functools.cache
def fault_of(provider: str) -> str:
    """Run the model on a provider, once per process; return the reason of a failure, else "".

    An available provider was compiled in; only a run shows if it has code for this GPU.
    """
    from edge.models.check import check_in_subprocess

    card = load_card_of(DetectCard, MODEL)
    try:
        check_in_subprocess(card, None, LIMIT_S, (provider,), "its time limit")
    except ModelError as error:
        return str(error)
    return ""


def crashes() -> bool:
    """Return True if onnxruntime is installed but fails; then this process must not import it."""
    return find_spec("onnxruntime") is not None and fault_of(CPU) != ""
