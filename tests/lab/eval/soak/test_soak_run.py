"""`edge soak` as a whole: real processes, real faults, and reports of failures."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from edge_processes import write_config
from live_patience import eventually

from edge.cli.parsers import make_parser
from edge.errors import FAILED, FileError, Stopped
from edge.lab.eval.soak import run as soak_run
from edge.lab.eval.soak.run import make_out_folder

pytestmark = pytest.mark.timeout(900)

TWO = "controller-killed,reload"


def rows(folder: Path) -> list[dict]:
    text = (folder / "record.jsonl").read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


def of(kind: str, record: list[dict]) -> list[dict]:
    return [row for row in record if row["kind"] == kind]


def small(folder: Path, **sections: dict) -> Path:
    """Return a robot that is cheap to simulate."""
    camera = {"width_px": 64, "height_px": 48, "rate_hz": 5}
    return write_config(folder, sensors={"camera": camera, "odometry_hz": 20}, **sections)


def test_only_an_empty_output_folder_is_used(tmp_path):
    make_out_folder(tmp_path / "a/b")
    make_out_folder(tmp_path / "a/b")
    with pytest.raises(FileError, match=r"--out .*a: the folder is not empty"):
        make_out_folder(tmp_path / "a")
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r"--out .*file: cannot be used: File exists"):
        make_out_folder(tmp_path / "file")


@pytest.mark.parametrize("stopped_in", ["start", "run"])
def test_a_run_that_had_begun_is_judged_when_it_is_stopped(tmp_path, monkeypatch, stopped_in):
    """The end of a fault may wait for a connection when the stop comes."""
    calls = []

    def call(name: str) -> None:
        calls.append(name)
        if name == stopped_in:
            raise Stopped(name)

    def made(*args):
        return SimpleNamespace(**{
            name: lambda *_, name=name: call(name) for name in ("start", "run", "conclude", "close")
        })  # fmt: skip

    monkeypatch.setattr(soak_run, "SoakHarness", made)
    monkeypatch.setattr(soak_run, "SoakRun", made)
    monkeypatch.setattr(soak_run, "stop_on_signals", threading.Event)
    monkeypatch.setattr(soak_run, "summary", str)
    monkeypatch.setattr(soak_run, "verdict", str)
    words = ["soak", str(small(tmp_path)), "--out", str(tmp_path / "out")]
    assert soak_run.run(make_parser().parse_args(words)) == 0
    assert ("conclude" in calls) == (stopped_in == "run")
    assert calls[-1] == "close"


@pytest.mark.slow
def test_seconds_with_two_faults(edge, tmp_path):
    out = tmp_path / "out"
    soak = edge("soak", small(tmp_path), "--minutes", "0.3", "--faults", TWO, "--out", out)
    assert soak.wait() == 0, soak.output
    assert soak.lines[-1].startswith("all checks passed for ")
    record = rows(out)
    faults, samples = of("fault", record), of("sample", record)
    assert {fault["name"] for fault in faults} <= set(TWO.split(","))
    assert faults
    assert len(samples) > 10
    assert {sample["healthz"] for sample in samples} == {200}
    assert max(sample["ticks"] for sample in samples) > 0
    assert samples[-1]["service"]["memory_mb"] > 20
    assert any(line.startswith(faults[0]["name"]) for line in soak.lines)


@pytest.mark.slow
def test_minutes_of_all_faults(edge, tmp_path):
    out = tmp_path / "out"
    soak = edge("soak", "--minutes", "2", "--out", out)
    assert soak.wait(900) == 0, soak.output
    assert len({fault["name"] for fault in of("fault", rows(out))}) > 6


@pytest.mark.slow
def test_a_service_that_is_killed_is_reported(edge, tmp_path):
    out = tmp_path / "out"
    soak = edge("soak", small(tmp_path), "--minutes", "5", "--faults", TWO, "--out", out)
    soak.until(lambda: (out / "record.jsonl").exists() and of("sample", rows(out)))
    (service,) = [c for c in soak.children() if " run " in " ".join(c.cmdline())]
    service.kill()
    assert soak.wait() == FAILED
    assert "service lives: the process of the service ended with exit code -9" in soak.lines[-1]


@pytest.mark.slow
def test_a_soak_that_is_killed_leaves_nothing_behind(edge, tmp_path):
    out = tmp_path / "out"
    soak = edge("soak", small(tmp_path), "--minutes", "5", "--faults", TWO, "--out", out)
    soak.until(lambda: (out / "record.jsonl").exists() and of("sample", rows(out)))
    assert len(soak.children()) >= 3
    soak.process.kill()
    soak.wait()
    eventually(lambda: not soak.orphans(), "its processes go on")
