"""Sinks by their names, and the page that says how to write one, word for word."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fake_zenoh import Flooded
from simulated import simulated

from edge.config import ConfigError
from edge.config.yaml_text import parse_yaml
from edge.lab.eval.closed_loop import ClosedLoop
from edge.sinks import find_sinks
from edge.sinks.zenoh import ZenohSink

PAGE = Path(__file__).parents[2] / "docs" / "sinks.md"
MAX_LINES = 40


def test_goals_and_status_go_over_zenoh_by_default():
    (make,) = find_sinks(simulated())
    sink = make(config=simulated(), session=Flooded("", ()))
    sink.close()
    assert isinstance(sink, ZenohSink)
    assert sink.status() == {"failed": 0, "dropped": 0, "problem": ""}
    assert find_sinks(simulated({"sinks": []})) == []


@pytest.fixture
def page(tmp_path, monkeypatch) -> list[object]:
    """Put the page's module on the path; return its configuration with the test's file."""
    code, section = re.findall(r"```(?:python|yaml)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(code.splitlines()) <= MAX_LINES
    (tmp_path / "csv_sink.py").write_text(code, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    sinks = parse_yaml(section)["sinks"]
    sinks[1]["options"]["path"] = str(tmp_path / "way.csv")
    return sinks


def test_a_plugin_sink_is_one_file_and_one_configuration_line(page, tmp_path):
    lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True}, "sinks": page}
    config = simulated({**lockstep, "mission": {"target": "television"}})
    _, make_own = find_sinks(config)
    sink = make_own(config=config, session=None)
    loop = ClosedLoop(config, sinks=[sink])
    for _ in range(30):
        loop.step()
    sink.close()
    lines = [line.split(",") for line in (tmp_path / "way.csv").read_text("utf-8").splitlines()]
    goals = [line for line in lines if line[1] != "pose"]
    assert len(lines) - len(goals) == 30
    assert [int(stamp) for stamp, *_ in goals] == [goal.stamp_ns for goal in loop.notes.goals] != []


@pytest.mark.parametrize(
    ("sinks", "said"),
    [
        (["zenoh", "zenho"], r"sinks\.1\.kind: unknown 'zenho' \(choices: zenoh, ros2, mcap, fox"),
        ([{"kind": "zenoh", "options": {"hz": 3}}], r"sinks\.0\.options\.hz: unknown option"),
        ([{"kind": "zenoh", "option": {}}], r"sinks\.0\.option: unknown key"),
        ([7], r"sinks\.0: expected a section"),
        (["builtins:object"], r"sinks\.0\.kind: builtins:object is no sink: it has no tick\(\)"),
    ],
)
def test_an_unusable_sink_is_an_error_of_one_line(sinks, said):
    with pytest.raises(ConfigError, match=f"^<defaults>: {said}[^\n]*$"):
        find_sinks(simulated({"sinks": sinks}))
