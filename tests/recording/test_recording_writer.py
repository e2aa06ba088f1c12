"""What is laid out as MCAP, the library finds its way in: chunks, indexes, summary, checksums."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from edge.recording.writer import CHUNK_BYTES, COMPRESSIONS, Writer


def written(messages, compression="lz4", metadata=None, flush_every=None) -> bytes:
    """A file of two channels; a message is (channel, log_ns, payload in parts)."""
    out = BytesIO()
    writer = Writer(lambda parts: [out.write(part) for part in parts], compression)
    writer.start(metadata or {})
    for topic in ("/a", "/b"):
        writer.register(topic, "json", f"of{topic}", "jsonschema", b"{}")
    for k, (channel, log_ns, payload) in enumerate(messages):
        writer.add(channel, log_ns, log_ns + 1, payload, k)
        if flush_every is not None and k % flush_every == 0:
            writer.flush()
    writer.finish()
    assert writer.at == len(out.getvalue())
    return out.getvalue()


def read(content: bytes, **wanted):
    return [
        (channel.topic, m.log_time, m.publish_time, m.sequence, m.data)
        for _, channel, m in make_reader(BytesIO(content)).iter_messages(**wanted)
    ]


def test_an_empty_file_has_a_summary():
    content = written([], metadata={"edge": {"a": "1"}})
    reader = make_reader(BytesIO(content))
    assert list(reader.iter_messages()) == []
    assert reader.get_summary().statistics.message_count == 0
    assert [m.metadata for m in reader.iter_metadata()] == [{"a": "1"}]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@given(
    said=st.lists(
        st.tuples(
            st.sampled_from([1, 2]),
            st.integers(0, 1000),
            st.lists(st.binary(max_size=50), min_size=1, max_size=3),
        ),
        max_size=12,
    ),
    flush_every=st.sampled_from([None, 1, 3]),
)
def test_the_library_reads_what_was_added(compression, said, flush_every):
    content = written(said, compression, flush_every=flush_every)
    expected = [
        ("/a" if channel == 1 else "/b", ns, ns + 1, k, b"".join(parts))
        for k, (channel, ns, parts) in enumerate(said)
    ]
    by_time = sorted(expected, key=lambda m: m[1])
    assert sorted(read(content)) == sorted(expected)
    assert [m[1] for m in read(content)] == [m[1] for m in by_time]
    assert sorted(read(content, topics="/b")) == sorted(m for m in expected if m[0] == "/b")
    list(StreamReader(BytesIO(content), validate_crcs=True).records)
    counts = make_reader(BytesIO(content)).get_summary().statistics
    assert counts.message_count == sum(counts.channel_message_counts.values()) == len(said)


def test_what_is_larger_than_a_chunk_is_written():
    large = np.arange(2 * CHUNK_BYTES, dtype=np.uint8)
    said = [(1, 1, (b"small",)), (2, 2, (b"head", memoryview(large))), (1, 3, (b"small",))]
    content = written(said, "none")
    assert [m[4] for m in read(content)] == [b"small", b"head" + large.tobytes(), b"small"]
    assert make_reader(BytesIO(content)).get_summary().statistics.chunk_count == 2


def test_a_payload_may_be_written_over_once_it_was_added():
    pixels = np.ones(100, np.uint8)
    out = BytesIO()
    writer = Writer(lambda parts: [out.write(part) for part in parts], "lz4")
    writer.start({})
    channel = writer.register("/a", "json", "a", "jsonschema", b"{}")
    writer.add(channel, 1, 1, (memoryview(pixels),))
    pixels[:] = 7
    writer.finish()
    assert read(out.getvalue())[0][4] == bytes([1]) * 100
