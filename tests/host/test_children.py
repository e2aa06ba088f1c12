from __future__ import annotations

import subprocess
import threading

import pytest
from simulated import simulated

from edge import launch
from edge.errors import UserError
from edge.host import children
from edge.host.children import python_module
from edge.lab.bench import compare
from edge.lab.bench.isolated import run_isolated
from edge.perception.process import link


def test_nothing_is_imported_from_the_working_directory(tmp_path, monkeypatch):
    """Not even the files next to a package that is not installed."""
    ours, here = tmp_path / "ours", tmp_path / "here"
    for folder in (ours, here):
        (folder / "program").mkdir(parents=True)
        main = f"import json, sys\nprint({folder.name!r}, __name__, *sys.argv[1:])"
        (folder / "program" / "__main__.py").write_text(main)
    for name in ("json", "runpy"):
        (here / f"{name}.py").write_text("raise SystemExit('from the working directory')")
    monkeypatch.setattr(children, "_ROOT", str(ours))
    command = [*python_module("program"), "one", "--two"]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("ours __main__ one --two\n", "")


def test_a_child_skips_garbage_collection_at_its_end(tmp_path, monkeypatch):
    (tmp_path / "program.py").write_text("""
class Told:
    def __del__(self):
        print("found")

told = Told()
told.own = told
del told
""")
    monkeypatch.setattr(children, "_ROOT", str(tmp_path))
    done = subprocess.run(python_module("program"), capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_every_child_process_is_started_as_a_module(monkeypatch):
    started = []

    def start(command, **_):
        started.append(command)
        raise OSError(2, "No such file")

    monkeypatch.setattr(launch.subprocess, "Popen", start)
    settings = simulated({"mission": {"target": "chair"}})
    with (
        pytest.raises(UserError, match="cannot start `edge sim --motion-only`: No such file"),
        launch.child_processes(settings, threading.Event(), ("sim", "--motion-only")),
    ):
        raise AssertionError
    with pytest.raises(OSError, match="No such file"):
        run_isolated(compare.MEASURE, None, 1.0)
    assert tuple(started[0][:5]) == python_module("edge.cli")
    assert tuple(started[1][:5]) == python_module(compare.MEASURE)
    assert python_module("edge.perception.serve_detector") == link.PROGRAM
