"""Files of limited size and age, a folder of limited size, a disk that is full for a while."""

from __future__ import annotations

import os
import subprocess
import sys
from datetime import datetime

import pytest

from edge.bus import topics
from edge.recording import rolling as rolling_module
from edge.recording.channels import topic_channel
from edge.recording.file import PARTIAL, McapReader, _UnbufferedFile
from edge.recording.rolling import MAX_S, RollingRecorder, files_of, make_room

STATUS = topic_channel(topics.STATUS)
NOISE = os.urandom(100_000)  # does not get smaller


class Clock:
    s = 100.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def rolling(folder, clock, max_mb: float = 256.0, keep_mb: float = 4096.0) -> RollingRecorder:
    return RollingRecorder(folder, max_mb, keep_mb, "lz4", lambda n: {"t": {"part": str(n)}}, clock)


def put(files: RollingRecorder, n: int = 1, payload: bytes = b"{}") -> None:
    for _ in range(n):
        files.ready()
        files.add(STATUS, 0, 0, payload)
        files.sync()


def test_without_messages_no_file_is_written(tmp_path, clock):
    rolling(tmp_path / "new", clock).close()
    assert list(tmp_path.iterdir()) == []


def test_a_complete_file_gets_its_final_name(tmp_path, clock):
    files = rolling(tmp_path / "new", clock)
    put(files)
    (path,) = files_of(tmp_path / "new")
    assert path.name == files.name + PARTIAL
    files.close()
    (path,) = files_of(tmp_path / "new")
    assert path.suffix == ".mcap"
    assert path.name.startswith("edge-2")


def test_a_file_that_is_old_is_followed_by_the_next(tmp_path, clock):
    files = rolling(tmp_path, clock)
    for _ in range(3):
        put(files, 2)
        clock.s += MAX_S + 1.0
    files.close()
    parts = []
    for path in files_of(tmp_path):
        reading = McapReader(path)
        assert len(list(reading)) == 2
        parts.append(reading.metadata["t"]["part"])
    assert parts == ["0", "1", "2"]


def test_the_oldest_files_are_removed_unless_being_written(tmp_path, clock, monkeypatch):
    other = rolling(tmp_path, clock)
    put(other, 5, NOISE)
    written = files_of(tmp_path)[0]
    foreign = [
        tmp_path / name
        for name in ("holiday.mcap", "edge-1.mcap", "edge-20200101T000000.000Z.mcap.old")
    ]
    for path in foreign:
        path.write_bytes(NOISE)
    monkeypatch.setattr("edge.recording.rolling.SYNC_S", 0.0)
    files = rolling(tmp_path, clock, max_mb=1.0, keep_mb=3.0)
    put(files, 60, NOISE)
    files.close()
    left = files_of(tmp_path)
    assert left[0] == written
    assert all(path.exists() for path in foreign)
    assert sum(path.stat().st_size for path in left) <= 3_300_000
    parts = []
    for path in left[1:]:
        reading = McapReader(path)
        list(reading)
        parts.append(int(reading.metadata["t"]["part"]))
    assert parts == list(range(6 - len(parts), 6))
    other.close()


def test_a_write_error_is_logged_once_and_recording_continues_later(tmp_path, clock, caplog):
    folder = tmp_path / "folder"
    folder.write_bytes(b"in the way")
    files = rolling(folder, clock)
    for _ in range(3):
        put(files, 2)
        clock.s += 6.0
    assert (files.messages, files.lost) == (0, 6)
    assert files.problem == "File exists"
    folder.unlink()
    put(files, 2)
    assert (files.messages, files.problem) == (2, "")
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 2
    assert said[0].endswith("cannot record: File exists; trying again every few seconds")
    assert said[1].endswith("; 6 messages were lost")
    files.close()


def test_a_clock_that_begins_in_1970_deletes_the_older_files_first(tmp_path, clock, monkeypatch):
    for day in (1, 2, 3):
        (tmp_path / f"edge-2026010{day}T000000.000Z.mcap").write_bytes(bytes(1_000_000))
    (tmp_path / "edge-99999999T000000.000Z.mcap").write_bytes(b"")

    class Clock1970(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(1970, 1, 1, 0, 0, 5, tzinfo=tz)

    monkeypatch.setattr(rolling_module, "datetime", Clock1970)
    files = rolling(tmp_path, clock, max_mb=1.0, keep_mb=3.0)
    put(files, 30, NOISE)
    files.close()
    names = [path.name for path in files_of(tmp_path)]
    assert "edge-20260103T000000.003Z.mcap" in names
    assert "edge-20260101T000000.000Z.mcap" not in names
    assert "edge-20260102T000000.000Z.mcap" not in names


def test_a_file_deleted_by_another_process_does_not_disturb(tmp_path, clock, monkeypatch):
    for day in (1, 2):
        (tmp_path / f"edge-2026010{day}T000000.000Z.mcap").write_bytes(b"")
    found = files_of(tmp_path)
    found[0].unlink()
    monkeypatch.setattr(rolling_module, "files_of", lambda folder: found)
    make_room(tmp_path, -1)
    assert not found[1].exists()


@pytest.mark.parametrize("step", ["write", "fsync", "close", "replace"])
def test_recording_goes_on_after_an_error_at_the_end_of_a_file(tmp_path, clock, monkeypatch, step):
    files = rolling(tmp_path, clock)
    put(files, 2)
    clock.s += MAX_S + 1.0

    def fail(*_):
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        owner, name = {
            "write": (_UnbufferedFile, "write"), "fsync": (_UnbufferedFile, "sync"),
            "close": (os, "close"), "replace": (os, "replace"),
        }[step]  # fmt: skip
        patch.setattr(owner, name, fail)
        files.ready()
    assert (files.name, files.problem) == ("", "Input/output error")
    clock.s += 6.0
    put(files, 3)
    assert (files.messages, files.lost, files.problem) == (3, 2, "")
    files.close()


FULL = """
import logging, resource, sys
from pathlib import Path
from edge.bus import topics
from edge.recording.channels import topic_channel
from edge.recording import rolling
logging.basicConfig(format="%(message)s")
now = [0.0]
rolling.SYNC_S = 0.0
files = rolling.RollingRecorder(
    Path(sys.argv[1]), 256.0, 4096.0, "none", lambda n: {}, lambda: now[0]
)
def put(n):
    for _ in range(n):
        now[0] += 0.1
        files.ready(); files.add(topic_channel(topics.STATUS), 0, 0, bytes(10_000)); files.sync()
most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))
put(120)
assert (files.messages, files.lost) == (0, 120)
assert not list(Path(sys.argv[1]).iterdir()), "what cannot be begun leaves nothing"
now[0] += 6.0
resource.setrlimit(resource.RLIMIT_FSIZE, (105_000, most))
put(15)
assert files.problem == "File too large" and files.lost, files.problem
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
put(60)
assert files.problem == ""
files.close()
print(files.messages, files.lost)
"""


def test_a_disk_that_is_full_for_a_while(tmp_path):
    """A limit on the file size fails like a full disk, and any process may set it."""
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    told = done.stderr.splitlines()
    assert len(told) == 4
    assert told[0].endswith("cannot record: File too large; trying again every few seconds")
    messages, lost = map(int, done.stdout.split())
    assert messages + lost == 195
    first, second = files_of(tmp_path)
    assert first.name.endswith(PARTIAL)
    read = len(list(McapReader(first))), len(list(McapReader(second)))
    assert read[0] == 10
    assert sum(read) == messages
