"""The start of a service whose model is loaded by a process."""

from __future__ import annotations

import logging
import sys
import threading
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from live_patience import eventually

sys.path.insert(0, str(Path(__file__).parents[1] / "perception"))
from fake_model_process import __file__ as fake

from edge.config import parse
from edge.errors import Stopped
from edge.launch import open_service
from edge.perception.process import link


def fakes() -> list[psutil.Process]:
    """Return the live model processes; one that has just ended may be listed still."""
    found = []
    for child in psutil.Process().children():
        with suppress(psutil.NoSuchProcess):  # so is a zombie to psutil
            found += [child] if fake in child.cmdline() else []
    return found


def test_a_stop_is_obeyed_while_the_model_loads(endpoint, tmp_path, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "edge")
    monkeypatch.setattr(link, "PROGRAM", (sys.executable, fake))
    (tmp_path / "script").write_text("wait")
    vocabulary = str(tmp_path / "script")
    config = parse({
        "zenoh": {"endpoint": endpoint}, "mission": {"target": "chair"},
        "perception": {
            "isolation": "process", "process": {"start_timeout_s": 1e6},
            "detector": {"kind": "onnx", "model": "steered", "vocabulary": vocabulary},
        },
    })  # fmt: skip
    stop = threading.Event()

    def stop_when_it_loads() -> None:
        eventually(fakes)
        stop.set()

    stopper = threading.Thread(target=stop_when_it_loads)
    stopper.start()
    with pytest.raises(Stopped), open_service(config, [], stop=stop):
        raise AssertionError
    stopper.join()
    eventually(lambda: not fakes(), "a process is left")
    assert [r.getMessage() for r in caplog.records if r.name == "edge"] == [
        "stopped during the start, before the service was ready"
    ]
