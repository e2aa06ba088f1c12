"""The small choice scorer in the loop: it is asked, its answers are kept, the target is reached."""

from __future__ import annotations

import pytest

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `cpu`)")

from edge.cli import main as cli
from edge.config import parse
from edge.lab.eval.arms import data_of, merged
from edge.lab.eval.closed_loop import ClosedLoop
from edge.lab.report import choices
from edge.lab.report.recorder import ReportRecorder

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


def test_the_demo_reaches_its_target_by_the_small_scorer(monkeypatch):
    monkeypatch.delenv("EDGE__POLICY__KIND", raising=False)
    asked = cli.load_config(cli.make_parser().parse_args(["demo", "--policy", "directional"]))
    inline = {"loop": {"lockstep": True}, "sim": {"lockstep": True}}
    config = parse(merged(data_of(asked), inline), asked.path)
    recorder = ReportRecorder(config)
    loop = ClosedLoop(config, sinks=[recorder])
    try:
        loop.run(240.0)
        assert loop.service.status.phase == "reached"
        assert loop.distance_m("bed") <= 1.0
        counts = loop.scorers.status()["choice"]
        record = recorder.record(loop.service.result(), {})
    finally:
        loop.close()
    assert counts["model"] == "mini-house-choice"
    assert counts["failed"] == 0
    page = choices.section(record)
    assert "elsewhere" in page  # letters with their answers
    assert "value of bed" in page
