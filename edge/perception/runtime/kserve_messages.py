"""Requests and answers of KServe's inference protocol, version 2, over HTTP.

Tensors go as bytes after the JSON if the server supports it (`binary_tensor_data`, an extension
of Triton's). Otherwise they go as numbers in the JSON, which takes five times the size and time.
https://github.com/kserve/open-inference-protocol
https://github.com/triton-inference-server/server/blob/main/docs/protocol/extension_binary_data.md
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from edge.text import one_line, read_json_object

BINARY = "binary_tensor_data"
"""Name of the extension for tensors as bytes."""
HEADER_LENGTH = "Inference-Header-Content-Length"
"""HTTP header with the length of the JSON, after which the bytes of the tensors begin."""
DTYPES = {"FP32": np.dtype(np.float32), "INT64": np.dtype(np.int64)}
_NAMES = {dtype: name for name, dtype in DTYPES.items()}
_SHOWN = 8  # most names in a message, and most dimensions of a shape

Shape = tuple["int | None", ...]
"""Sizes of a tensor; None: any size."""


def infer_request(
    inputs: Mapping[str, np.ndarray], outputs: Sequence[str], binary: bool
) -> tuple[dict[str, str], bytes]:
    """Build the headers and body of a request."""
    entries: list[dict[str, Any]] = []
    blocks: list[bytes] = []
    for name, array in inputs.items():
        entry = {"name": name, "shape": list(array.shape), "datatype": _NAMES[array.dtype]}
        if binary:
            block = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
            entry["parameters"] = {"binary_data_size": len(block)}
            blocks.append(block)
        else:
            entry["data"] = array.ravel().tolist()
        entries.append(entry)
    wanted = [{"name": name, "parameters": {"binary_data": binary}} for name in outputs]
    head = json.dumps({"inputs": entries, "outputs": wanted}).encode()
    if not binary:
        return {"Content-Type": "application/json"}, head
    headers = {"Content-Type": "application/octet-stream", HEADER_LENGTH: str(len(head))}
    return headers, b"".join((head, *blocks))


def infer_answer(
    body: bytes, header_length: str | None, wanted: Mapping[str, Shape]
) -> dict[str, np.ndarray]:
    """Decode the tensors of an answer.

    Args:
        body: body of the answer.
        header_length: value of the header `HEADER_LENGTH`; None: it is missing.
        wanted: shapes of the float32 outputs to return, by name; other outputs are ignored.

    Returns:
        Float32 arrays by name. Tensors that were sent as bytes are views of the body.

    Raises:
        ValueError: the answer does not fit the request; one line.
    """
    length = len(body) if header_length is None else _length(header_length, len(body))
    answer, at = read_json_object(body[:length]), length  # at: position of the next tensor's bytes
    entries = answer.get("outputs")
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise ValueError("the answer has no list of outputs")
    found: dict[str, np.ndarray] = {}
    for entry in entries:
        name = entry.get("name")
        size = _binary_size(entry)
        block = None if size is None else memoryview(body)[at : at + size]
        at += size or 0
        if at > len(body):
            raise ValueError(f"the answer ends before the bytes of {one_line(name, 40)!r}")
        if isinstance(name, str) and name in wanted:
            if name in found:
                raise ValueError(f"the answer has the output {name!r} twice")
            found[name] = _tensor(entry, block, wanted[name])
    if at != len(body):
        raise ValueError(f"{len(body) - at} bytes of the answer belong to no output")
    if lacking := [name for name in wanted if name not in found]:
        raise ValueError(f"the answer lacks the output {lacking[0]!r}")
    return found


def check_metadata(
    body: bytes, inputs: Mapping[str, tuple[str, Shape]], outputs: Mapping[str, tuple[str, Shape]]
) -> None:
    """Compare a server's metadata of a model with the expected inputs and outputs.

    Servers need not list inputs and outputs; without a list nothing is compared.

    Raises:
        ValueError: the model is another; one line.
    """
    metadata = read_json_object(body)
    for kind, wanted in (("inputs", inputs), ("outputs", outputs)):
        entries = metadata.get(kind)
        entries = entries if isinstance(entries, list) else []
        named = {e["name"]: e for e in entries if isinstance(e, dict) and _is_name(e.get("name"))}
        if not named:
            continue
        shown = ", ".join(one_line(name, 40) for name in list(named)[:_SHOWN])
        for name, (datatype, shape) in wanted.items():
            if name not in named:
                raise ValueError(f"the model has no {name!r} among its {kind} ({shown})")
            entry = named[name]
            sizes = _sizes(entry.get("shape"), allow_any=True)
            if entry.get("datatype") != datatype or not _fits(sizes, shape):
                found_text = f"{one_line(entry.get('datatype'), 20)} {sizes}"
                raise ValueError(
                    f"{name!r} is {found_text}, must be {datatype} {_shape_text(shape)}"
                )


def speaks_binary(body: bytes) -> bool:
    """Return True if the server supports tensors as bytes."""
    extensions = read_json_object(body).get("extensions")
    return isinstance(extensions, list) and BINARY in extensions


def _length(text: str, most: int) -> int:
    """Return the number in the header `HEADER_LENGTH`; raise ValueError if it is invalid."""
    if not (text.isascii() and text.isdigit() and len(text) < 12 and int(text) <= most):
        raise ValueError(
            f"{HEADER_LENGTH} is {one_line(text, 40)!r}, expected 0 to {most}, the bytes there are"
        )
    return int(text)


def _binary_size(entry: dict[str, Any]) -> int | None:
    """Return the number of bytes of an output after the JSON; None if the JSON has its numbers."""
    parameters = entry.get("parameters")
    if not isinstance(parameters, dict) or "binary_data_size" not in parameters:
        return None
    size = parameters["binary_data_size"]
    if not _is_size(size):
        raise ValueError(f"binary_data_size is {one_line(size, 40)}, must be a number of bytes")
    return size


def _tensor(entry: dict[str, Any], block: memoryview | None, wanted: Shape) -> np.ndarray:
    """Return an output as float32, from its bytes or, if `block` is None, from the JSON."""
    name, shape = entry["name"], _sizes(entry.get("shape"))
    if entry.get("datatype") != "FP32":
        kind = one_line(entry.get("datatype"), 40)
        raise ValueError(f"{name!r} has the datatype {kind}, must be FP32")
    if shape is None or not _fits(shape, wanted):
        found_text = one_line(entry.get("shape"), 60)
        raise ValueError(f"{name!r} has the shape {found_text}, must be {_shape_text(wanted)}")
    n = math.prod(shape)
    if block is not None:
        if len(block) != 4 * n:
            raise ValueError(f"{name!r} has {len(block)} bytes, must be {4 * n}")
        return np.frombuffer(block, "<f4").reshape(shape)
    try:
        numbers = np.asarray(entry.get("data"))
    except (ValueError, RecursionError):  # lists of different lengths, or too deep
        raise ValueError(f"the data of {name!r} is not an array of numbers") from None
    if numbers.dtype.kind not in "iuf" or numbers.size != n:
        raise ValueError(f"the data of {name!r} is not {n} numbers")
    with np.errstate(over="ignore"):
        return numbers.astype(np.float32).reshape(shape)


def _sizes(shape: object, allow_any: bool = False) -> tuple[int, ...] | None:
    """Return a shape from JSON; None if it is invalid.

    Args:
        shape: value in the JSON.
        allow_any: True: sizes may be -1, which means any size.
    """
    if not isinstance(shape, list) or len(shape) > _SHOWN:
        return None
    right = all(_is_size(size) or (allow_any and size == -1) for size in shape)
    return tuple(shape) if right else None


def _fits(sizes: tuple[int, ...] | None, wanted: Shape) -> bool:
    """Return True if a shape from JSON is valid and matches the wanted one."""
    return (
        sizes is not None
        and len(sizes) == len(wanted)
        and all(
            want is None or size in (want, -1) for size, want in zip(sizes, wanted, strict=True)
        )
    )


def _is_size(size: object) -> bool:
    """Return True for an integer from 0 to a terabyte; JSON's true is an int in Python."""
    return isinstance(size, int) and not isinstance(size, bool) and 0 <= size < 1 << 40


def _is_name(name: object) -> bool:
    return isinstance(name, str) and name != ""


def _shape_text(shape: Shape) -> str:
    """Return a shape as text for a message; `?` stands for any size."""
    return "[" + ", ".join("?" if size is None else str(size) for size in shape) + "]"
