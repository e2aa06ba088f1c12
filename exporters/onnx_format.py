"""ONNX files of all exports: their format version, export from PyTorch, sessions on the CPU."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import onnxruntime

from edge.host.files import replace_atomically
from edge.perception.runtime import onnx_file
from edge.perception.runtime.model_file import ModelError
from edge.text import one_line
from exporters.files import ExportError

if TYPE_CHECKING:
    from torch import nn

OPSET = 19
"""Opset of the exports: the newest that the TorchScript exporter writes without warnings."""


def check_format(path: Path) -> None:
    """Raise ExportError unless every runtime of the service can load the ONNX file."""
    try:
        onnx_file.check_format(path, onnx_file.read_onnx(path))
    except (ModelError, onnx_file.NotOnnxError) as error:
        raise ExportError(str(error)) from None


def cpu_session(model: Path | bytes, threads: int = 0) -> onnxruntime.InferenceSession:
    """Return a session on the CPU, for a file or its content; raise ExportError if it cannot load.

    With 0 threads, it has one per core.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = threads, 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        content = model if isinstance(model, bytes) else str(model)
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises many types
        what = "the model" if isinstance(model, bytes) else model
        raise ExportError(f"{what}: onnxruntime cannot load the model: {one_line(error)}") from None


def export_module(
    module: nn.Module, out: Path, inputs: dict[str, Any], outputs: tuple[str, ...],
    free: dict[str, dict[int, str]],
) -> None:  # fmt: skip
    """Write a PyTorch module as ONNX.

    The inputs are example tensors by name. `free` are the axes of any length: input or output →
    axis → name of the axis.
    """
    with replace_atomically(out) as temporary:
        trace_module(module, temporary, inputs, outputs, free)
        check_format(temporary)


def trace_module(
    module: nn.Module, out: Path, inputs: dict[str, Any], outputs: tuple[str, ...],
    free: dict[str, dict[int, str]],
) -> None:  # fmt: skip
    """Write a PyTorch module as ONNX, with external weight files if one file cannot hold them.

    The arguments are those of `export_module`; the format is not checked.
    """
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of dynamo=False, see below
        warnings.simplefilter("ignore", torch.jit.TracerWarning)  # sizes are constants on purpose
        torch.onnx.export(
            module, tuple(inputs.values()), str(out),
            dynamo=False,  # the only exporter that keeps the module path in node names
            opset_version=OPSET, input_names=list(inputs), output_names=list(outputs),
            dynamic_axes=free,
        )  # fmt: skip
