"""The ONNX versions that every file of ours keeps to."""

from __future__ import annotations

from pathlib import Path

import onnx

from exporters.files import ExportError

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
