"""Checks that a soak makes of recordings: complete, readable, replayable, not too large."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from recordings import Recording
from simulated import simulated

from edge.lab.eval.soak.recordings import FIRST, RecordingCheck, move_folders
from edge.recording.file import PARTIAL
from edge.recording.rolling import files_of

NAME = "edge-20261126T010203.000Z.mcap"
MCAP = {"kind": "mcap", "options": {"folder": "elsewhere", "keep_mb": 512}}


def recorded(out: Path) -> RecordingCheck:
    config = simulated({"sinks": ["zenoh", MCAP]})
    return RecordingCheck(config.model_copy(update={"sinks": move_folders(config.sinks, out)}), out)


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> bytes:
    return Recording(tmp_path_factory.mktemp("drive")).steps(5).close().read_bytes()


def lay(out: Path, content: bytes, name: str = NAME) -> Path:
    (out / "recordings").mkdir(exist_ok=True)
    path = out / "recordings" / name
    path.write_bytes(content)
    return path


def test_without_a_recorder_there_is_nothing_to_judge(tmp_path):
    recordings = RecordingCheck(simulated(), tmp_path)
    recordings.check_next_file()
    assert recordings.judge() == {}
    assert recordings.problem == ""
    assert list(tmp_path.iterdir()) == []


def test_nothing_recorded_is_reported_at_the_end(tmp_path):
    recordings = recorded(tmp_path)
    recordings.check_next_file()
    assert recordings.problem == ""
    recordings.judge()
    assert recordings.problem == "nothing was recorded"


def test_a_complete_file_is_read_and_the_first_kept(tmp_path, drive):
    recordings = recorded(tmp_path)
    path = lay(tmp_path, drive, NAME + PARTIAL)
    recordings.check_next_file()
    assert recordings.files == 0
    path.rename(path.with_suffix(""))
    for _ in range(2):
        recordings.check_next_file()
        assert recordings.files == 1
    assert recordings.messages > 5
    files_of(path.parent)[0].unlink()
    judged = recordings.judge()
    assert (tmp_path / FIRST).read_bytes() == drive
    assert (judged["ticks"], judged["differing"], judged["ended"]) == (5, 0, "")
    assert recordings.problem == ""


def test_a_cut_off_recording_is_replayed_to_its_end(tmp_path, drive):
    recordings = recorded(tmp_path)
    lay(tmp_path, drive[: len(drive) // 2], NAME + PARTIAL)
    recordings.check_next_file()
    judged = recordings.judge()
    assert (judged["files"], judged["cut"]) == (1, 1)
    assert judged["ended"].endswith("cut off")


def flipped(drive: bytes) -> bytes:
    at = len(drive) // 2
    return drive[:at] + bytes([drive[at] ^ 1]) + drive[at + 1 :]


@pytest.mark.parametrize(
    ("content", "name", "problem"),
    [
        (lambda drive: drive[:-40], NAME, f"{NAME}: "),
        (flipped, NAME, f"{NAME}: "),
        (lambda drive: b"", NAME + PARTIAL, "not an MCAP file"),
        (lambda drive: os.urandom(4096), NAME + PARTIAL, "not an MCAP file"),
    ],
    ids=["no end", "damaged", "empty", "noise"],
)
def test_an_unreadable_recording_is_reported(tmp_path, drive, content, name, problem):
    recordings = recorded(tmp_path)
    lay(tmp_path, content(drive), name)
    recordings.check_next_file()
    recordings.judge()
    assert problem in recordings.problem


def test_a_folder_that_is_too_large_is_reported(tmp_path):
    recordings = recorded(tmp_path)
    path = lay(tmp_path, b"", NAME + PARTIAL)
    os.truncate(path, 513_000_000)  # a hole
    recordings.check_next_file()
    assert recordings.problem == ""
    os.truncate(path, 515_000_000)
    recordings.check_next_file()
    assert recordings.problem == "recordings have 515.0 MB, keep_mb allows 512 MB"
