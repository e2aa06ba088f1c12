"""Checkpoints: whole or not there, whatever kills their writer and whatever befalls the file."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.mission import checkpoint, saved
from edge.mission.checkpoint import (
    CheckpointError,
    CheckpointWriter,
    Loaded,
    continuous,
    load,
    save,
)
from edge.mission.saved import (
    MAX_INSTANCES,
    MAX_POINTS,
    Saved,
    SavedInstance,
    decode,
    encode,
    restore_instance,
    save_instances,
)
from edge.types import Instance

CHAIR = SavedInstance(
    7, "chair", (1.0, 2.0, 0.4), ((1.0, 2.0, 0.4), (1.1, 2.0, 0.5)), 0.5, 3, "seen"
)
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
    pose=(0.1, -0.2, 3.0),
    stamp_ns=10**18,
    odometry_epoch=1,
    instances=(CHAIR,),
    id="1f.2",
)
EMPTY = Saved(
    "", "F a", "ltl", "", (), (), (), (), None, "starting", "", False, 0.0, 0.0, None, 0, 0, ()
)  # fmt: skip

floats = st.floats(allow_nan=False, allow_infinity=False)
metres = st.floats(-1e6, 1e6)
points = st.tuples(metres, metres, metres)
counts = st.integers(0, 2**63 - 1)
words = st.sampled_from(["chair", "tv stand"])
instances = st.builds(
    SavedInstance, id=counts, label=words, center_m=points,
    points_m=st.lists(points, min_size=1, max_size=5).map(tuple), score=st.floats(0, 1),
    hits=counts, state=st.sampled_from(["seen", "confirmed", "refuted", "reached"]),
)  # fmt: skip
states = st.builds(
    Saved, instruction=st.text(), formula=st.just(BEGUN.formula), backend=st.text(max_size=20),
    english=st.text(), word=st.lists(words | st.just("")).map(tuple),
    reached=st.lists(words).map(tuple), failed=st.lists(words).map(tuple),
    detected=st.lists(words).map(tuple), target=st.none() | words, phase=st.text(max_size=20),
    reason=st.text(), paused=st.booleans(), elapsed_s=st.floats(0, 1e9), path_m=st.floats(0, 1e9),
    pose=st.none() | points, stamp_ns=st.integers(-(2**63), 2**63 - 1), odometry_epoch=counts,
    instances=st.lists(instances, max_size=3).map(tuple), id=st.text(max_size=64),
)  # fmt: skip


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


@pytest.mark.parametrize("state", [EMPTY, BEGUN, replace(BEGUN, stamp_ns=-1)])
def test_what_is_saved_is_loaded(tmp_path, state):
    path = tmp_path / "mission.json"
    save(path, EMPTY)
    save(path, state)
    assert load(path) == Loaded(state, "")
    assert others(tmp_path, path) == []
    assert json.loads(path.read_bytes())["version"] == 1


@given(states)
def test_every_state_comes_back_as_it_was(state):
    assert decode(encode(state)) == state


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"elapsed_s": float("nan")}, "elapsed_s"),
        ({"path_m": float("inf")}, "path_m"),
        ({"path_m": -1.0}, "path_m"),
        ({"pose": (0.0, float("nan"), 0.0)}, "pose"),
        ({"stamp_ns": 1 << 63}, "stamp_ns"),
        ({"formula": "F ("}, "formula"),
        ({"formula": "("}, "formula"),
        ({"word": ("sofa",)}, "word: 'sofa' is not in the formula"),
        ({"reached": ("",)}, "reached: '' is not in the formula"),
        ({"failed": ("sofa",)}, "failed"),
        ({"detected": ("sofa",)}, "detected"),
        ({"target": "sofa"}, "target: 'sofa' is not in the formula"),
        ({"instances": (replace(CHAIR, points_m=()),)}, r"instances\.0\.points_m"),
        ({"instances": (replace(CHAIR, center_m=(2e6, 0.0, 0.0)),)}, r"instances\.0\.center_m"),
        ({"instances": (replace(CHAIR, label="-"),)}, r"instances\.0\.label: .*'-' is no name"),
        ({"instances": (replace(CHAIR, score=1.5),)}, r"instances\.0\.score"),
        ({"instances": (CHAIR,) * (MAX_INSTANCES + 1)}, "instances"),
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


def as_file(mission: dict | list | str, version: int = 1) -> bytes:
    """A file whose checksum is right, whatever is in it."""
    body = json.dumps(mission, separators=(",", ":")).encode()
    digest = saved.hashlib.sha256(body).hexdigest()
    head = f'{{"format":"edge-mission","version":{version},"sha256":"{digest}","mission":'
    return head.encode() + body + b"}\n"


def mission(**changes: object) -> dict:
    return {**json.loads(encode(BEGUN))["mission"], **changes}


def test_the_files_of_the_table_below_are_taken_when_nothing_is_wrong_with_them():
    assert decode(as_file(mission())) == BEGUN


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "not a whole checkpoint"),
        (b"{}", "not a whole checkpoint"),
        (b"\0" * 5000, "not a whole checkpoint"),
        (b"\xff\xfe nonsense", "not a whole checkpoint"),
        (encode(BEGUN)[:-1], "not a whole checkpoint"),
        (encode(BEGUN)[:300], "not a whole checkpoint"),
        (encode(BEGUN) + b"\n", "not a whole checkpoint"),
        (encode(BEGUN).replace(b"12.5", b"13.5"), "checksum"),
        (encode(BEGUN).replace(b'"version":1', b'"version":2'), "version 2, this program reads 1"),
        (b" " * (saved.MAX_BYTES + 1), "more than"),
        (as_file([]), "mission"),
        (as_file("text"), "mission"),
        (as_file({}), "instruction"),
        (as_file(mission(extra=1)), "extra"),
        (as_file(mission(paused=1)), "paused"),
        (as_file(mission(stamp_ns=1.5)), "stamp_ns"),
        (as_file(mission(stamp_ns=2**70)), "stamp_ns"),
        (as_file(mission(elapsed_s=float("nan"))), "elapsed_s"),
        (as_file(mission(elapsed_s=float("inf"))), "elapsed_s"),
        (as_file(mission(elapsed_s="1")), "elapsed_s"),
        (as_file(mission(pose=[1, 2])), "pose"),
        (as_file(mission(word="chair")), "word"),
        (as_file(mission(word=["sofa"])), "word"),
        (as_file(mission(word=["chair"] * 10_001)), "word"),
        (as_file(mission(formula="F (")), "formula"),
        (as_file(mission(instances=[{}])), r"instances\.0"),
    ],
)  # fmt: skip
def test_what_is_no_checkpoint_is_set_aside_and_reported(tmp_path, caplog, content, text):
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


def test_what_was_set_aside_before_is_left_alone(tmp_path):
    path = tmp_path / "mission.json"
    for n in range(1, 4):
        path.write_bytes(b"%d" % n)
        load(path)
    kept = [(tmp_path / f"mission.json.damaged-{n}").read_bytes() for n in range(1, 4)]
    assert kept == [b"1", b"2", b"3"]
    save(path, BEGUN)
    assert load(path).saved == BEGUN


@settings(max_examples=200)
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
    digest = saved.hashlib.sha256(body).hexdigest().encode()
    head = b'{"format":"edge-mission","version":1,"sha256":"' + digest + b'","mission":'
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
        n = state.stamp_ns
        while True:
            n += 1
            save(path, replace(state, stamp_ns=n, instances=state.instances[:1] * (1 + n % 200)))
    while life == 0 and load(path).saved.stamp_ns == state.stamp_ns:
        assert os.waitpid(child, os.WNOHANG) == (0, 0), "the writer ended by itself"
    time.sleep(chance.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    loaded = load(path)
    print(loaded.problem or "whole", loaded.saved.stamp_ns, len(loaded.saved.instances))
"""


def test_kill_9_leaves_a_whole_checkpoint(tmp_path):
    path = tmp_path / "mission.json"
    full = replace(CHAIR, points_m=CHAIR.points_m * (MAX_POINTS // 2))
    save(path, replace(BEGUN, stamp_ns=0, instances=(full,)))
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(path)], capture_output=True, text=True, check=True
    )
    lives = [line.split() for line in done.stdout.splitlines()]
    stamps = [int(stamp) for _, stamp, _ in lives]
    assert [word for word, _, _ in lives] == ["whole"] * 30
    assert stamps == sorted(stamps)
    assert stamps[-1] > 0
    assert all(int(n) == 1 + int(stamp) % 200 for _, stamp, n in lives if int(stamp))
    assert set(others(tmp_path, path)) <= {".mission.json.tmp"}


FULL_DISK = """
import resource, sys, time
from dataclasses import replace
from pathlib import Path
from edge.mission.checkpoint import CheckpointWriter, load
path = Path(sys.argv[1])
state = load(path).saved
writer = CheckpointWriter(path)
def post(stamp_ns):
    done = writer.written + writer.failed + 1
    writer.post(lambda state=state, at=stamp_ns: replace(state, stamp_ns=at), stamp_ns)
    while writer.written + writer.failed < done:
        time.sleep(0.001)
    print(writer.written, writer.failed, bool(writer.problem), load(path).saved.stamp_ns)
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

    def slow(path: Path, state: Saved) -> None:
        begun.set()
        assert go.wait(30)
        save(path, state)

    monkeypatch.setattr(checkpoint, "save", slow)
    writer = CheckpointWriter(path)
    writer.post(lambda: replace(BEGUN, stamp_ns=1), 1)
    assert begun.wait(30)
    for n in range(2, 1000):
        writer.post(lambda n=n: replace(BEGUN, stamp_ns=n), n)
    assert not path.exists()
    go.set()
    assert writer.close(30)
    assert load(path).saved.stamp_ns == 999
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
    at_ns = BEGUN.stamp_ns
    assert writer.due(at_ns)
    writer.post(lambda: BEGUN, BEGUN.stamp_ns)
    assert [writer.due(at_ns + ns) for ns in (0, 999_999_999, 10**9, -(10**9))] == [
        False, False, True, True
    ]  # fmt: skip
    writer.post(lambda: BEGUN, 5)
    assert [writer.due(ns) for ns in (6, 10**9 + 5, BEGUN.stamp_ns)] == [False, True, True]
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
    writer.post(lambda: BEGUN, BEGUN.stamp_ns)
    assert writer.close(30)
    assert link.is_symlink()
    assert load(link).saved == BEGUN


def instance(n_points: int, hits: int = 1, number: int = 0) -> Instance:
    points_m = np.random.default_rng(number).normal(size=(n_points, 3)).astype(np.float32)
    score, center_m = np.float32(0.5), points_m.mean(axis=0)
    return Instance(number, "chair", center_m, points_m, score, hits, 1, 2, "refuted")


@pytest.mark.parametrize("n_points", [1, MAX_POINTS, MAX_POINTS + 1, 5000])
def test_an_instance_comes_back_with_fewer_points(n_points):
    before = instance(n_points)
    (kept,) = save_instances([before])
    state = decode(encode(replace(BEGUN, instances=(kept,))))
    after = restore_instance(state.instances[0], 99)
    assert len(after.points_m) == min(n_points, MAX_POINTS)
    assert after.points_m.dtype == after.center_m.dtype == np.float32
    nearest = np.abs(after.points_m[:, None] - before.points_m[None]).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-4
    np.testing.assert_allclose(after.points_m[[0, -1]], before.points_m[[0, -1]], atol=1e-4)
    np.testing.assert_allclose(after.center_m, before.center_m, atol=1e-4)
    assert (after.id, after.label, after.score, after.hits, after.state, after.last_seen_ns) == (
        0, "chair", 0.5, 1, "refuted", 99
    )  # fmt: skip


def test_of_very_many_instances_those_are_kept_that_were_seen_most():
    assert save_instances([]) == ()
    many = [instance(2, hits=n % 300, number=n) for n in range(600)]
    kept = save_instances(many)
    assert len(kept) == MAX_INSTANCES
    assert min(i.hits for i in kept) == 300 - MAX_INSTANCES // 2
    encode(replace(BEGUN, instances=kept))


S = 10**9


@pytest.mark.parametrize(
    ("pose", "after_ns", "expected"),
    [
        ((0.1, -0.2, 0.0), 0, True),
        ((0.1, -0.2, 0.0), 3600 * S, True),
        ((1.1, -0.2, 0.0), 0, True),
        ((1.2, -0.2, 0.0), 0, False),
        ((1.8, -0.2, 0.0), S, True),
        ((2.0, -0.2, 0.0), S, False),
        ((8.5, -0.2, 0.0), 3600 * S, True),
        ((8.7, -0.2, 0.0), 3600 * S, False),
        ((0.1, -0.2, 0.0), -1, False),
        (None, 0, False),
    ],
)
def test_whether_the_frame_is_the_same(pose, after_ns, expected):
    """At 0.5 m/s (0.75 with haste) and a jump of 1.05 m from (0.1, -0.2)."""
    assert continuous(BEGUN, pose, BEGUN.stamp_ns + after_ns, 0.5, 1.05) is expected
    assert not continuous(replace(BEGUN, pose=None), pose, BEGUN.stamp_ns + after_ns, 0.5, 1.05)
