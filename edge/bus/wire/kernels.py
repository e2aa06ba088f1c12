"""Numba kernels of the codecs. They know arrays only."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

U0, U1, U2 = np.uintp(0), np.uintp(1), np.uintp(2)
INF = np.uint32(0x7F800000)  # a float32's exponent of NaN and inf


def _loaded(data: Any, at: Any, word: Any, bits: int) -> Any:
    def load(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = builder.gep(array.data, [args[1]])
        return builder.load(builder.bitcast(place, ir.IntType(bits).as_pointer()), align=1)

    return word(data, at), load


@intrinsic
def _word(typing: Any, data: Any, at: Any) -> Any:
    """Four bytes of a uint8 array as a uint32, wherever they lie: `data[at : at + 4]`.

    Put together from four loads it would cost three times as much.
    """
    return _loaded(data, at, types.uint32, 32)


@intrinsic
def _half(typing: Any, data: Any, at: Any) -> Any:
    """Two bytes of a uint8 array as a uint16, like `_word`."""
    return _loaded(data, at, types.uint16, 16)


@njit(nogil=True, cache=True, inline="always")
def _swapped(word: int) -> int:
    return (
        (word >> np.uint32(24))
        | ((word >> np.uint32(8)) & np.uint32(0xFF00))
        | ((word & np.uint32(0xFF00)) << np.uint32(8))
        | (word << np.uint32(24))
    )


@njit(nogil=True, cache=True)
def cloud_points(
    data: np.ndarray,
    begin: int,
    height: int,
    width: int,
    row_step: int,
    point_step: int,
    offsets: tuple[int, int, int],
    big_endian: bool,
    out: np.ndarray,
) -> int:
    """The points without NaN or inf of a cloud in `data` (n,) uint8, which may lie at any byte.

    Args:
        out: (cap, 3) float32 points as uint32; `cap` is at least height * width, and all of the
            cloud lies inside `data`.

    Returns:
        How many there are; their order is kept.
    """
    kept = U0
    # Indices without a sign: with one, each might count from the end, and each load asks.
    x_at, y_at, z_at = np.uintp(offsets[0]), np.uintp(offsets[1]), np.uintp(offsets[2])
    step = np.uintp(point_step)
    for row in range(height):
        at = np.uintp(begin + row * row_step)
        for _ in range(width):
            x, y, z = _word(data, at + x_at), _word(data, at + y_at), _word(data, at + z_at)
            if big_endian:
                x, y, z = _swapped(x), _swapped(y), _swapped(z)
            out[kept, U0] = x
            out[kept, U1] = y
            out[kept, U2] = z
            finite = ((x & INF) != INF) & ((y & INF) != INF) & ((z & INF) != INF)
            kept += np.uintp(finite)
            at += step
    return int(kept)


@njit(nogil=True, cache=True)
def scan_points(
    ranges_m: np.ndarray,
    angle_min_rad: float,
    angle_increment_rad: float,
    range_min_m: float,
    range_max_m: float,
    free_m: float,
    out_m: np.ndarray,
) -> int:
    """Write the beams of a planar scan that hit something as points (x, y, 0).

    Args:
        free_m: a beam that read `range_max_m` or more, or +inf, met nothing so far: it is written
            as (x, y, inf), its end being (x, y, 0). 0: such beams are left out.
        out_m: (cap, 3) float32.

    Returns:
        How many rows were written; `cap` must be at least the number of beams.
    """
    n = 0
    for i in range(ranges_m.shape[0]):
        r, z = ranges_m[i], np.float32(0.0)
        if not r >= range_min_m:
            continue
        if r >= range_max_m:
            if free_m <= 0.0:
                continue
            r, z = np.float32(free_m), np.float32(np.inf)
        angle = angle_min_rad + i * angle_increment_rad
        out_m[n, 0] = r * math.cos(angle)
        out_m[n, 1] = r * math.sin(angle)
        out_m[n, 2] = z
        n += 1
    return n


@njit(nogil=True, cache=True)
def depth_of_integers(
    data: np.ndarray,
    begin: int,
    row_step: int,
    big_endian: bool,
    unit_m: float,
    least_invalid: int,
    out_m: np.ndarray,
) -> None:
    """Write 16-bit depth, which may lie at any byte of `data` (n,) uint8, as metres.

    Args:
        unit_m: float32, metres of one step.
        least_invalid: uint16; from here on numbers measure nothing and become 0.
        out_m: (h, w) float32.
    """
    for v in range(out_m.shape[0]):
        at = np.uintp(begin + v * row_step)
        for u in range(out_m.shape[1]):
            steps = _half(data, at + U2 * np.uintp(u))
            if big_endian:
                steps = np.uint16((steps >> np.uint16(8)) | (steps << np.uint16(8)))
            metres = np.float32(steps) * unit_m
            out_m[v, u] = metres if steps < least_invalid else np.float32(0.0)


@njit(nogil=True, cache=True)
def exact_millimetres(depth_m: np.ndarray, out_mm: np.ndarray) -> bool:
    """Whether depth is exactly so many thousandths of a metre everywhere, as a camera's is.

    Args:
        depth_m: (n,) float32.
        out_mm: (n,) uint16, so many: times float32(0.001) they are `depth_m`, where it is.
    """
    others = 0
    for i in range(len(depth_m)):  # without a branch it is done eight pixels at a time
        mm = np.int32(depth_m[i] * np.float32(1000.0) + np.float32(0.5)) & np.int32(0xFFFF)
        others += np.float32(mm) * np.float32(0.001) != depth_m[i]
        out_mm[i] = mm
    return others == 0


def warmup() -> None:
    """Compile the kernels for what the codecs hand them (a payload is read-only)."""
    exact_millimetres(np.zeros(1, np.float32), np.zeros(1, np.uint16))
    points_m = np.zeros((2, 3), np.float32)
    ranges_m = np.frombuffer(bytes(8), np.float32)
    cloud = np.frombuffer(bytes(24), np.uint8)
    depth_m = np.zeros((1, 1), np.float32)
    depth_of_integers(cloud, 0, 2, False, np.float32(1.0), np.uint16(1), depth_m)
    cloud_points(cloud, 0, 1, 2, 24, 12, (0, 4, 8), False, points_m.view(np.uint32))
    scan_points(ranges_m, 0.0, 0.1, 0.1, 1.0, 1.0, points_m)
