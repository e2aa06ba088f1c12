"""Checkpoints: whole or not there, whatever kills their writer and whatever befalls the file."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.loop import place_file
from edge.mission import checkpoint, saved
from edge.mission.checkpoint import (
    CheckpointError,
    CheckpointWriter,
    Loaded,
    load,
    save,
)
from edge.mission.saved import Saved, decode, encode

BEGUN = Saved(
    instruction="first the chair, then the tv",
    formula='F (chair & F "tv stand")',
    backend="grammar",
    english="reach the chair, then the tv stand",
    word=("", "chair"),
    reached=("chair",),
    failed=(),
    detected=("tv stand",),
    target="tv stand",
    phase="approaching",
    reason="é: the cheapest",
    paused=False,
    elapsed_s=12.5,
    path_m=3.25,
    id="1f.2",
)
EMPTY = Saved("", "F a", "ltl", "", (), (), (), (), None, "starting", "", False, 0.0, 0.0)

floats = st.floats(allow_nan=False, allow_infinity=False)
words = st.sampled_from(["chair", "tv stand"])
states = st.builds(
    Saved, instruction=st.text(), formula=st.just(BEGUN.formula), backend=st.text(max_size=20),
    english=st.text(), word=st.lists(words | st.just("")).map(tuple),
    reached=st.lists(words).map(tuple), failed=st.lists(words).map(tuple),
    detected=st.lists(words).map(tuple), target=st.none() | words, phase=st.text(max_size=20),
    reason=st.text(), paused=st.booleans(), elapsed_s=st.floats(0, 1e9), path_m=st.floats(0, 1e9),
    id=st.text(max_size=64),
)  # fmt: skip


BEGINS = saved.FILE.begins


def others(folder: Path, path: Path) -> list[str]:
    return sorted(found.name for found in folder.iterdir() if found != path)


def decoded(content: bytes) -> tuple[Saved | None, str]:
    """The state, or what is wrong."""
    try:
        return decode(content), ""
    except ValueError as error:
        return None, str(error)


def test_no_file_is_no_problem(tmp_path):
    assert load(tmp_path / "mission.json") == Loaded(None, "")
    assert others(tmp_path, tmp_path) == []


@pytest.mark.parametrize("state", [EMPTY, BEGUN, replace(BEGUN, target=None)])
def test_what_is_saved_is_loaded(tmp_path, state):
    path = tmp_path / "mission.json"
    save(path, EMPTY)
    save(path, state)
    assert load(path) == Loaded(state, "")
    assert others(tmp_path, path) == []
    assert json.loads(path.read_bytes())["version"] == 2


@given(states)
def test_every_state_comes_back_as_it_was(state):
    assert decode(encode(state)) == state


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"elapsed_s": float("nan")}, "elapsed_s"),
        ({"path_m": float("inf")}, "path_m"),
        ({"path_m": -1.0}, "path_m"),
        ({"formula": "F ("}, "formula"),
        ({"formula": "("}, "formula"),
        ({"word": ("sofa",)}, "word: 'sofa' is not in the formula"),
        ({"reached": ("",)}, "reached: '' is not in the formula"),
        ({"failed": ("sofa",)}, "failed"),
        ({"detected": ("sofa",)}, "detected"),
        ({"target": "sofa"}, "target: 'sofa' is not in the formula"),
        ({"instruction": "x" * saved.MAX_BYTES}, "at most"),
    ],
)  # fmt: skip
def test_a_state_that_could_not_be_loaded_is_not_saved(tmp_path, change, text):
    path = tmp_path / "mission.json"
    save(path, BEGUN)
    with pytest.raises(ValueError, match=text) as caught:
        save(path, replace(BEGUN, **change))
    assert "\n" not in str(caught.value)
    assert load(path).saved == BEGUN


def as_file(mission: dict | list | str, version: int = 2) -> bytes:
    """A file whose checksum is right, whatever is in it."""
    body = json.dumps(mission, separators=(",", ":")).encode()
    digest = hashlib.sha256(body).hexdigest()
    head = f'{{"format":"edge-mission","version":{version},"sha256":"{digest}","mission":'
    return head.encode() + body + b"}\n"


def mission(**changes: object) -> dict:
    return {**json.loads(encode(BEGUN))["mission"], **changes}


def test_the_files_of_the_table_below_are_taken_when_nothing_is_wrong_with_them():
    assert decode(as_file(mission())) == BEGUN


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (BEGINS, "not a whole checkpoint"),
        (encode(BEGUN)[:-1], "not a whole checkpoint"),
        (encode(BEGUN)[:300], "not a whole checkpoint"),
        (encode(BEGUN) + b"\n", "not a whole checkpoint"),
        (encode(BEGUN).replace(b"12.5", b"13.5"), "checksum"),
        (encode(BEGUN).replace(b'"version":2', b'"version":1'), "version 1, this program reads 2"),
        (BEGINS + b" " * saved.MAX_BYTES, "more than"),
        (as_file([]), "mission"),
        (as_file("text"), "mission"),
        (as_file({}), "instruction"),
        (as_file(mission(extra=1)), "extra"),
        (as_file(mission(paused=1)), "paused"),
        (as_file(mission(elapsed_s=float("nan"))), "elapsed_s"),
        (as_file(mission(elapsed_s=float("inf"))), "elapsed_s"),
        (as_file(mission(elapsed_s="1")), "elapsed_s"),
        (as_file(mission(pose=[1, 2, 3])), "pose"),
        (as_file(mission(word="chair")), "word"),
        (as_file(mission(word=["sofa"])), "word"),
        (as_file(mission(word=["chair"] * 10_001)), "word"),
        (as_file(mission(formula="F (")), "formula"),
    ],
)  # fmt: skip
def test_a_checkpoint_that_is_of_no_use_is_set_aside_and_reported(tmp_path, caplog, content, text):
    path = tmp_path / "mission.json"
    path.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        loaded = load(path)
    assert loaded.saved is None
    assert text.replace("\\", "") in loaded.problem
    assert str(path) in loaded.problem
    assert "mission.json.damaged-1" in loaded.problem
    assert "\n" not in loaded.problem
    assert caplog.messages == [loaded.problem]
    assert not path.exists()
    assert (tmp_path / "mission.json.damaged-1").read_bytes() == content
    assert load(path) == Loaded(None, "")


@pytest.mark.parametrize("use", [load, CheckpointWriter])
@pytest.mark.parametrize(
    "content",
    [b"", b"{}", b"\0" * 5000, b"alias ll='ls -l'\n", place_file.FILE.begins, b" " + BEGINS],
)
def test_a_file_of_somebody_else_is_refused_and_left_alone(tmp_path, use, content):
    path = tmp_path / ".bashrc"
    path.write_bytes(content)
    with pytest.raises(CheckpointError) as error:
        use(path)
    assert str(error.value) == (
        f"mission.checkpoint: {path}: not a checkpoint of a mission, and left as it is; name "
        "another file, or move this one away"
    )
    assert [p.name for p in tmp_path.iterdir()] == [".bashrc"]
    assert path.read_bytes() == content


def test_what_was_set_aside_before_is_left_alone(tmp_path):
    path = tmp_path / "mission.json"
    for n in range(1, 4):
        path.write_bytes(BEGINS + b"%d" % n)
        load(path)
    kept = [(tmp_path / f"mission.json.damaged-{n}").read_bytes() for n in range(1, 4)]
    assert kept == [BEGINS + b"%d" % n for n in range(1, 4)]
    save(path, BEGUN)
    assert load(path).saved == BEGUN


@given(st.data())
def test_damage_anywhere_is_told_or_harmless(data):
    whole = encode(BEGUN)
    at = data.draw(st.integers(0, len(whole) - 1))
    kind = data.draw(st.sampled_from(["cut", "flip", "zeros", "twice", "insert"]))
    damaged = {
        "cut": whole[:at],
        "flip": whole[:at]
        + bytes([whole[at] ^ 1 << data.draw(st.integers(0, 7))])
        + whole[at + 1 :],
        "zeros": whole[:at] + bytes(len(whole) - at),
        "twice": whole[:at] + whole[at // 2 :],
        "insert": whole[:at] + data.draw(st.binary(min_size=1, max_size=9)) + whole[at:],
    }[kind]
    state, problem = decoded(damaged)
    assert problem or state == BEGUN
    assert "\n" not in problem


@given(st.binary(max_size=300))
def test_any_bytes_are_no_checkpoint(content):
    with pytest.raises(ValueError, match="not a whole"):
        decode(content)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda x: st.lists(x, max_size=4) | st.dictionaries(st.text(max_size=5), x, max_size=4),
)


@given(st.sampled_from(sorted(mission())), json_values)
def test_any_value_in_any_field_is_a_state_or_a_value_error(name, value):
    content = as_file(mission(**{name: value}))
    state, problem = decoded(content)
    assert "\n" not in problem
    assert problem or decode(encode(state)) == state


@pytest.mark.parametrize("n", [10, 100_000])
def test_a_deep_nest_is_a_value_error(n):
    body = b"[" * n + b"]" * n
    digest = hashlib.sha256(body).hexdigest().encode()
    head = b'{"format":"edge-mission","version":2,"sha256":"' + digest + b'","mission":'
    with pytest.raises(ValueError, match="mission"):
        decode(head + body + b"}\n")


@pytest.mark.parametrize("use", [load, CheckpointWriter])
@pytest.mark.parametrize("name", ["folder", "pipe", "loop"])
def test_what_is_there_but_no_file_is_the_users_to_mend(tmp_path, use, name):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(CheckpointError, match=f"{name}: .*; name a file in a folder") as caught:
        use(tmp_path / name)
    assert "\n" not in str(caught.value)


KILLED = """
import os, random, signal, sys, time
from dataclasses import replace
from pathlib import Path
from edge.mission.checkpoint import load, save
path, chance = Path(sys.argv[1]), random.Random(3)
for life in range(30):
    state = load(path).saved
    if (child := os.fork()) == 0:
        signal.alarm(60)  # should the parent fail, this one must not write for ever
        n = int(state.path_m)
        while True:
            n += 1
            save(path, replace(state, path_m=float(n), english="x" * (1 + n % 200) * 1000))
    while life == 0 and load(path).saved.path_m == state.path_m:
        assert os.waitpid(child, os.WNOHANG) == (0, 0), "the writer ended by itself"
    time.sleep(chance.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    loaded = load(path)
    print(loaded.problem or "whole", int(loaded.saved.path_m), len(loaded.saved.english))
"""


def test_kill_9_leaves_a_whole_checkpoint(tmp_path):
    path = tmp_path / "mission.json"
    save(path, replace(BEGUN, path_m=0.0))
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(path)], capture_output=True, text=True, check=True
    )
    lives = [line.split() for line in done.stdout.splitlines()]
    written = [int(n) for _, n, _ in lives]
    assert [word for word, _, _ in lives] == ["whole"] * 30
    assert written == sorted(written)
    assert written[-1] > 0
    assert all(int(size) == 1000 * (1 + int(n) % 200) for _, n, size in lives if int(n))
    assert set(others(tmp_path, path)) <= {".mission.json.tmp"}


FULL_DISK = """
import resource, sys, time
from dataclasses import replace
from pathlib import Path
from edge.mission.checkpoint import CheckpointWriter, load
path = Path(sys.argv[1])
state = load(path).saved
writer = CheckpointWriter(path)
def post(n):
    done = writer.written + writer.failed + 1
    writer.post(lambda state=state, n=n: replace(state, path_m=float(n)), n)
    while writer.written + writer.failed < done:
        time.sleep(0.001)
    print(writer.written, writer.failed, bool(writer.problem), int(load(path).saved.path_m))
post(1)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
post(2)
post(3)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
post(4)
print(writer.close())
"""


def test_a_disk_that_fills_up_costs_only_the_checkpoints(tmp_path):
    path = tmp_path / "mission.json"
    save(path, BEGUN)
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)], capture_output=True, text=True, check=True
    )
    counts = ["1 0 False 1", "1 1 True 1", "1 2 True 1", "2 2 False 4"]
    assert done.stdout.splitlines() == [*counts, "True"]
    assert done.stderr.count("not written: File too large") == 1
    assert others(tmp_path, path) == []


def test_a_writer_writes_the_newest_and_never_blocks(tmp_path, monkeypatch):
    path = tmp_path / "mission.json"
    begun, go = threading.Event(), threading.Event()

    def slow(*given: object) -> None:
        begun.set()
        assert go.wait(30)
        save(*given)

    monkeypatch.setattr(checkpoint, "save", slow)
    writer = CheckpointWriter(path)
    writer.post(lambda: replace(BEGUN, path_m=1.0), 1)
    assert begun.wait(30)
    for n in range(2, 1000):
        writer.post(lambda n=n: replace(BEGUN, path_m=float(n)), n)
    assert not path.exists()
    go.set()
    assert writer.close(30)
    assert load(path).saved.path_m == 999
    assert (writer.written, writer.failed, writer.problem) == (2, 0, "")


def test_a_writer_that_is_closed_unused_writes_nothing(tmp_path):
    assert CheckpointWriter(tmp_path / "mission.json").close(30)
    assert others(tmp_path, tmp_path) == []


def test_a_writer_counts_a_state_that_cannot_be_saved(tmp_path, caplog):
    writer = CheckpointWriter(tmp_path / "mission.json")
    writer.post(lambda: replace(BEGUN, target="sofa"), 1)
    assert writer.close(30)
    assert (writer.written, writer.failed) == (0, 1)
    assert "sofa" in writer.problem
    assert len(caplog.messages) == 1


def test_a_period_is_counted_from_the_last_posted_state(tmp_path):
    writer = CheckpointWriter(tmp_path / "mission.json", period_s=1.0)
    at_ns = 10**18
    assert writer.due(at_ns)
    writer.post(lambda: BEGUN, 10**18)
    assert [writer.due(at_ns + ns) for ns in (0, 999_999_999, 10**9, -(10**9))] == [
        False, False, True, True
    ]  # fmt: skip
    writer.post(lambda: BEGUN, 5)
    assert [writer.due(ns) for ns in (6, 10**9 + 5, 10**18)] == [False, True, True]
    writer.close(30)


@pytest.mark.parametrize("name", ["missing/mission.json", "file/mission.json"])
def test_a_place_that_cannot_be_written_is_an_error_at_the_start(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(CheckpointError, match=r"mission\.checkpoint: .*name a file in") as caught:
        CheckpointWriter(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_another_process_may_check_the_place_while_a_service_writes_there(tmp_path):
    half = tmp_path / ".mission.json.tmp"
    half.write_bytes(encode(BEGUN)[:100])
    assert CheckpointWriter(tmp_path / "mission.json").close(30)
    assert half.read_bytes() == encode(BEGUN)[:100]
    assert others(tmp_path, half) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_an_error_at_the_start(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(CheckpointError, match="Permission denied"):
            CheckpointWriter(tmp_path / "mission.json")
    finally:
        tmp_path.chmod(0o700)


def test_a_link_to_another_disk_stays_one(tmp_path):
    (tmp_path / "disk").mkdir()
    link = tmp_path / "mission.json"
    link.symlink_to(tmp_path / "disk" / "mission.json")
    writer = CheckpointWriter(link)
    writer.post(lambda: BEGUN, 10**18)
    assert writer.close(30)
    assert link.is_symlink()
    assert load(link).saved == BEGUN
