"""onnxruntime is tried in its own process, whose end is reported in one line."""

from __future__ import annotations

import pytest

from edge.cli import onnx_probe
from edge.cli.onnx_probe import CPU, CUDA, fault_of


def test_the_real_one_runs_a_model():
    pytest.importorskip("onnxruntime")
    assert fault_of(CPU) == ""


@pytest.mark.parametrize(
    ("source", "limit_s", "provider", "fault"),
    [
        ("import os; os.kill(os.getpid(), 11)", 120, CPU, "its process: ended by SIGSEGV"),
        ("raise ImportError('libgomp.so.1: no such file')", 120, CPU,
         "onnxruntime cannot be imported: libgomp.so.1: no such file"),
        ("def get_available_providers(): return ['CPUExecutionProvider']", 120, CUDA,
         "'CUDAExecutionProvider' is not available here"),
        ("import time; time.sleep(3600)", 0.5, CPU, "was not ready after 0.5 s (its time limit)"),
    ],
    ids=["dies", "no-import", "no-gpu", "hangs"],
)  # fmt: skip
def test_the_probe_reports_how_onnxruntime_fails(
    source, limit_s, provider, fault, tmp_path, monkeypatch
):
    (tmp_path / "onnxruntime.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(onnx_probe, "LIMIT_S", limit_s)
    assert fault in fault_of.__wrapped__(provider)
