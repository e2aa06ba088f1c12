"""onnxruntime is tried in its own process, whose end is reported in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge.cli import onnx_probe
from edge.cli.onnx_probe import CPU, ProbeResult, probe

CUDA = "CUDAExecutionProvider"
DIES = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
MODULE = """
__version__ = "1.0"

def get_available_providers():
    return [{available}]

class InferenceSession:
    def __init__(self, path, providers, enable_fallback):
        self.providers = providers
        {on_open}

    def get_providers(self):
        return [*self.providers, "CPUExecutionProvider"]

    def get_inputs(self):
        return []

    def run(self, outputs, feeds):
        if self.providers == ["CUDAExecutionProvider"]:
            {on_cuda}
"""


def module(*available: str, on_open: str = "pass", on_cuda: str = "pass") -> str:
    named = ", ".join(map(repr, available))
    return MODULE.format(available=named, on_open=on_open, on_cuda=on_cuda)


def probe_of(source: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> ProbeResult | None:
    """Return the probe's answer with a stand-in module of this source."""
    (folder / "onnxruntime.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setattr(onnx_probe.util, "find_spec", lambda name: object())
    return probe.__wrapped__()


def test_the_real_one_runs_a_model():
    onnxruntime = pytest.importorskip("onnxruntime")
    probed = probe()
    assert (probed.version, probed.fault) == (onnxruntime.__version__, "")
    assert probed.providers == tuple(onnxruntime.get_available_providers())
    assert CPU in probed.ran


def test_a_missing_onnxruntime_gives_no_result(monkeypatch):
    monkeypatch.setattr(onnx_probe.util, "find_spec", lambda name: None)
    assert probe.__wrapped__() is None


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (DIES, ProbeResult("", (), (), "crashes (SIGSEGV) when it is imported")),
        (
            module(CPU, on_open=DIES),
            ProbeResult("1.0", (CPU,), (), f"crashes (SIGSEGV) when it runs a model on {CPU}"),
        ),
        (
            "raise ImportError('libgomp.so.1: no such file')",
            ProbeResult(
                "", (), (), "fails when it is imported: ImportError: libgomp.so.1: no such file"
            ),
        ),
        (
            module(CUDA, CPU, on_cuda="raise RuntimeError('no kernel image')"),
            ProbeResult(
                "1.0",
                (CUDA, CPU),
                (CPU,),
                f"fails when it runs a model on {CUDA}: RuntimeError: no kernel image",
            ),
        ),
        (module(CUDA, CPU), ProbeResult("1.0", (CUDA, CPU), (CPU, CUDA))),
    ],
    ids=["dies-at-import", "dies-at-a-session", "no-import", "no-code-for-the-gpu", "both-run"],
)
def test_the_probe_reports_how_onnxruntime_fails_or_runs(source, expected, tmp_path, monkeypatch):
    assert probe_of(source, tmp_path, monkeypatch) == expected


def test_a_hanging_onnxruntime_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(onnx_probe, "LIMIT_S", 0.5)
    probed = probe_of("import time; time.sleep(3600)", tmp_path, monkeypatch)
    assert probed == ProbeResult("", (), (), "fails when it is imported: no answer within 0.5 s")
