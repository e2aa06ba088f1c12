"""Sessions of onnxruntime: on exactly the providers named, or an error that says why not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edge.perception.cards import ModelError


def open_session(path: Path, providers: Sequence[str], threads: int) -> Any:
    """An onnxruntime session that runs on exactly the providers named.

    Raises:
        ModelError: onnxruntime or a provider is not there, or the file is no model.
    """
    try:
        import onnxruntime as ort
    except ImportError:
        raise ModelError(
            "onnxruntime is not installed: pip install edge-vln[cpu] (or [gpu])"
        ) from None
    available = ort.get_available_providers()
    for provider in providers:
        if provider not in available:
            raise ModelError(
                f"perception.detector.providers: {provider!r} is not available here "
                f"(available: {', '.join(available)})"
            )
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        session = ort.InferenceSession(str(path), options, providers=list(providers))
    except Exception as error:  # onnxruntime raises many types of its own
        reason = str(error).splitlines()[0][:200]
        raise ModelError(f"{path}: onnxruntime cannot load it: {reason}") from None
    # A provider that fails to start is only logged by onnxruntime, which then uses the CPU.
    if missing := [p for p in providers if p not in session.get_providers()]:
        raise ModelError(
            f"{path}: {', '.join(missing)} did not start; onnxruntime would run on "
            f"{', '.join(session.get_providers())} instead: check the driver, or change "
            "perception.detector.providers"
        )
    return session
