"""What an ONNX file declares, read without onnxruntime, which opens files that a model names.

Protocol buffers' wire format, and of ONNX's messages the few fields that are looked at. Field
numbers: onnx.proto3 of ONNX 1.20 (github.com/onnx/onnx, onnx/onnx.proto3).
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from edge.host.files import open_regular

MAX_DEPTH = 40
MAX_FIELDS = 2_000_000
"""Far more than a model has whose weights are stored as bytes."""

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5

_PARTS = {
    "model": {7: "graph", 8: "opset", 20: "training", 25: "function"},
    "graph": {1: "node", 5: "tensor", 11: "input", 12: "output", 15: "sparse"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}
"""By message: the fields that are messages to look into."""


class NotOnnx(ValueError):
    """The bytes are no ONNX model; says why."""


@dataclass
class Value:
    """An input or output of the model.

    Attributes:
        dtype: number of its type (TensorProto.DataType): 1 float32, 7 int64; 0 unknown.
        shape: None for a free size; None altogether where no shape is declared.
    """

    name: str = ""
    dtype: int = 0
    shape: tuple[int | None, ...] | None = None


@dataclass
class OnnxFile:
    """What a model declares.

    Attributes:
        opsets: version by domain, `""` for ONNX's own operators.
        domains: of the operators that are used, also in subgraphs.
        functions: domains of the functions that the model brings along.
        external: files that it names for its weights.
        inputs: without those that are initializers.
    """

    ir: int = 0
    opsets: dict[str, int] = field(default_factory=dict)
    domains: set[str] = field(default_factory=set)
    functions: set[str] = field(default_factory=set)
    external: list[str] = field(default_factory=list)
    inputs: list[Value] = field(default_factory=list)
    outputs: list[Value] = field(default_factory=list)
    graphs: int = 0


def read_onnx(path: Path) -> OnnxFile:
    """What the model in a file declares.

    Raises:
        NotOnnx: it is not a whole model.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        try:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise NotOnnx("it is empty") from None
        with content:
            return parse_onnx(content)


def parse_onnx(content: bytes | mmap.mmap) -> OnnxFile:
    """See `read_onnx`."""
    reader = _Reader(content)
    reader.message("model", 0, len(content), 0)
    model = reader.found
    if model.graphs != 1 or not model.ir:
        raise NotOnnx("it has no graph" if model.graphs == 0 else "its header is not ONNX's")
    names = reader.initializers
    model.inputs = [value for value in model.inputs if value.name not in names]
    return model


class _Reader:
    """Walks a model once, and keeps what is asked about."""

    def __init__(self, content: bytes | mmap.mmap) -> None:
        self.found = OnnxFile()
        self.initializers: set[str] = set()
        self._content = content
        self._fields = 0

    def message(self, kind: str, begin: int, end: int, depth: int) -> None:
        """Look into one message and those in it."""
        if depth > MAX_DEPTH:
            raise NotOnnx(f"its parts are nested more than {MAX_DEPTH} deep")
        parts = _PARTS[kind]
        domain = ""
        for number, wire, value, stop in self._in(begin, end):
            if number in parts and wire == _BYTES:
                self._part(kind, parts[number], value, stop, depth)
            elif kind == "model" and number == 1 and wire == _VARINT:
                self.found.ir = value
            elif (kind, number) in (("node", 7), ("function", 10)) and wire == _BYTES:
                domain = self._text(value, stop)
        if kind == "node":
            self.found.domains.add(domain)
        elif kind == "function":
            self.found.functions.add(domain)

    def _part(self, kind: str, part: str, begin: int, end: int, depth: int) -> None:
        top = depth == 1
        if part == "tensor":
            name = self._tensor(begin, end)
            if kind == "graph" and top:
                self.initializers.add(name)
        elif part == "opset":
            self._opset(begin, end)
        elif part in ("input", "output"):
            if top:
                values = self.found.inputs if part == "input" else self.found.outputs
                values.append(self._value(begin, end))
        else:
            self.found.graphs += kind == "model" and part == "graph"
            self.message(part, begin, end, depth + 1)

    def _opset(self, begin: int, end: int) -> None:
        domain, version = "", 0
        for number, wire, value, stop in self._in(begin, end):
            if (number, wire) == (1, _BYTES):
                domain = self._text(value, stop)
            elif (number, wire) == (2, _VARINT):
                version = value
        self.found.opsets[domain] = version

    def _tensor(self, begin: int, end: int) -> str:
        """Note where it keeps its values if that is elsewhere; its name."""
        name, place, outside = "", "", False
        for number, wire, value, stop in self._in(begin, end):
            if (number, wire) == (8, _BYTES):
                name = self._text(value, stop)
            elif (number, wire) == (14, _VARINT):
                outside |= value != 0
            elif (number, wire) == (13, _BYTES):
                outside = True
                pair = {n: self._text(a, b) for n, w, a, b in self._in(value, stop) if w == _BYTES}
                place = pair.get(2, "") if pair.get(1) == "location" else place
        if outside:
            self.found.external.append(place)
        return name

    def _value(self, begin: int, end: int) -> Value:
        made = Value()
        for number, wire, value, stop in self._in(begin, end):
            if (number, wire) == (1, _BYTES):
                made.name = self._text(value, stop)
            elif (number, wire) == (2, _BYTES):
                for kind, w, a, b in self._in(value, stop):
                    if (kind, w) == (1, _BYTES):
                        self._tensor_type(made, a, b)
        return made

    def _tensor_type(self, made: Value, begin: int, end: int) -> None:
        for number, wire, value, stop in self._in(begin, end):
            if (number, wire) == (1, _VARINT):
                made.dtype = value
            elif (number, wire) == (2, _BYTES):
                made.shape = tuple(
                    next((v for n, w, v, _ in self._in(a, b) if (n, w) == (1, _VARINT)), None)
                    for k, wire_, a, b in self._in(value, stop)
                    if (k, wire_) == (1, _BYTES)
                )

    def _in(self, begin: int, end: int) -> Iterator[tuple[int, int, int, int]]:
        """(field number, wire type, value or first byte, one behind the last byte), in order."""
        at = begin
        while at < end:
            self._fields += 1
            if self._fields > MAX_FIELDS:
                raise NotOnnx(f"it has more than {MAX_FIELDS} fields")
            tag, at = self._varint(at, end)
            number, wire = tag >> 3, tag & 7
            if wire == _VARINT:
                value, at = self._varint(at, end)
                yield number, wire, value, at
                continue
            if wire == _BYTES:
                size, at = self._varint(at, end)
            elif wire in (_FIXED64, _FIXED32):
                size = 8 if wire == _FIXED64 else 4
            else:
                raise NotOnnx(f"byte {at} is not protocol buffers")
            if number == 0 or size > end - at:
                raise NotOnnx(f"it ends within a field, at byte {at}: truncated or damaged")
            yield number, wire, at, at + size
            at += size

    def _varint(self, at: int, end: int) -> tuple[int, int]:
        value = 0
        for shift in range(0, 70, 7):
            if at >= end:
                break
            byte = self._content[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & (1 << 64) - 1, at
        raise NotOnnx(f"it ends within a number, at byte {at}: truncated or damaged")

    def _text(self, begin: int, end: int) -> str:
        return self._content[begin : min(end, begin + 4096)].decode("utf-8", "replace")
