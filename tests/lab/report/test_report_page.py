"""The HTML page: whole, self-contained, and safe with any text."""

from __future__ import annotations

import os
import re
from dataclasses import replace

import numpy as np
import pytest
from html_reader import Reader

from edge.lab.report import page
from edge.lab.report.record import Keyframe
from edge.types import Instance, MissionStatus

BAD = '<script>alert("x")</script>&\'"'


def test_an_empty_run(empty_run):
    reader = Reader(page.html(empty_run, b""))
    assert "No frame was kept." in reader.text
    assert "Nothing happened." in reader.text
    assert "searching" in reader.text


def test_a_run_is_all_there(run):
    reader = Reader(page.html(run, b"png"))
    for text in (
        "reached", "Find the chair", "chair 4 (reached, 9 hits)",
        "goal 1: frontier 0", "detect*", "tick",
        "approaching chair 4 (score 0.71)", "frames dropped", "no neural network", "time_limit_s",
    ):  # fmt: skip
        assert text in reader.text, text
    assert len(reader.all("figure")) == len(run.frames) == 8


def test_nothing_is_fetched(run):
    text = page.html(run, b"png")
    reader = Reader(text)
    assert reader.addresses
    assert all(address.startswith("data:image/") for address in reader.addresses)
    assert not re.search(r"https?://|url\(|@import", text)
    assert not {"script", "link", "iframe"} & {tag for tag, _ in reader.tags}


def test_text_cannot_become_markup(run):
    frame = Keyframe(
        0, np.zeros((40, 50, 3), np.uint8), np.array([[1, 2, 30, 20]], np.float32),
        np.ones(1, np.float32), (BAD,), np.ones(1, bool),
    )  # fmt: skip
    point = np.zeros((1, 3), np.float32)
    bad = replace(
        run, title=BAD, config_path=BAD, robot=BAD, detector=BAD, targets={BAD: BAD}, machine=BAD,
        mission=MissionStatus(BAD, "failed", BAD), frames=(frame,), events=((1.0, BAD),),
        instances=(Instance(1, BAD, point[0], point, 0.5, 1, 0, 0),), counters={BAD: 1},
        config={BAD: BAD},
    )  # fmt: skip
    text = page.html(bad, b"")
    reader = Reader(text)
    assert reader.all("script") == []
    assert "<script" not in text
    assert reader.text.count('alert("x")') >= 11


def test_boxes_outside_the_image_and_not_finite(run):
    frame = Keyframe(
        0, np.zeros((40, 50, 3), np.uint8),
        np.array([[-5, -5, 500, 500], [np.nan, 0, 1, np.inf]], np.float32),
        np.ones(2, np.float32), ("a", "b"), np.zeros(2, bool),
    )  # fmt: skip
    reader = Reader(page.html(replace(run, frames=(frame,)), b""))
    assert "target not seen" in reader.text
    assert "b 1.00" not in reader.text


def test_write_report(run, tmp_path):
    paths = page.write_report(run, tmp_path / "a" / "b")
    assert paths.png.read_bytes().startswith(b"\x89PNG")
    assert "Find the chair" in paths.html.read_text(encoding="utf-8")
    assert sorted(p.name for p in paths.html.parent.iterdir()) == ["report.html", "report.png"]
    assert page.write_report(run, str(tmp_path / "a" / "b")) == paths


def test_a_directory_that_cannot_be_written(run, tmp_path):
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    for directory in (in_the_way, in_the_way / "below"):
        with pytest.raises(page.ReportError) as caught:
            page.write_report(run, directory)
        assert str(directory) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_directory_without_permission(run, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(page.ReportError, match="cannot write"):
        page.write_report(run, tmp_path)
