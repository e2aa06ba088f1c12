"""Model files that are false or never end: they are refused, and the next model is taken."""

from __future__ import annotations

import os
import signal
import subprocess
import time

import pytest
from patience import PATIENCE_S, eventually

from edge.cli.main import main
from edge.host.children import python_module
from edge.host.processes import descendants

pytest.importorskip("onnxruntime")
hostile_models = pytest.importorskip("hostile_models")

ENDLESS = {"over": -1.0}
LYING = [
    {"score": "1e30"}, {"score": "nan"}, {"score": "-5.0"}, {"corner": "inf"}, {"corner": "1e30"},
]  # fmt: skip


@pytest.fixture
def put(tmp_path, monkeypatch):
    monkeypatch.setenv("EDGE_CACHE_DIR", str(tmp_path / "cache"))
    return hostile_models.put_detector


def children() -> int:
    return len(descendants(os.getpid()))


@pytest.mark.parametrize("how", [ENDLESS, *LYING], ids=str)
def test_models_check_refuses_a_hostile_model_in_one_line(put, capsys, how):
    put("hostile", **how)
    before = children()  # another test of this process may have left one that compiles
    assert main(["models", "list", "--check", "hostile", "--timeout", "5"]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert children() <= before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_models_check_of_an_endless_model_ends_at_a_signal(put, number):
    put("hostile", **ENDLESS)
    check = ["models", "list", "--check", "hostile", "--timeout", "1e6"]
    with subprocess.Popen(
        [*python_module("edge.cli"), *check], stderr=subprocess.PIPE, text=True
    ) as checking:
        try:
            (child,) = eventually(lambda: descendants(checking.pid))
            time.sleep(1.0)  # into the model, on most computers
            checking.send_signal(number)
            assert checking.wait(PATIENCE_S) == 128 + number
            eventually(lambda: not child.is_running())
            assert checking.stderr.read() == ""
        finally:
            checking.kill()
