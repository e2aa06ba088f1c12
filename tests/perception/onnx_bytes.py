"""ONNX models as bytes, written by hand: also those that no tool would write."""

from __future__ import annotations

FLOAT, INT64 = 1, 7
EXTERNAL = 1


def varint(n: int) -> bytes:
    out = b""
    while n > 0x7F:
        out, n = out + bytes([n & 0x7F | 0x80]), n >> 7
    return out + bytes([n])


def field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    value = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(value)) + value


def value_info(name: str, dtype: int, shape: tuple[int | str, ...] | None) -> bytes:
    dims = b"".join(field(1, field(1 if isinstance(n, int) else 2, n)) for n in shape or ())
    kind = field(1, dtype) + (b"" if shape is None else field(2, dims))
    return field(1, name) + field(2, field(1, kind))


def tensor(name: str, location: str | None = None, raw: bytes = b"") -> bytes:
    """Return a TensorProto; `location` is the file that holds its values."""
    body = field(1, 3) + field(2, FLOAT) + field(8, name) + (field(9, raw) if raw else b"")
    if location is not None:
        body += field(13, field(1, "location") + field(2, location)) + field(14, EXTERNAL)
    return body


def node(op: str, domain: str = "", attribute: bytes | None = None) -> bytes:
    body = field(1, "x") + field(2, "y") + field(4, op) + (field(7, domain) if domain else b"")
    return body + (b"" if attribute is None else field(5, attribute))


def graph(inputs: bytes = b"", nodes: tuple[bytes, ...] = (), tensors: tuple[bytes, ...] = ()):
    body = b"".join(field(1, n) for n in nodes) + field(2, "g")
    return body + b"".join(field(5, t) for t in tensors) + inputs


def model(inside: bytes, ir: int = 9, opset: int = 19, more: bytes = b"") -> bytes:
    return field(1, ir) + field(8, field(1, "") + field(2, opset)) + field(7, inside) + more


def interface(*, inputs: dict, outputs: dict) -> bytes:
    """Return inputs and outputs by name as (type, shape), as fields of a graph."""
    return b"".join(field(11, value_info(k, *v)) for k, v in inputs.items()) + b"".join(
        field(12, value_info(k, *v)) for k, v in outputs.items()
    )


DETECTOR = {
    "inputs": {"images": (FLOAT, (1, 3, 64, 64)), "txt_feats": (FLOAT, (1, "n", 512))},
    "outputs": {"boxes": (FLOAT, (1, 3, 4)), "scores": (FLOAT, (1, 3, "n"))},
}


def detector(nodes=(), tensors=(), ir=9, opset=19, more=b"", **changes) -> bytes:
    """Return a detector's file for 64 × 64 images and texts of 512, but for `inputs`, `outputs`."""
    ends = interface(**{**DETECTOR, **changes})
    nodes = nodes or (node("Identity"),)
    return model(graph(ends, tuple(nodes), tuple(tensors)), ir, opset, more)
