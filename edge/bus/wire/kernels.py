"""Numba kernels of the codecs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from edge.jit import jit

U0, U1, U2 = np.uintp(0), np.uintp(1), np.uintp(2)  # unsigned indices, see `cloud_points`
INF = np.uint32(0x7F800000)  # a float32's exponent bits, all set: so they are in NaN and inf


def _make_load(data: Any, at: Any, word: Any, bits: int) -> Any:
    """Return the type and the code of an intrinsic that loads one unsigned number of these bits."""

    def load(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # In C: *(uintN_t *)&data[at]
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = builder.gep(array.data, [args[1]])
        return builder.load(builder.bitcast(place, ir.IntType(bits).as_pointer()), align=1)

    return word(data, at), load


@intrinsic
def _load_uint32(typing: Any, data: Any, at: Any) -> Any:
    """Load four bytes of a uint8 array, `data[at : at + 4]`, as a uint32, at any alignment.

    Four single loads would be three times as slow.
    """
    return _make_load(data, at, types.uint32, 32)


@intrinsic
def _load_uint16(typing: Any, data: Any, at: Any) -> Any:
    """Load two bytes of a uint8 array as a uint16, like `_load_uint32`."""
    return _make_load(data, at, types.uint16, 16)


@jit(inline="always")
def _swap_bytes(word: int) -> int:
    """Return a uint32 with its bytes in reverse order."""
    return (
        (word >> np.uint32(24))
        | ((word >> np.uint32(8)) & np.uint32(0xFF00))
        | ((word & np.uint32(0xFF00)) << np.uint32(8))
        | (word << np.uint32(24))
    )


@jit
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
    """Copy the points of a cloud that have no NaN or inf, at any alignment, in their order.

    Args:
        data: (n,) uint8 payload, read-only.
        begin: offset of the first point.
        height: rows of the cloud.
        width: points in a row.
        row_step: bytes from row to row.
        point_step: bytes from point to point.
        offsets: offsets of x, y and z in a point, in bytes.
        big_endian: True to swap bytes.
        out: (cap, 3) float32 points viewed as uint32. `cap` must be at least height * width; the
            cloud must be inside `data`.

    Returns:
        The number of points written.
    """
    kept = U0  # a point that is not kept is overwritten by the next
    # Unsigned indices: numba checks signed ones for negative values at each load.
    x_at, y_at, z_at = np.uintp(offsets[0]), np.uintp(offsets[1]), np.uintp(offsets[2])
    step = np.uintp(point_step)
    for row in range(height):
        at = np.uintp(begin + row * row_step)
        for _ in range(width):
            x, y, z = (
                _load_uint32(data, at + x_at),
                _load_uint32(data, at + y_at),
                _load_uint32(data, at + z_at),
            )
            if big_endian:
                x, y, z = _swap_bytes(x), _swap_bytes(y), _swap_bytes(z)
            out[kept, U0] = x
            out[kept, U1] = y
            out[kept, U2] = z
            finite = ((x & INF) != INF) & ((y & INF) != INF) & ((z & INF) != INF)
            kept += np.uintp(finite)
            at += step
    return int(kept)


@jit
def scan_points(
    ranges_m: np.ndarray,
    angle_min_rad: float,
    angle_increment_rad: float,
    range_min_m: float,
    range_max_m: float,
    free_m: float,
    out_m: np.ndarray,
) -> int:
    """Write the hits of a planar scan as points (x, y, 0); return the number of rows written.

    Args:
        ranges_m: (n,) float32.
        angle_min_rad: angle of the first beam.
        angle_increment_rad: angle between beams.
        range_min_m: shorter ranges are invalid.
        range_max_m: ranges from here on, and +inf, are beams without a hit.
        free_m: write a beam without a hit as (x, y, inf), with (x, y, 0) at this range. 0: skip
            these beams.
        out_m: (cap, 3) float32; `cap` must be at least n.
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


@jit
def depth_of_integers(
    data: np.ndarray,
    begin: int,
    row_step: int,
    big_endian: bool,
    unit_m: float,
    least_invalid: int,
    out_m: np.ndarray,
) -> None:
    """Convert 16-bit depth, at any alignment, to metres.

    Args:
        data: (n,) uint8, read-only.
        begin: offset of the first pixel.
        row_step: bytes from row to row.
        big_endian: True to swap bytes.
        unit_m: float32, metres per unit.
        least_invalid: uint16; values from here on become 0.
        out_m: (h, w) float32.
    """
    for v in range(out_m.shape[0]):
        at = np.uintp(begin + v * row_step)
        for u in range(out_m.shape[1]):
            units = _load_uint16(data, at + U2 * np.uintp(u))
            if big_endian:
                units = np.uint16((units >> np.uint16(8)) | (units << np.uint16(8)))
            metres = np.float32(units) * unit_m
            out_m[v, u] = metres if units < least_invalid else np.float32(0.0)


@jit
def exact_millimetres(depth_m: np.ndarray, out_mm: np.ndarray) -> bool:
    """Return True if all depth is an exact multiple of 1 mm, as from a depth camera.

    Args:
        depth_m: (n,) float32.
        out_mm: (n,) uint16, written: millimetres. If exact, depth_m is out_mm * float32(0.001).
    """
    others = 0  # values that are no multiple
    for i in range(len(depth_m)):  # without a branch, so that it is vectorized by eight
        mm = np.int32(depth_m[i] * np.float32(1000.0) + np.float32(0.5)) & np.int32(0xFFFF)
        others += np.float32(mm) * np.float32(0.001) != depth_m[i]
        out_mm[i] = mm
    return others == 0
