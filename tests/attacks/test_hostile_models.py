"""Model files that are false or never end: they are refused, and the next model is taken."""

from __future__ import annotations

import os
import signal
import subprocess
import time

import numpy as np
import pytest
from patience import PATIENCE_S, eventually

from edge.cli.main import main
from edge.config import parse
from edge.geometry import CameraModel
from edge.host.children import python_module
from edge.host.processes import descendants
from edge.perception.factory import make_detector
from edge.perception.swap.base import FINAL_STATES
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker
from edge.types import Observation

pytest.importorskip("onnxruntime")
hostile_models = pytest.importorskip("hostile_models")

ENDLESS = {
    "always": {"over": -1.0},
    "for camera images": {"over": 0.6},  # the trial images are darker
}
LYING = {
    "scores of 1e30": {"score": "1e30"},
    "scores of NaN": {"score": "nan"},
    "negative scores": {"score": "-5.0"},
    "boxes without end": {"corner": "inf"},
    "boxes far outside": {"corner": "1e30"},
}


@pytest.fixture
def put(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    return hostile_models.put_detector


def children() -> int:
    return len(descendants(os.getpid()))


@pytest.mark.parametrize("how", [ENDLESS["always"], *LYING.values()], ids=str)
def test_models_check_refuses_a_hostile_model_in_one_line(put, capsys, how):
    put("hostile", **how)
    before = children()  # another test of this process may have left one that compiles
    assert main(["models", "list", "--check", "hostile", "--timeout", "5"]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert children() <= before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_models_check_of_an_endless_model_ends_at_a_signal(put, number):
    put("hostile", **ENDLESS["always"])
    command = [
        *python_module("edge.cli"),
        "models",
        "list",
        "--check",
        "hostile",
        "--timeout",
        "1e6",
    ]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as checking:
        try:
            (child,) = eventually(lambda: descendants(checking.pid))
            time.sleep(1.0)  # into the model, on most computers
            checking.send_signal(number)
            assert checking.wait(PATIENCE_S) == 128 + number
            eventually(lambda: not child.is_running())
            assert checking.stderr.read() == ""
        finally:
            checking.kill()


@pytest.mark.slow
@pytest.mark.parametrize("how", [*ENDLESS, "scores of 1e30"])
def test_a_hostile_model_is_not_swapped_in(put, tmp_path, how):
    for name, settings in {"first": {}, "hostile": {**ENDLESS, **LYING}[how], "good": {}}.items():
        put(name, **settings)
    words = hostile_models.put_words(tmp_path / "words.npz")
    perception = parse({
        "perception": {
            "detector": {
                "kind": "onnx", "model": "first", "vocabulary": str(words), "threads": 1,
            },
            "isolation": "thread",
            "process": {"timeout_s": PATIENCE_S, "start_timeout_s": PATIENCE_S},
            "swap": {"probation": 3, "budget_ms": 1e6},
        },
    }).perception  # fmt: skip
    worker, told = DetectorWorker(make_detector(perception, ["chair"])), []
    swapper = DetectorSwap(perception, worker, lambda text, *_: told.append(text))
    rgb, seq = np.full((64, 64, 3), 200, np.uint8), 0
    camera = CameraModel.from_hfov(64, 64, 1.3)

    def over() -> bool:
        """Return True if a swap has ended, after one more image."""
        nonlocal seq
        seq += 1
        worker.submit(Observation(seq, seq * 200_000_000, np.eye(4), rgb=rgb, camera=camera))
        swapper.step(seq)
        if (found := worker.poll()) is not None:
            assert found.model == "first" or found.score.max() <= 1.0
        return swapper.state in FINAL_STATES

    try:
        soon = perception.process.model_copy(update={"timeout_s": 2.0, "start_timeout_s": 10.0})
        rules = perception.model_copy(update={"process": soon})
        for model, state, way in (("hostile", "refused", rules), ("good", "kept", perception)):
            swapper.request(model, True, seq, way)
            eventually(over, lambda: f"never over: {swapper.status()}")
            assert swapper.state == state, told
            eventually(lambda: not any(ended.trying for ended in swapper._ended))
    finally:
        swapper.close()
        worker.close()
