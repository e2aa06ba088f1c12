"""Fuzzing of recordings: any bytes are read, read in part, or refused in one line."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from decoders import mutate
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import Recording

from edge.errors import UserError
from edge.recording import channels, commands, file, rolling
from edge.recording.channels import Channel
from edge.recording.file import McapReader, McapWriter, RecordedMessage
from edge.recording.reader import MAGIC
from edge.recording.replay import replay
from edge.recording.session import RecordedRun

MANY = 3000
ODD: tuple[Any, ...] = (
    None, True, -1, 0, 10**30, 1.5, float("inf"), float("nan"), "", "null", "a\nb", [], {}, [[]],
    {"": 0}, [10**9, 10**9], "<f8", "|O", "<U9",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("fuzzed")


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rolling, "SYNC_S", 1e-9)
        return Recording(tmp_path_factory.mktemp("run"), rgb_hz=100.0).steps(4).close()


def reads_or_refuses(read: Callable[[], object]) -> bool:
    """Return True if it was read; an error other than a one-line UserError fails the test."""
    try:
        read()
    except UserError as error:
        said = str(error)
        assert "\n" not in said
        assert len(said) < 1000
        return False
    return True


def look_at(path: Path) -> list[bool]:
    """All that is done with a recording but to replay it."""
    out = path.with_name("whole.mcap")
    out.unlink(missing_ok=True)
    return [
        reads_or_refuses(lambda: list(RecordedRun(path).steps())),
        reads_or_refuses(lambda: commands.spans_of(path)),
        reads_or_refuses(lambda: file.recover(path, out)),
    ]


def rewritten(run: Path, path: Path, change: Callable[[int, RecordedMessage], bytes]) -> Path:
    """Rewrite the run with each payload as `change` returns it, with valid checksums."""
    reading = McapReader(run)
    messages = list(reading)
    schemas = {schema.name: schema for schema in reading.schemas.values()}
    with McapWriter(path, "lz4", reading.metadata) as out:
        for k, m in enumerate(messages):
            schema = schemas[m.schema]
            channel = Channel(
                m.topic, m.encoding, m.schema, schema.encoding, schema.data.decode()
            )  # fmt: skip
            out.add(channel, m.log_ns, m.stamp_ns, change(k, m), sequence=m.sequence)
    return path


def bent(said: Any, chance: random.Random) -> Any:
    """JSON with something odd in one place, or without it."""
    if not isinstance(said, (dict, list)) or not said or chance.random() < 0.1:
        return chance.choice(ODD)
    key = chance.choice(list(said)) if isinstance(said, dict) else chance.randrange(len(said))
    if chance.random() < 0.1:
        del said[key]
    else:
        said[key] = bent(said[key], chance)
    return said


def change_one(run: Path, path: Path, chance: random.Random, topics: set[str]) -> None:
    at = [k for k, m in enumerate(McapReader(run)) if m.topic in topics]
    chosen = chance.choice(at)

    def change(k: int, m: RecordedMessage) -> bytes:
        if k != chosen:
            return m.payload
        if m.encoding != "json" or chance.random() < 0.3:
            return bytes(mutate(m.payload, chance))
        return json.dumps(bent(json.loads(m.payload), chance)).encode()

    rewritten(run, path, change)


def replayed(path: Path) -> bool:
    def read() -> None:
        session = RecordedRun(path)
        commands.format_result(session, replay(session))

    return reads_or_refuses(read)


def test_an_empty_file_is_refused_and_a_whole_one_read(folder, run):
    empty = folder / "edge-empty.mcap"
    empty.write_bytes(b"")
    assert look_at(empty) == [False] * 3
    assert look_at(run) == [True] * 3
    same = rewritten(run, folder / "edge-same.mcap", lambda k, m: m.payload)
    assert list(McapReader(same)) == list(McapReader(run))
    assert replayed(same)


@given(st.binary(max_size=300))
def test_any_bytes(folder, content):
    path = folder / "edge-any.mcap"
    for begin in (b"", MAGIC):
        path.write_bytes(begin + content)
        look_at(path)


@given(st.randoms(use_true_random=False))
def test_changed_files(folder, run, chance):
    path = folder / "edge-changed.mcap"
    path.write_bytes(mutate(run.read_bytes(), chance))
    look_at(path)


BESIDE = {c.topic for c in (channels.DEPTH, channels.PICTURE, channels.LATENCY, channels.SPANS)}


@given(st.randoms(use_true_random=False))
def test_changed_messages(folder, run, chance):
    path = folder / "edge-messages.mcap"
    change_one(run, path, chance, BESIDE | {channels.JOURNAL.topic})
    look_at(path)


@settings(max_examples=15)
@given(st.randoms(use_true_random=False))
def test_changed_journals_are_replayed_or_refused(folder, run, chance):
    path = folder / "edge-journal.mcap"
    change_one(run, path, chance, {channels.JOURNAL.topic})
    replayed(path)


@pytest.mark.slow
def test_thousands_of_changed_recordings(folder, run):
    chance, read = random.Random(0), 0
    whole, path = run.read_bytes(), folder / "edge-many.mcap"
    for k in range(MANY):
        if k % 3:
            change_one(run, path, chance, BESIDE | {channels.JOURNAL.topic})
        else:
            path.write_bytes(mutate(whole, chance))
        read += sum(look_at(path))
        if k % 30 == 0:
            replayed(path)
    assert 0 < read < 3 * MANY
