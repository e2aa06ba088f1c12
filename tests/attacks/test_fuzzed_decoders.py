"""Fuzzing of network decoders: each input is decoded or refused in one line.

A decoder allocates no more than the input's size.
"""

from __future__ import annotations

import random
import tracemalloc

import pytest
from decoders import DECODERS, Decoder, lengths_that_lie, mutate, readers_of_payloads
from hypothesis import given
from hypothesis import strategies as st

MUTATIONS = 400_000
SLACK_BYTES = 64 * 1024


def reads_or_refuses(decoder: Decoder, payload: bytes) -> bool:
    """Return True if it was read; an error other than a one-line ValueError fails the test."""
    said = None
    try:
        decoder.reads(payload)
    except ValueError as error:
        said = str(error)
    assert said is None or ("\n" not in said and len(said) < 1000), payload
    return said is None


def test_every_reader_of_payloads_is_here():
    covered = {name for decoder in DECODERS.values() for name in decoder.covers}
    assert covered == readers_of_payloads()


@pytest.mark.parametrize("name", DECODERS)
def test_an_empty_input_is_refused_and_valid_seeds_are_read(name):
    decoder = DECODERS[name]
    assert not reads_or_refuses(decoder, b"")
    assert all(reads_or_refuses(decoder, seed) for seed in decoder.seeds)


@pytest.mark.parametrize("name", DECODERS)
@given(st.binary(max_size=300))
def test_any_bytes(name, payload):
    reads_or_refuses(DECODERS[name], payload)
    reads_or_refuses(DECODERS[name], b"\0\1\0\0" + payload)


@pytest.mark.parametrize("name", DECODERS)
@given(st.randoms(use_true_random=False), st.data())
def test_changed_messages(name, chance, data):
    seed = data.draw(st.sampled_from(DECODERS[name].seeds))
    reads_or_refuses(DECODERS[name], mutate(seed, chance))


@pytest.mark.parametrize("name", DECODERS)
def test_a_false_length_allocates_nothing(name):
    decoder = DECODERS[name]
    lies = [lie for seed in decoder.seeds for lie in lengths_that_lie(seed)]
    for seed in decoder.seeds:  # do not count imports and compilation
        reads_or_refuses(decoder, seed)
    tracemalloc.start()
    try:
        for lie in lies:
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            reads_or_refuses(decoder, lie)
            assert tracemalloc.get_traced_memory()[1] - before < SLACK_BYTES, lie.hex()
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize("name", DECODERS)
def test_hundreds_of_thousands_of_changed_messages(name):
    decoder, chance = DECODERS[name], random.Random(name)
    corpus = list(decoder.seeds)
    read = 0
    rounds = MUTATIONS // len(DECODERS) + 1
    for _ in range(rounds):
        payload = mutate(chance.choice(corpus), chance)
        if reads_or_refuses(decoder, payload):
            read += 1
            # Valid messages reach deeper code than refused ones.
            if len(corpus) < 256 and len(payload) < 4096:
                corpus.append(payload)
    assert 0 < read < rounds
