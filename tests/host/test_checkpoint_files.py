"""Checkpoint files: whole or not there, whatever kills their writer or befalls the file."""

from __future__ import annotations

import hashlib
import io
import logging
import os
import subprocess
import sys
import threading
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.host import checkpoint
from edge.host.checkpoint import (
    VERSION,
    Checkpoint,
    CheckpointError,
    CheckpointFormat,
    CheckpointWriter,
    check_arrays,
    load,
    save,
)
from edge.loop.checkpoints.map_checkpoint import MAP
from edge.mission.checkpoint import MISSION

MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class Note:
    text: str
    n: int = 0


def no_secret(note: Note) -> None:
    if note.text == "secret":
        raise ValueError("text: it is a secret")


NOTE = CheckpointFormat("edge-note", "note", Note, MAX_BYTES, no_secret)
ARRAYS = {
    "part/xy_m": np.arange(6.0).reshape(3, 2), "part/label": np.array(["chair", "tv stand"]),
    "n": np.array(7, np.int64), "none": np.zeros((0, 3), np.float32), "flag": np.array([True]),
}  # fmt: skip
BEGUN = Checkpoint(Note("é: the cheapest", 1), ARRAYS, "0123abcd", 5)
WHOLE = NOTE.encode(BEGUN)
BEGINS = NOTE.begins
STATE = b'{"text":"a"}'


def same(one: Checkpoint, other: Checkpoint) -> bool:
    assert one.arrays.keys() == other.arrays.keys()
    for name, array in one.arrays.items():
        np.testing.assert_array_equal(array, other.arrays[name], name)
        assert array.dtype == other.arrays[name].dtype
    return replace(one, arrays={}).__dict__ == replace(other, arrays={}).__dict__


def others(folder: Path, path: Path) -> list[str]:
    return sorted(found.name for found in folder.iterdir() if found != path)


def wrong(content: bytes) -> str:
    """Return why it is no file; "" if it is one."""
    try:
        NOTE.decode(content)
    except ValueError as error:
        return str(error)
    return ""


def forged(state: bytes, archive: bytes, version: int = VERSION) -> bytes:
    """Return a file with a right checksum, whatever is in it."""
    body = b'"config":"","written_ns":5,"state":%s}\n%s' % (state, archive)
    digest = hashlib.sha256(body).hexdigest().encode()
    return BEGINS + b'"version":%d,"sha256":"%s",%s' % (version, digest, body)


def archive(
    *members: tuple[str, bytes], method: int = zipfile.ZIP_STORED, end: bytes = b""
) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as packed:
        for name, content in members:
            packed.writestr(name, content)
        packed.comment = end
    return file.getvalue()


def npy(descr: str, shape: tuple[int, ...], content: bytes = b"", version: int = 1) -> bytes:
    head = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape!r}, }}\n".encode()
    return b"\x93NUMPY%c\0" % version + len(head).to_bytes(2, "little") + head + content


def x_of(content: bytes) -> bytes:
    return forged(STATE, archive(("x.npy", content)))


@pytest.mark.parametrize("saved", [Checkpoint(Note("")), BEGUN])
def test_a_saved_checkpoint_is_loaded_unchanged(tmp_path, saved):
    path = tmp_path / "note"
    assert load(path, NOTE) == (None, "")
    save(path, BEGUN, NOTE)
    save(path, saved, NOTE)
    loaded, problem = load(path, NOTE)
    assert same(loaded, saved)
    assert problem == ""
    assert others(tmp_path, path) == []


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"state": Note("secret")}, "it is a secret"),
        ({"state": Note("x" * MAX_BYTES)}, "at most"),
        ({"arrays": {"x": np.zeros(MAX_BYTES)}}, "at most"),
        ({"arrays": {"x": np.array([{}])}}, "Python objects"),
    ],
)
def test_a_state_that_could_not_be_loaded_is_not_saved(tmp_path, change, text):
    path = tmp_path / "note"
    save(path, BEGUN, NOTE)
    with pytest.raises(ValueError, match=text) as caught:
        save(path, replace(BEGUN, **change), NOTE)
    assert "\n" not in str(caught.value)
    assert same(load(path, NOTE)[0], BEGUN)


DAMAGED = {
    "head": (BEGINS, "not a complete note"),
    "cut": (WHOLE[:-1], "checksum"),
    "half": (WHOLE[:300], "checksum"),
    "longer": (WHOLE + b"\n", "checksum"),
    "changed": (WHOLE.replace(b"cheapest", b"dearest!"), "checksum"),
    "stamp": (WHOLE.replace(b'"written_ns":5', b'"written_ns":6'), "checksum"),
    "earlier": (b'%s"version":2,"sha256":"%064d","note":{}}\n' % (BEGINS, 0), "version 2 of the"),
    "later": (
        forged(STATE, archive(), VERSION + 1),
        f"written in version {VERSION + 1} of the format; this edge reads version ",
    ),
    "too long": (BEGINS + b" " * MAX_BYTES, "more than"),
    "no archive": (forged(STATE, b""), "the list of arrays"),
    "list": (forged(b"[]", archive()), "state: "),
    "nothing": (forged(b"{}", archive()), "text: Field required"),
    "number": (forged(b'{"text":1}', archive()), "text: "),
    "nest": (forged(b"[" * 100_000, archive()), "state: "),
    "secret": (forged(b'{"text":"secret"}', archive()), "it is a secret"),
    "a comment": (forged(STATE, archive(end=b"comment" * 9)), "the list of arrays"),
    "many": (forged(STATE, archive(*((f"{i}", b"") for i in range(2000)))), "too long"),
    "packed": (
        forged(STATE, archive(("x.npy", bytes(1 << 24)), method=zipfile.ZIP_DEFLATED)),
        "more bytes than the file",
    ),
    "bomb": (x_of(npy("'<f8'", (1 << 45,))), "float64 and shape (35184372088832,)"),
    "no bytes": (x_of(npy("'<U0'", (1 << 40,))), "an array of type <U0"),
    "short": (x_of(npy("'<f8'", (2,), bytes(8))), "an array of type float64 and shape (2,)"),
    "minus": (x_of(npy("'<i1'", (-2, -4), bytes(8))), ""),
    "pickle": (x_of(npy("'|O'", (1,), b"x" * 8)), "an array of type object and shape (1,)"),
    "records": (x_of(npy("[('a', '<f8')]", (1,), bytes(8))), "type [('a', '<f8')] and shape"),
    "version": (x_of(npy("'<i1'", (), b"0", 9)), ""),
    "no array": (x_of(b"text"), ""),
    "code": (x_of(npy("exit()", ())), ""),
    "nested": (x_of(npy("(" * 9000, ())), ""),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_file_is_set_aside_with_little_memory(tmp_path, caplog, name):
    path, (content, text) = tmp_path / "note", DAMAGED[name]
    path.write_bytes(content)
    (tmp_path / "note.damaged-1").write_text("of the day before")
    tracemalloc.start()
    with caplog.at_level(logging.WARNING):
        loaded, problem = load(path, NOTE)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert loaded is None
    assert (text or "arrays cannot be read") in problem
    assert str(path) in problem
    assert "note.damaged-2" in problem
    assert "\n" not in problem
    assert len(problem) < 1000
    assert caplog.messages == [problem]
    assert not path.exists()
    assert (tmp_path / "note.damaged-1").read_text() == "of the day before"
    assert (tmp_path / "note.damaged-2").read_bytes() == content
    assert load(path, NOTE) == (None, "")
    assert most < 8 * MAX_BYTES


USES: dict[str, Callable] = {
    "load": lambda path: load(path, NOTE), "write": lambda path: CheckpointWriter(path, NOTE)
}  # fmt: skip


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize(
    "content",
    [b"", b"{}", b"\0" * 5000, b"alias ll='ls -l'\n", MAP.begins, MISSION.begins, b" " + WHOLE],
)
def test_a_file_of_another_program_is_refused_and_left_alone(tmp_path, use, content):
    path = tmp_path / ".bashrc"
    path.write_bytes(content)
    with pytest.raises(CheckpointError) as error:
        USES[use](path)
    assert str(error.value) == (
        f"mission.checkpoint: {path}: not a note, left unchanged; name another file, or move "
        "this one away"
    )
    assert [p.name for p in tmp_path.iterdir()] == [".bashrc"]
    assert path.read_bytes() == content


@settings(max_examples=200)
@given(st.data())
def test_damage_anywhere_is_found(data):
    at, bit = data.draw(st.integers(0, len(WHOLE) - 1)), data.draw(st.integers(0, 7))
    more = data.draw(st.binary(min_size=1, max_size=9))
    for damaged in (
        WHOLE[:at],
        WHOLE[:at] + bytes([WHOLE[at] ^ 1 << bit]) + WHOLE[at + 1 :],
        WHOLE[:at] + bytes(len(WHOLE) - at),
        WHOLE[:at] + WHOLE[at // 2 :],
        WHOLE[:at] + more + WHOLE[at:],
    ):
        assert damaged == WHOLE or wrong(damaged)


@given(st.binary(max_size=300), st.binary(max_size=100))
def test_random_bytes_are_not_a_checkpoint(content, state):
    assert wrong(content) == "not a complete note"
    assert wrong(forged(state, content))
    assert wrong(x_of(content))


LIKE = {
    "id": np.zeros(0, np.int64), "name": np.array([], "U1"), "kind": np.array(0, np.int8),
    "seen_ns": np.zeros(0, np.int64), "cell": np.zeros(0, np.int64),
}  # fmt: skip
FITS = {
    "id": np.array([4, 2]), "name": np.array(["tv", "chair"]), "kind": np.array(3, np.int8),
    "seen_ns": np.array([1 << 60]), "cell": np.array([-(1 << 31)]),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("kind", None),
        ("other", np.zeros(1)),
        ("id", np.array([4, 4])),
        ("name", np.array(["tv"])),
        ("id", np.array([4, 2], ">i8")),
        ("kind", np.array(4, np.int8)),
        ("kind", np.array(-1, np.int8)),
        ("seen_ns", np.array([1 << 62])),
        ("cell", np.array([1 << 40])),
        ("cell", np.array([1, 2, 3, 4])),
        ("name", np.array(["tv", "a\nb"])),
        ("name", np.array(["tv", "a" * 5000])),
        ("name", np.frombuffer(b"\xff" * 8, "<U1")),
    ],
)
def test_loaded_arrays_must_have_the_saved_names_and_shapes(name, array):
    rows = {("id", "name"): 8, ("seen_ns",): 3, ("cell",): 3}
    check_arrays(FITS, LIKE, rows, {"kind": 3}, ("id",))
    state = {key: a for key, a in {**FITS, name: array}.items() if a is not None}
    with pytest.raises(ValueError, match=name) as caught:
        check_arrays(state, LIKE, rows, {"kind": 3}, ("id",))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("use", "name"),
    [
        *((use, name) for use in USES for name in ("folder", "pipe", "loop")),
        *(("write", name) for name in ("missing/note", "note/note")),
    ],
)
def test_an_unusable_path_is_a_user_error(tmp_path, use, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "note").write_text("")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(CheckpointError, match=f"{name}: .*; name a file in a folder") as caught:
        USES[use](tmp_path / name)
    assert "\n" not in str(caught.value)


COMMON = """
import os, random, resource, signal, sys, time
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from edge.host.checkpoint import Checkpoint, CheckpointFormat, CheckpointWriter, load, save
@dataclass
class Note:
    text: str
    n: int = 0
NOTE = CheckpointFormat("edge-note", "note", Note, 1 << 20)
path = Path(sys.argv[1])
"""
KILLED = """
chance = random.Random(3)
for life in range(30):
    first = n = load(path, NOTE)[0].state.n
    if (child := os.fork()) == 0:
        signal.alarm(60)  # should the parent fail, this one must not write for ever
        while True:
            n += 1
            save(path, Checkpoint(Note("", n), {"x": np.full(1 + n % 200 * 500, n)}), NOTE)
    while life == 0 and load(path, NOTE)[0].state.n == first:
        assert os.waitpid(child, os.WNOHANG) == (0, 0), "the writer ended by itself"
    time.sleep(chance.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    loaded, problem = load(path, NOTE)
    n, x = loaded.state.n, loaded.arrays.get("x", [])
    print(problem or "whole", n, n == first or len(x) == 1 + n % 200 * 500 and set(x) == {n})
"""


def run(code: str, path: Path) -> subprocess.CompletedProcess[str]:
    done = [sys.executable, "-c", COMMON + code, str(path)]
    return subprocess.run(done, capture_output=True, text=True, check=True)


def test_kill_9_leaves_a_whole_checkpoint(tmp_path):
    path = tmp_path / "note"
    save(path, Checkpoint(Note("")), NOTE)
    lives = [line.split() for line in run(KILLED, path).stdout.splitlines()]
    written = [int(n) for _, n, _ in lives]
    assert [(word, fits) for word, _, fits in lives] == [("whole", "True")] * 30
    assert written == sorted(written)
    assert written[-1] > 0
    assert set(others(tmp_path, path)) <= {".note.tmp"}


FULL_DISK = """
writer = CheckpointWriter(path, NOTE)
def post(n):
    done = writer.written + writer.failed + 1
    writer.post(lambda: Checkpoint(Note("", n)), n)
    while writer.written + writer.failed < done:
        time.sleep(0.001)
    print(writer.written, writer.failed, bool(writer.problem), load(path, NOTE)[0].state.n)
post(1)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
post(2)
post(3)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
post(4)
print(writer.close())
"""


def test_a_full_disk_stops_only_the_checkpoints(tmp_path):
    path = tmp_path / "note"
    save(path, BEGUN, NOTE)
    done = run(FULL_DISK, path)
    counts = ["1 0 False 1", "1 1 True 1", "1 2 True 1", "2 2 False 4"]
    assert done.stdout.splitlines() == [*counts, "True"]
    assert done.stderr.count("not written: File too large") == 1
    assert others(tmp_path, path) == []


def test_a_writer_writes_the_newest_and_never_blocks(tmp_path, monkeypatch):
    path = tmp_path / "note"
    begun, go = threading.Event(), threading.Event()

    def slow(*given: object) -> None:
        begun.set()
        assert go.wait(30)
        save(*given)

    monkeypatch.setattr(checkpoint, "save", slow)
    writer = CheckpointWriter(path, NOTE)
    writer.post(lambda: Checkpoint(Note("", 1)), 1)
    assert begun.wait(30)
    for n in range(2, 1000):
        writer.post(lambda n=n: Checkpoint(Note("", n)), n)
    assert not path.exists()
    go.set()
    assert writer.close(30)
    assert load(path, NOTE)[0].state.n == 999
    assert (writer.written, writer.failed, writer.problem) == (2, 0, "")


def test_a_period_is_counted_from_the_last_posted_state(tmp_path):
    writer = CheckpointWriter(tmp_path / "note", NOTE, period_s=1.0)
    at_ns = 10**18
    assert writer.is_due(at_ns)
    writer.post(lambda: BEGUN, 10**18)
    assert [writer.is_due(at_ns + ns) for ns in (0, 999_999_999, 10**9, -(10**9))] == [
        False, False, True, True
    ]  # fmt: skip
    writer.post(lambda: BEGUN, 5)
    assert [writer.is_due(ns) for ns in (6, 10**9 + 5, 10**18)] == [False, True, True]
    writer.close(30)


def test_an_unused_writer_keeps_the_temporary_file_of_others(tmp_path):
    half = tmp_path / ".note.tmp"
    half.write_bytes(WHOLE[:100])
    assert CheckpointWriter(tmp_path / "note", NOTE).close(30)
    assert half.read_bytes() == WHOLE[:100]
    assert others(tmp_path, half) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_an_error_at_the_start(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(CheckpointError, match="Permission denied"):
            CheckpointWriter(tmp_path / "note", NOTE)
    finally:
        tmp_path.chmod(0o700)


def test_a_link_to_another_disk_stays_one(tmp_path):
    (tmp_path / "disk").mkdir()
    link = tmp_path / "note"
    link.symlink_to(tmp_path / "disk" / "note")
    writer = CheckpointWriter(link, NOTE)
    writer.post(lambda: BEGUN, 10**18)
    assert writer.close(30)
    assert link.is_symlink()
    assert same(load(link, NOTE)[0], BEGUN)
