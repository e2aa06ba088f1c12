"""ONNX files: the versions that all of ours keep to, made from PyTorch, run on the CPU."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import onnx
import onnxruntime

from edge.text import one_line
from exporters.files import ExportError, replace_atomically

if TYPE_CHECKING:
    from torch import nn

OPSET = 19
"""Opset of the exports: the newest the TorchScript exporter writes without warnings."""
MAX_OPSET = 20
MAX_IR = 10
"""Python 3.10's last onnxruntime, 1.23.2, refuses newer IR."""


def check_format(path: Path) -> None:
    """Raise ExportError if the file's IR or opset is newer than every target can load."""
    model = onnx.load(path, load_external_data=False)
    if model.ir_version > MAX_IR:
        raise ExportError(
            f"{path}: ONNX IR {model.ir_version}, at most {MAX_IR} loads on every target; "
            "set ir_version before saving"
        )
    for entry in model.opset_import:
        if entry.domain in ("", "ai.onnx") and entry.version > MAX_OPSET:
            raise ExportError(
                f"{path}: ONNX opset {entry.version}, at most {MAX_OPSET} loads on every target; "
                "export with a lower opset_version"
            )


def cpu_session(model: Path | bytes, threads: int = 0) -> onnxruntime.InferenceSession:
    """A session on the CPU, of a file or of its content; raises ExportError if it is no model.

    Args:
        threads: 0: one a core.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = threads, 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        content = model if isinstance(model, bytes) else str(model)
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises many types of its own
        what = "the model" if isinstance(model, bytes) else model
        raise ExportError(f"{what}: cannot be loaded: {one_line(error)}") from None


def export_module(
    module: nn.Module, out: Path, inputs: dict[str, Any], outputs: tuple[str, ...],
    free: dict[str, dict[int, str]],
) -> None:  # fmt: skip
    """Write a PyTorch module as ONNX.

    Args:
        inputs: tensors to trace it with, by name.
        free: names of the axes that any size may have, by input or output and axis.
    """
    import torch

    with replace_atomically(out) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # dynamo=False is deprecated, see below
        warnings.simplefilter("ignore", torch.jit.TracerWarning)  # sizes are constants on purpose
        torch.onnx.export(
            module, tuple(inputs.values()), str(temporary),
            dynamo=False,  # the only exporter that keeps the module path in node names
            opset_version=OPSET, input_names=list(inputs), output_names=list(outputs),
            dynamic_axes=free,
        )  # fmt: skip
        check_format(temporary)
