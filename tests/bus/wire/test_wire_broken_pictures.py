"""Broken images for OpenCV: each is read, or raises a one-line DecodeError.

None takes much memory. `tests/attacks/test_fuzzed_decoders.py` covers other decoders.
"""

from __future__ import annotations

import ctypes
import random
import resource
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from test_wire_compressed import BGR, DEPTH_MM, picture, ros

from edge.bus.wire import DecodeError
from edge.bus.wire.compressed import decode_compressed_header, decode_compressed_into

PICTURES = 20_000
MOST_MB = 300.0  # OpenCV allocates the size that a chunk declares


def mutated(payload: bytes, rng: random.Random) -> bytes:
    """With some bytes changed, a piece doubled or left out, or the end cut off."""
    data = bytearray(payload)
    for _ in range(rng.randint(1, 4)):
        data[rng.randrange(len(data))] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
    kind = rng.randrange(8)
    at = rng.randrange(len(data))
    if kind == 0:
        del data[at:]
    elif kind == 1:
        del data[at : at + rng.randrange(16)]
    elif kind == 2:
        data[at:at] = data[at : at + rng.randrange(16)]
    return bytes(data)


def hold(decode, payloads: list[bytes], n: int) -> None:
    rng = random.Random(1)
    for i in range(n):
        said = ""
        try:
            decode(mutated(payloads[i % len(payloads)], rng))
        except DecodeError as error:
            said = str(error)
        assert "\n" not in said


@pytest.mark.parametrize("threads", [1, 8])
def test_decoders_print_nothing_but_others_can(capfd, threads):
    """libpng and libjpeg print to C's stderr; two lines for each picture fill a disk."""
    payloads = [ros("jpeg", picture(".jpg", BGR)), ros("png", picture(".png", BGR))]

    def decode(payload: bytes) -> None:
        out = np.zeros((30, 20, 3), np.uint8)
        decode_compressed_into(payload, decode_compressed_header(payload), out)

    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(hold, decode, payloads, 500) for _ in range(threads)]:
            done.result()
    assert capfd.readouterr().err == ""
    ctypes.CDLL(None).perror(b"a library")
    print("a log", file=sys.stderr)
    assert [line.split(":")[0] for line in capfd.readouterr().err.splitlines()] == [
        "a library", "a log",
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("words", ["jpeg", "png", "16UC1; png"])
def test_broken_pictures(words):
    kind, array = (".jpg", BGR) if words == "jpeg" else (".png", BGR)
    out = np.zeros((30, 20, 3), np.uint8)
    if words == "16UC1; png":
        array, out = DEPTH_MM, np.zeros((30, 20), np.float32)

    def decode(payload: bytes) -> None:
        decode_compressed_into(payload, decode_compressed_header(payload), out)

    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    hold(decode, [ros(words, picture(kind, array))], PICTURES)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3 < before_mb + MOST_MB
