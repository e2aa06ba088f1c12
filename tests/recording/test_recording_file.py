"""MCAP files: whole or cut anywhere, their messages are read, here and by `mcap`."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from edge.bus import topics
from edge.recording import commands
from edge.recording.channels import topic_channel
from edge.recording.file import McapReader, McapWriter, RecordingError, is_being_written, recover

STATUS = topic_channel(topics.STATUS)


def write(path, n: int, compression: str = "lz4", metadata=None) -> None:
    with McapWriter(path, compression, metadata) as file:
        for k in range(n):
            file.add(STATUS, k, k, b'{"k": %d, "noise": "%s"}' % (k, os.urandom(40).hex().encode()))
            if k % 5 == 4:
                file.sync()


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_written_recording_is_read_back(tmp_path, compression):
    path = tmp_path / "a.mcap"
    write(path, 12, compression, {"edge": {"a": "1"}})
    reading = McapReader(path)
    read = list(reading)
    assert [m.log_ns for m in read] == list(range(12))
    assert {(m.topic, m.schema, m.encoding) for m in read} == {("/status", "status", "json")}
    assert reading.metadata == {"edge": {"a": "1"}}
    with open(path, "rb") as file:
        theirs = [message.data for _, _, message in make_reader(file).iter_messages()]
    assert [m.payload for m in read] == theirs


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    write(path, 40)
    return path.read_bytes()


@given(share=st.floats(0, 1))
def test_at_any_cut_the_beginning_is_read(tmp_path_factory, whole, share):
    path = tmp_path_factory.mktemp("cut") / "a.mcap"
    size = int(share * (len(whole) - 1))
    path.write_bytes(whole[:size])
    reading = McapReader(path)
    if size < 40:  # shorter than the magic and the header
        with suppress(RecordingError):
            assert list(reading) == []
        return
    n = len(list(reading))
    assert n % 5 == 0
    assert n >= 40 * (size / len(whole)) - 25
    assert reading.is_complete or reading.truncation == "cut off"


@given(share=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_a_damaged_recording_is_read_up_to_the_damage(tmp_path_factory, whole, share, flip):
    path = tmp_path_factory.mktemp("damaged") / "a.mcap"
    at = 40 + int(share * (len(whole) - 40))  # behind the magic and the header
    broken = bytearray(whole)
    broken[at] ^= flip
    path.write_bytes(broken)
    reading = McapReader(path)
    n = len(list(reading))
    assert n <= 40
    if reading.is_complete:  # the rest of the file is only an index
        assert n == 40
    else:
        assert reading.truncation.startswith("damaged: ")


@pytest.mark.parametrize("content", [b"", b"junk" * 100, b"\x89MCAP1\r\n" + b"0" * 100])
def test_a_file_that_is_not_a_recording_is_refused(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"a\.mcap: not an MCAP file"):
        list(McapReader(path))
    with pytest.raises(RecordingError, match="not an MCAP file"):
        recover(path, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_a_partial_file_is_recovered_under_its_own_name(tmp_path, whole):
    path, out = tmp_path / "a.mcap.partial", tmp_path / "a.mcap"
    cut = whole[: len(whole) * 3 // 4]
    path.write_bytes(cut)
    there = list(McapReader(path))
    assert commands.recover(argparse.Namespace(file=path, out=None)) == 0
    assert list(McapReader(out)) == there != []
    assert path.read_bytes() == cut
    assert sorted(tmp_path.iterdir()) == [out, path]


def test_an_existing_file_is_not_overwritten(tmp_path, whole):
    path = tmp_path / "a.mcap.recovering"
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match=r"a\.mcap\.recovering: exists already"):
        recover(path, tmp_path / "a.mcap")
    assert path.read_bytes() == whole


def test_no_file(tmp_path):
    with pytest.raises(RecordingError, match="No such file"):
        list(McapReader(tmp_path / "a.mcap"))


WRITER = """
import time
from pathlib import Path
from edge.bus import topics
from edge.recording.channels import topic_channel
from edge.recording import rolling
rolling.SYNC_S = 0.05
files = rolling.RollingRecorder(Path({folder!r}), 256.0, 4096.0, "lz4", lambda part: {{}})
k = 0
while True:
    files.ready()
    files.add(topic_channel(topics.STATUS), k, k, b"%d" % k)
    files.sync()
    k += 1
    if k % 50 == 0:
        print(k, time.monotonic(), flush=True)
    time.sleep(0.001)
"""


def test_a_kill_loses_only_the_last_moments(tmp_path):
    script = WRITER.format(folder=str(tmp_path))
    writer = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    told = [int(writer.stdout.readline().split()[0]) for _ in range(8)]
    (path,) = tmp_path.glob("*.partial")
    assert is_being_written(path)
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    assert not is_being_written(path)
    reading = McapReader(path)
    read = [int(m.payload) for m in reading]
    assert read == list(range(len(read)))
    assert len(read) >= told[-1] - 150  # 50 ms of syncing, and as much of writing, on a slow disk
    assert reading.truncation == "cut off"
    theirs = []
    with open(path, "rb") as file, suppress(EndOfFile):
        for record in StreamReader(file).records:
            theirs += [record] if isinstance(record, Message) else []
    assert [int(m.data) for m in theirs] == read
    n, why = recover(path, tmp_path / "whole.mcap")
    assert (n, why) == (len(read), "cut off")
    with open(tmp_path / "whole.mcap", "rb") as file:
        assert len(list(make_reader(file).iter_messages())) == n
    with pytest.raises(RecordingError, match="exists already"):
        recover(path, tmp_path / "whole.mcap")
    writer.stdout.close()
