"""A task in the report: its words as text, its trajectory on the map and in three dimensions."""

from __future__ import annotations

from dataclasses import replace

import pytest
from report_runs import task_run
from results import result
from simulated import simulated
from task_facts import by_a_model, driving, looking

from edge.lab.report import page, tasks
from edge.lab.report.record import RunRecord
from edge.lab.report.recorder import ReportRecorder
from edge.loop.result import Event


@pytest.fixture(scope="module")
def done() -> RunRecord:
    return task_run(rounds=by_a_model().rounds, prompt=by_a_model().prompt)


def test_a_run_without_a_task_has_no_part_about_one(run, tmp_path):
    assert tasks.section(run, linked=False) == ""
    assert tasks.page(run) is None
    assert page.write_report(run, tmp_path).scene is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.png"]


def test_the_task_section_shows_request_and_outcome(done):
    html = tasks.section(done, linked=True)
    for words in ("go through the door", "reached", "of it driven", tasks.SCENE_NAME, "Prompt"):
        assert words in html
    assert html.count("<details>") == 3
    assert tasks.SCENE_NAME not in tasks.section(done, linked=False)


def test_every_trajectory_is_reported_and_drawn(done):
    """The first step's, the second's, and the rest of that, refined again at its end."""
    first = driving(understood="past the left of van 1")
    second = driving(
        understood="to gate 5", coarse_m=first.coarse_m + 1.0, refined=replace(first.refined)
    )
    last = replace(second, phase="reached", refined=replace(first.refined), refinements=3)
    record = replace(done, task=last, task_at_trajectory_start=(first, second, last))
    html = tasks.section(record, linked=False)
    for words in (
        "<dt>trajectory 1</dt><dd>past the left of van 1: ", "<dt>trajectory 2</dt><dd>to gate 5: ",
        "; the rest refined again 1 times",
    ):  # fmt: skip
        assert words in html
    assert "refined 2" in tasks.page(record)
    assert len(tasks.points_m(record)) == 6
    looked = replace(record, task=looking(phase="failed"))
    assert "trajectory 2" in tasks.section(looked, linked=False)
    assert tasks.page(looked) is not None


def test_the_recorder_keeps_each_trajectory():
    recorder = ReportRecorder(simulated())
    first, event = driving(), Event(1, "trajectory of 3 m")
    recorder.tick(result(task=lambda: first, events=(event,)))
    recorder.tick(result(task=lambda: replace(first, index=50), events=(event,)))
    recorder.tick(result(task=looking, events=(event,)))
    kept = recorder.record(result(task=looking), {})
    assert (kept.task.phase, kept.task_at_trajectory_start, kept.trajectories) == (
        "looking",
        (first,),
        (first,),
    )


def test_an_unwritten_task_lists_the_missing_objects(done):
    html = tasks.section(replace(done, task=looking(phase="failed")), linked=False)
    assert "van, gate" in html
    assert "<dt>looked for</dt><dd>stop at the gate</dd>" in html
    assert "trajectory" not in html
    assert tasks.page(replace(done, task=looking())) is None
    assert tasks.page(replace(done, map=None)) is None


def test_text_of_a_model_is_escaped(done, tmp_path):
    hostile = replace(done, task=by_a_model())
    paths = page.write_report(hostile, tmp_path)
    for path in (paths.html, paths.scene):
        text = path.read_text()
        assert "<script>alert" not in text
        assert "<img src=x" not in text
    assert "&lt;script&gt;alert(1)" in paths.html.read_text()
