"""A stop is on the disk before its answer, and only a release ends it."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from patience import PATIENCE_S

from edge.errors import UserError
from edge.host import files, stop_latch
from edge.host.stop_latch import StopLatch, stop_file


@pytest.fixture(autouse=True)
def _no_waiting_for_a_loop(monkeypatch):
    monkeypatch.setattr(stop_latch, "WITHDRAWN_S", 0.0)


def test_a_latch_without_a_file_saves_nothing(tmp_path):
    assert StopLatch(tmp_path / "none" / "stop.json").reason == ""
    latch = StopLatch()
    answer = latch.stop("")
    assert (answer["stopped"], answer["kept"], answer["why"]) == (True, False, "by request")
    assert "a restart would forget the stop" in answer["text"]
    assert latch.release() == {"stopped": False, "text": "not stopped"}


def test_a_stop_is_on_disk_before_it_is_answered(tmp_path, monkeypatch):
    path, written, synced = tmp_path / "state" / "stop.json", [], []
    monkeypatch.setattr(files, "sync", lambda path: synced.append(path.name))
    latch, pwrite = StopLatch(path), os.pwrite
    assert synced == ["state"]

    def record(handle: int, content: bytes, offset: int) -> None:
        flags = Path(f"/proc/self/fdinfo/{handle}").read_text().split("flags:")[1].split()[0]
        assert int(flags, 8) & os.O_DSYNC
        written.append(content.strip())
        pwrite(handle, content, offset)

    monkeypatch.setattr(os, "pwrite", record)
    assert latch.stop("a person\nin the way")["kept"]
    assert [json.loads(content)["why"] for content in written] == ["a person in the way"]
    assert latch.stop("later")["why"] == "a person in the way"
    assert StopLatch(path).reason == "a person in the way"  # as after a kill
    assert len(written) == 1
    latch.release()
    assert written[1:] == [b""]
    assert StopLatch(path).reason == latch.reason == ""


@pytest.mark.parametrize("why", ["é" * 300, "\x00" * 300, '"\\' * 150, "😀" * 300])
def test_a_reason_of_any_text_fits(tmp_path, why):
    latch = StopLatch(tmp_path / "stop.json")
    latch.stop(why)
    assert StopLatch(latch.path).reason == latch.reason


@pytest.mark.parametrize("content", [b"{", b"[]", b"{}", b"\xff" * 9000, None])
def test_a_file_that_cannot_be_read_is_a_stop(tmp_path, content):
    path = tmp_path / "stop.json"
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    latch = StopLatch(path)
    assert str(path) in latch.reason
    if content is None:
        with pytest.raises(UserError, match="still stopped: "):
            latch.release()
        assert latch.reason
    else:
        latch.release()
        assert StopLatch(path).reason == ""


def test_an_unsaved_stop_holds_and_is_saved_later(tmp_path, caplog, monkeypatch):
    path = tmp_path / "folder" / "stop.json"
    path.parent.write_text("no folder")
    monkeypatch.setattr(stop_latch, "read_stop", lambda path: "")
    latch = StopLatch(path)
    monkeypatch.undo()
    answer = latch.stop("now")
    assert (answer["stopped"], answer["kept"]) == (True, False)
    latch.keep()
    assert caplog.text.count("a stop would end with this process") == 1  # not again and again
    path.parent.unlink()
    latch.keep()
    assert latch.stop("")["kept"]
    assert StopLatch(path).reason == "now"
    path.unlink()
    latch.keep()
    assert StopLatch(path).reason == "now"


def test_a_stop_at_the_same_time_wins_over_a_release(tmp_path, monkeypatch):
    latch, pwrite = StopLatch(tmp_path / "stop.json"), os.pwrite
    latch.stop("first")

    def stop_meanwhile(handle: int, content: bytes, offset: int) -> None:
        pwrite(handle, content, offset)
        monkeypatch.setattr(os, "pwrite", pwrite)
        pool.submit(latch.stop, "second")
        while latch._stops < 2:
            pass

    with ThreadPoolExecutor(1) as pool:
        monkeypatch.setattr(os, "pwrite", stop_meanwhile)
        with pytest.raises(UserError, match="still stopped: another stop"):
            latch.release()
    assert latch.reason == StopLatch(latch.path).reason == "first"


def test_an_answer_says_if_the_loop_has_withdrawn_the_goal(monkeypatch):
    latch = StopLatch()
    assert not latch.stop("now")["withdrawn"]
    latch.confirm("")
    assert "has not withdrawn the goal yet" in latch.stop("")["text"]
    latch.confirm("now")
    assert latch.stop("")["withdrawn"]
    latch.release()
    latch.stop("again")
    latch.confirm("now")  # the loop still applies an older stop
    assert not latch.stop("")["withdrawn"]
    latch.release()
    monkeypatch.setattr(stop_latch, "WITHDRAWN_S", PATIENCE_S)
    with ThreadPoolExecutor(1) as pool:  # the answer waits for the loop
        answer = pool.submit(latch.stop, "again")
        while not latch.reason:
            pass
        assert not answer.done()
        with pytest.raises(UserError, match="still stopped: another stop"):
            latch.release()
        latch.confirm("again")
        assert answer.result(PATIENCE_S)["withdrawn"]


@pytest.mark.parametrize(
    ("prefix", "environ", "expected"),
    [
        ("edge", {"STATE_DIRECTORY": "/s:/t"}, "/s/stop-edge.json"),
        ("robots/anna", {"XDG_STATE_HOME": "/x"}, "/x/edge-vln/stop-robots%anna.json"),
        ("edge", {"HOME": "/h"}, "/h/.local/state/edge-vln/stop-edge.json"),
    ],
)
def test_each_robot_has_its_file(monkeypatch, prefix, environ, expected):
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    assert stop_file(prefix) == Path(expected)
