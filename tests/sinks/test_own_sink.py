"""Sinks by their names, and the page that says how to write one, word for word."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from closed_loop import ClosedLoop
from simulated import simulated

from edge.config import ConfigError
from edge.config.yaml_text import parse_yaml
from edge.sinks import find_sinks
from edge.sinks.zenoh import ZenohSink

PAGE = Path(__file__).parents[2] / "docs" / "sinks.md"
MAX_LINES = 40


def test_goals_and_status_go_over_zenoh_unless_told_otherwise():
    (make,) = find_sinks(simulated())
    assert make.func is ZenohSink
    assert find_sinks(simulated({"sinks": []})) == []


@pytest.fixture
def page(tmp_path, monkeypatch) -> list[object]:
    """The page's module on the path, its configuration with a file of the test's."""
    code, section = re.findall(r"```(?:python|yaml)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(code.splitlines()) <= MAX_LINES
    (tmp_path / "csv_sink.py").write_text(code, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    sinks = parse_yaml(section)["sinks"]
    sinks[1]["options"]["path"] = str(tmp_path / "way.csv")
    return sinks


def test_a_sink_of_ones_own_is_a_file_and_a_line_of_the_configuration(page, tmp_path):
    lockstep = {"loop": {"lockstep": True}, "sim": {"lockstep": True}, "sinks": page}
    config = simulated({**lockstep, "mission": {"target": "television"}})
    make_zenoh, make_own = find_sinks(config)
    assert make_zenoh.func is ZenohSink
    sink = make_own(None)
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
        (["zenho"], r"sinks\.0\.kind: unknown 'zenho' \(choices: zenoh, or module:Class\)"),
        (["zenoh", "nowhere:Sink"], r"sinks\.1\.kind: 'nowhere:Sink': ModuleNotFoundError: .*PATH"),
        (["edge.sinks:Sinkk"], r"sinks\.0\.kind: 'edge.sinks:Sinkk': AttributeError"),
        ([{"kind": "zenoh", "options": {"hz": 3}}], r"sinks\.0\.options: .*'hz'"),
        ([{"kind": "zenoh", "option": {}}], r"sinks\.0\.option: unknown key"),
        ([7], r"sinks\.0: expected a section"),
    ],
)
def test_what_is_wrong_with_a_name_is_told_in_one_line(sinks, said):
    with pytest.raises(ConfigError, match=f"^<defaults>: {said}[^\n]*$"):
        find_sinks(simulated({"sinks": sinks}))
