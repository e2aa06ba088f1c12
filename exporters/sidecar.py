"""Sidecar `FILE.onnx.json` of an exported model: its digest, parity, and the tools that made it."""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path

from edge.host.files import write_atomically
from exporters.files import sha256_of

# Packages whose versions the sidecar has.
TOOLS = (
    "torch", "ultralytics", "transformers", "onnx", "onnxruntime", "onnxslim", "numpy",
)  # fmt: skip


def write_sidecar(
    out: Path,
    name: str,
    parity: dict | None,
    weights_sha256: str | None,
    calibration_sha256: str | None = None,
) -> None:
    """Write the sidecar of the model `out`, with the digest that the service checks.

    The digest is not in the card, because the file depends on the calibration images and on the
    tools' versions. Parity and digests are None if they are unknown.
    """
    content = {
        "name": name,
        "sha256": sha256_of(out),
        "bytes": out.stat().st_size,
        "parity": parity,
        "weights_sha256": weights_sha256,
        "calibration_sha256": calibration_sha256,
        "tools": {tool: _version(tool) for tool in TOOLS},
    }
    sidecar = json.dumps(content, indent=2) + "\n"
    write_atomically(out.with_name(out.name + ".json"), sidecar.encode())
    print(f"{out.name} sha256 {content['sha256']}")


def _version(tool: str) -> str | None:
    """Return a tool's version; None if it is not installed (torch is only needed for FP32)."""
    try:
        return importlib.metadata.version(tool)
    except importlib.metadata.PackageNotFoundError:
        return None
