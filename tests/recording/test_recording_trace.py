"""Traces, held to the trace event format: complete events that nest, threads with names."""

from __future__ import annotations

import argparse
import json
import urllib.request

import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings import Recording

from edge.config import ConfigError
from edge.errors import UnavailableError
from edge.host.ports import free_port
from edge.host.web_server import serve
from edge.loop.latency import LatencyRing, Span
from edge.loop.stages import MAP, STAGES
from edge.recording import commands
from edge.recording.channels import STATUS
from edge.recording.file import McapWriter, RecordingError
from edge.recording.trace import TracePage, trace_of


def checked(trace: dict) -> list[dict]:
    """Return the complete events after checking the trace format."""
    trace = json.loads(json.dumps(trace, allow_nan=False))
    events = trace["traceEvents"]
    named = {e["tid"]: e["args"]["name"] for e in events if e["name"] == "thread_name"}
    complete = [e for e in events if e["ph"] == "X"]
    assert {e["ph"] for e in events} <= {"X", "M"}
    for e in complete:
        assert e["ts"] >= 0
        assert e["dur"] >= 0
        assert isinstance(e["pid"], int)
        assert e["tid"] in named
    for thread in named:
        ends: list[float] = []
        for e in (e for e in complete if e["tid"] == thread):  # slices of a thread nest
            while ends and ends[-1] <= e["ts"] + 1e-6:
                ends.pop()
            assert not ends or e["ts"] + e["dur"] <= ends[-1] + 1e-6
            ends.append(e["ts"] + e["dur"])
    return complete


def ticks(spans: int, beside: list[tuple[int, int]] = ()) -> list[Span]:
    """Ticks of every stage for 1 us each, and background spans of (begin, took) ns."""
    found = []
    for k in range(spans):
        begin_ns = 10**12 + k * 10**6
        inside = [s.name for s in STAGES if s.in_tick]
        found.append(Span("tick", begin_ns, 1000 * len(inside), True))
        found += [Span(name, begin_ns + 1000 * i, 1000, True) for i, name in enumerate(inside)]
    return found + [Span("detect", begin, took, False) for begin, took in beside]


@given(st.lists(st.tuples(st.integers(0, 10**9), st.integers(0, 10**8)), max_size=20))
def test_background_spans_never_overlap(beside):
    events = [e for e in checked(trace_of(ticks(1, beside))) if e["cat"] == "background"]
    assert len(events) == len(beside)
    assert len({e["tid"] for e in events}) <= 1


def test_a_recording_has_every_tick(tmp_path, capsys):
    path = Recording(tmp_path).steps(12).close()
    out = tmp_path / "trace.json"
    assert commands.trace(argparse.Namespace(file=str(path), out=out)) == 0
    assert "ui.perfetto.dev" in capsys.readouterr().out
    names = [e["name"] for e in checked(json.loads(out.read_text()))]
    # Told once a second: the last ones may not have been.
    assert 5 <= names.count("tick") <= 12
    assert names.count("tick") == names.count("map") == names.count("select")
    assert names.count("detect") >= 5


def test_a_recording_without_ticks(tmp_path):
    recording = Recording(tmp_path)
    recording.service.idle(1, None)
    with pytest.raises(RecordingError, match="has no cycle of a service"):
        commands.spans_of(recording.close())
    with McapWriter(tmp_path / "bus.mcap") as file:
        file.add(STATUS, 0, 0, b"{}")
    with pytest.raises(RecordingError, match="no journal"):
        commands.spans_of(tmp_path / "bus.mcap")


def config(tmp_path, port: int, token: bool = False):
    path = tmp_path / "robot.yaml"
    secret = tmp_path / "token"
    secret.write_text("x" * 32)
    http = {"port": port, **({"token_file": str(secret)} if token else {})}
    path.write_text(json.dumps({"perception": {"detector": {"kind": "sim"}}, "http": http}))
    return str(path)


@pytest.mark.parametrize("token", [False, True])
def test_a_running_service_is_asked(tmp_path, token):
    from edge.host.credentials import read_token

    page, port = TracePage(), free_port()
    source = config(tmp_path, port, token)
    asked = read_token("t", str(tmp_path / "token")) if token else None
    args = argparse.Namespace(file=source, out=tmp_path / "trace.json")
    with serve(page.pages(), "127.0.0.1", port, asked):
        with pytest.raises(UnavailableError, match="503"):
            commands.trace(args)
        ring = LatencyRing()
        ring.begin_tick(5)
        ring.mark(MAP, 1005)
        ring.end_tick(2005)
        page.spans = ring.spans
        assert commands.trace(args) == 0
        (tick, stage) = checked(json.loads(args.out.read_text()))
        assert (tick["dur"], stage["name"], stage["dur"]) == (2.0, "map", 1.0)
        if token:
            with pytest.raises(urllib.error.HTTPError, match="401"):
                urllib.request.urlopen(f"http://127.0.0.1:{port}/trace")
    with pytest.raises(UnavailableError, match="is the service running"):
        commands.trace(args)


def test_a_service_without_pages(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text('{"perception": {"detector": {"kind": "sim"}}}')
    with pytest.raises(ConfigError, match=r"http\.port: not set"):
        commands.trace(argparse.Namespace(file=str(path), out=tmp_path / "t.json"))
