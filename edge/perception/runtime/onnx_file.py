"""Checks a model's ONNX file before a session opens it: its format, inputs and outputs.

The file is parsed here for two reasons. onnxruntime opens other files that a model names, before
anyone can check them. The package onnx needs as much memory as the file has bytes, and 73 times
that for a file of empty parts. Field numbers are those of onnx.proto3 in ONNX 1.20
(github.com/onnx/onnx, onnx/onnx.proto3).
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from edge.host.files import open_regular
from edge.perception.runtime.card_types import (
    MARK_FIELDS,
    MAX_MARKS,
    OTHERS_FIELDS,
    DetectCard,
    FileCard,
    GroundCard,
    MarksCard,
    MaskDecoderCard,
    MaskEncoderCard,
    TextCard,
    TranslateCard,
)
from edge.perception.runtime.model_file import ModelError

# Newest versions that the onnxruntime of every supported Python and JetPack loads.
MAX_IR = 10
MAX_OPSET = 20
KNOWN_DOMAINS = {"", "ai.onnx", "ai.onnx.ml", "com.microsoft"}
"""Domains of the operators that onnxruntime has."""
MAX_DEPTH = 40
"""Largest nesting of parsed messages."""
MAX_FIELDS = 1_000_000
"""Far more fields than a model has whose weights are stored as bytes."""
MAX_PARTS = 200_000
"""Limit of parsed messages (parts); each takes some 500 bytes of memory."""

PROMPTS = {"point_coords", "point_labels", "mask_input", "has_mask_input", "orig_im_size"}
"""Inputs of a mask decoder that are not features of the image."""
MASK_OUTPUTS = ("low_res_masks", "masks")
"""Outputs of a mask decoder that hold the masks, in order of preference.

`masks` has the size of the image, so it is larger."""

FLOAT, INT64 = 1, 7  # numbers of tensor types (TensorProto.DataType)
_TYPES = {FLOAT: "float32", INT64: "int64", 10: "float16", 11: "float64", 6: "int32", 2: "uint8"}
_ANY = -1  # in an expected shape: any size, free or not
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # wire types of protocol buffers
_LONGEST_TEXT = 4096  # a text is cut off after this number of bytes

Tree = dict[str, list[Any]]
"""A parsed message: by field name, the values of the field, in order: numbers, texts, or messages.
"""
Shape = tuple["int | None", ...]
"""Sizes of a tensor; None: a free size, which each run of the network may choose."""

_FIELDS: dict[str, dict[int, str]] = {
    "model": {1: "ir", 7: "graph", 8: "opset", 20: "training", 25: "function"},
    "opset": {1: "domain", 2: "version"},
    "graph": {1: "node", 5: "tensor", 11: "input", 12: "output", 15: "sparse"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 10: "domain", 11: "attribute"},
    "node": {5: "attribute", 7: "domain"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {8: "name", 13: "external", 14: "location"},
    "external": {1: "key", 2: "value"},
    "input": {1: "name", 2: "type"},
    "output": {1: "name", 2: "type"},
    "type": {1: "tensor_type"},
    "tensor_type": {1: "dtype", 2: "shape"},
    "shape": {1: "dim"},
    "dim": {1: "size"},
}
"""Fields to parse: for each message its field numbers → our names of the fields.

A field that is a message has its own entry, under the same name."""
_NUMBERS = {"ir", "version", "location", "dtype", "size"}  # fields that hold a number


class NotOnnxError(ValueError):
    """The bytes are no ONNX model, for the reason in its text."""


class Value(NamedTuple):
    """An input or output of the model.

    Attributes:
        dtype: number of the tensor type (TensorProto.DataType): 1 float32, 7 int64; 0 unknown.
        shape: sizes, None for a free size. The entire shape is None if none is declared.
    """

    name: str
    dtype: int
    shape: Shape | None


class OnnxFile(NamedTuple):
    """The declarations of a model.

    Attributes:
        opset: version of ONNX's own operators.
        unknown_domains: domains of operators that neither onnxruntime nor the model itself defines,
            also in subgraphs.
        external: other files that hold weights, as the model names them.
        inputs: inputs without initializers.
    """

    ir: int
    opset: int
    unknown_domains: list[str]
    external: list[str]
    inputs: list[Value]
    outputs: list[Value]


def check_file(path: Path, card: FileCard) -> None:
    """Check that the file is an ONNX model with the card's inputs and outputs.

    Raises:
        ModelError: the file is not such a model, or no session should open it.
    """
    model = _read(path)
    check_format(path, model)
    check_interface(path, model, card)


def check_network(path: Path, is_covered: Callable[[str], bool]) -> None:
    """Check that the file is an ONNX model that a session may open.

    Args:
        path: path of the file.
        is_covered: called with the name of another file with weights, relative to the folder;
            returns True if a hash covers that file.

    Raises:
        ModelError: the file is not such a model.
    """
    model = _read(path)
    uncovered = [name for name in model.external if not is_covered(name)]
    check_format(path, model._replace(external=uncovered))


def _read(path: Path) -> OnnxFile:
    """Read the declarations of a model; raise ModelError with what to do."""
    try:
        return read_onnx(path)
    except NotOnnxError as error:
        raise ModelError(
            f"{path}: not an ONNX model: {error}; pull or export the model again"
        ) from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None


def check_format(path: Path, model: OnnxFile) -> None:
    """Raise ModelError for weights in other files, and for unsupported versions or operators."""
    if model.external:
        where = model.external[0]
        outside = where.startswith(("/", "\\")) or ".." in Path(where.replace("\\", "/")).parts
        what = "outside its folder" if outside else "that no hash covers"
        raise ModelError(
            f"{path}: keeps weights in another file, {where!r}, {what}; save the model as one file"
        )
    if model.ir > MAX_IR:
        raise ModelError(
            f"{path}: ONNX IR version {model.ir}, at most {MAX_IR} can be read: export the model "
            "again"
        )
    if not 1 <= model.opset <= MAX_OPSET:
        raise ModelError(
            f"{path}: ONNX opset {model.opset}, must be 1 to {MAX_OPSET}: export the model again"
        )
    if model.unknown_domains:
        raise ModelError(
            f"{path}: has operators of the domain {model.unknown_domains[0]!r}, which onnxruntime "
            "lacks: export the model again"
        )


def check_interface(path: Path, model: OnnxFile, card: FileCard) -> None:
    """Raise ModelError unless inputs and outputs are those of the card's task."""
    if isinstance(card, (MaskEncoderCard, MaskDecoderCard, GroundCard)):
        return _check_segmenter(path, model, card)
    inputs, outputs = expected_interface(card)
    fits = [len(model.inputs) == len(inputs), len(model.outputs) == len(outputs)]
    pairs = zip(sorted(model.inputs), sorted(inputs), strict=False)
    fits += [_fits(value, spec) for value, spec in pairs]
    # Exporters often leave outputs' sizes free; sizes that are given must fit.
    pairs = zip(model.outputs, outputs, strict=False)
    fits += [_fits(value, spec, allow_free=True) for value, spec in pairs]
    if not all(fits):
        raise ModelError(
            f"{path}: inputs {_list(model.inputs)}, outputs {_list(model.outputs)}; "
            f"model {card.name} must have inputs {_list(inputs)}, "
            f"outputs {_list(outputs)}: export the model again"
        )


def _check_segmenter(
    path: Path, model: OnnxFile, card: MaskEncoderCard | MaskDecoderCard | GroundCard
) -> None:
    """Check a segmenter's file as `check_interface` does.

    Exporters agree only in the names of a mask decoder's prompts, so all else is left open.
    """
    outputs, inputs = {v.name: v for v in model.outputs}, {v.name: v for v in model.inputs}
    if isinstance(card, (MaskEncoderCard, GroundCard)):
        image = (_ANY, 3, card.input.height, card.input.width)
        fits = len(inputs) == 1 and all(_fits(v, Value(v.name, FLOAT, image)) for v in model.inputs)
        expected = f"one input {_list([Value('image', FLOAT, image)])}"
    else:
        coords = Value("point_coords", FLOAT, (_ANY, _ANY, 2))
        masks = [outputs[name] for name in MASK_OUTPUTS if name in outputs]
        fits = "point_coords" in inputs and _fits(inputs["point_coords"], coords)
        fits = fits and "point_labels" in inputs and bool(set(inputs) - PROMPTS)
        fits = fits and bool(masks) and "iou_predictions" in outputs
        expected = (
            f"features, {_list([coords])[1:-1]} and point_labels as inputs, "
            f"{' or '.join(MASK_OUTPUTS)} and iou_predictions as outputs"
        )
    if not fits:
        raise ModelError(
            f"{path}: inputs {_list(model.inputs)}, outputs {_list(model.outputs)}; "
            f"model {card.name} must have {expected}: export the model again"
        )


def expected_interface(card: FileCard) -> tuple[list[Value], list[Value]]:
    """Return the inputs, in any order, and the outputs that a model of the card must have.

    In a shape, None stands for a size that must be free, and -1 for any size.
    """
    if isinstance(card, TextCard):
        length = card.tokenizer.context if card.tokenizer.kind == "clip" else _ANY
        tokens = Value("tokens", INT64, (None, length))
        return [tokens], [Value("embeddings", FLOAT, (_ANY, card.dim))]
    if isinstance(card, TranslateCard):
        past, across = (_ANY, None, _ANY, None, _ANY), (_ANY, 1, _ANY, None, _ANY)
        inputs = [Value("source", INT64, (1, None)), Value("target", INT64, (None, None))]
        inputs += [Value("past", FLOAT, past), Value("across_in", FLOAT, across)]
        outputs = [Value("across", FLOAT, across), Value("logits", FLOAT, (None, None, _ANY))]
        return inputs, [*outputs, Value("present", FLOAT, past)]
    image = (1, 3, card.input.height, card.input.width)
    if isinstance(card, DetectCard):
        texts = Value("txt_feats", FLOAT, (1, None, card.text_dim))
        boxes = Value("boxes", FLOAT, (1, _ANY, 4))
        scores = Value("scores", FLOAT, (1, _ANY, _ANY))
        return [Value("images", FLOAT, image), texts], [boxes, scores]
    if isinstance(card, MarksCard):
        text = Value("txt_feats", FLOAT, (1, card.text_dim))
        marks = Value("marks", FLOAT, (1, MAX_MARKS, MARK_FIELDS))
        others = Value("others", FLOAT, (1, OTHERS_FIELDS))
        directions = Value("directions", FLOAT, (1, MAX_MARKS + 1))
        return (
            [Value("images", FLOAT, image), text, marks, others],
            [directions, Value("scene", FLOAT, (1, 1))],
        )
    return [Value("pixels", FLOAT, image)], [Value("embeddings", FLOAT, (_ANY, card.dim))]


def _fits(value: Value, spec: Value, allow_free: bool = False) -> bool:
    """Return True if an input or output of a model has the name, type and shape of `spec`.

    Args:
        value: what the model declares.
        spec: what is expected; see `expected_interface`.
        allow_free: True: a free size, or no declared shape, fits any expected one.
    """
    if (value.name, value.dtype) != (spec.name, spec.dtype):
        return False
    if value.shape is None:
        return allow_free
    # A wanted size fits if it is `_ANY` or equal (None: both are free), or may be left free.
    return len(value.shape) == len(spec.shape) and all(
        want in (_ANY, size) or (allow_free and size is None)
        for want, size in zip(spec.shape, value.shape, strict=True)
    )


def _list(values: list[Value]) -> str:
    """Return inputs or outputs as text for a message: names, types and shapes."""

    def size(n: int | None) -> str:
        return {None: "n", _ANY: "?"}.get(n, str(n))

    shown = (
        f"{v.name} {_TYPES.get(v.dtype, f'type {v.dtype}')} "
        f"[{', '.join(map(size, v.shape)) if v.shape is not None else '…'}]"
        for v in values[:8]
    )
    return "(" + ", ".join(shown) + ")"


def read_onnx(path: Path) -> OnnxFile:
    """Read the declarations of the model in a file.

    Raises:
        NotOnnxError: the file is not a complete model.
        OSError: the file cannot be read.
    """
    with open_regular(path) as file:
        try:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise NotOnnxError("it is empty") from None
        with content:
            return parse_onnx(content)


def parse_onnx(content: bytes | mmap.mmap) -> OnnxFile:
    """Parse the bytes of a model; see `read_onnx`."""
    model = _Reader(content).message("model", 0, len(content), 0)
    graphs, ir = model.get("graph", []), _last(model, "ir", 0)
    if len(graphs) != 1 or not ir:
        raise NotOnnxError("the header is not that of ONNX" if graphs else "there is no graph")
    graph = graphs[0]
    opsets = {_last(o, "domain", ""): _last(o, "version", 0) for o in model.get("opset", [])}
    defined = {_last(function, "domain", "") for function in model.get("function", [])}
    used = {_last(node, "domain", "") for node in _all(model, "node")}
    outside = [tensor for tensor in _all(model, "tensor") if _is_outside(tensor)]
    initializers = {_last(tensor, "name", "") for tensor in graph.get("tensor", [])}
    inputs = [_value(value) for value in graph.get("input", [])]
    return OnnxFile(
        ir=ir,
        opset=max(opsets.get(domain, 0) for domain in ("", "ai.onnx")),
        unknown_domains=sorted(used - KNOWN_DOMAINS - defined),
        external=[_location(tensor) for tensor in outside],
        inputs=[value for value in inputs if value.name not in initializers],
        outputs=[_value(value) for value in graph.get("output", [])],
    )


def _last(message: Tree, name: str, default: Any) -> Any:
    """Return a field's value; if it occurs more than once, the last one counts."""
    return message.get(name, [default])[-1]


def _all(message: Tree, name: str) -> Iterator[Tree]:
    """Yield every message in a field of this name, at any depth."""
    for field, values in message.items():
        if field in _FIELDS:
            for part in values:
                if field == name:
                    yield part
                yield from _all(part, name)


def _is_outside(tensor: Tree) -> bool:
    """Return True if the tensor's values are in another file, by either of its two fields."""
    return "external" in tensor or any(tensor.get("location", []))


def _location(tensor: Tree) -> str:
    """Return the name of the other file with the tensor's values."""
    pairs = {_last(e, "key", ""): _last(e, "value", "") for e in tensor.get("external", [])}
    return pairs.get("location", "")


def _value(info: Tree) -> Value:
    """Return an input or output from its message."""
    kind = _last(_last(info, "type", {}), "tensor_type", {})
    shape = _last(kind, "shape", None)
    sizes = None if shape is None else tuple(_last(d, "size", None) for d in shape.get("dim", []))
    return Value(_last(info, "name", ""), _last(kind, "dtype", 0), sizes)


class _Reader:
    """A parser of the protocol buffers' wire format that keeps only the fields in `_FIELDS`."""

    def __init__(self, content: bytes | mmap.mmap) -> None:
        self._content = content
        self._fields = self._parts = 0  # numbers of fields and messages so far

    def message(self, kind: str, begin: int, end: int, depth: int) -> Tree:
        """Parse one message and the messages in it that are in `_FIELDS`."""
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise NotOnnxError(f"there are more than {MAX_PARTS} parts")
        if depth > MAX_DEPTH:
            raise NotOnnxError(f"parts are nested more than {MAX_DEPTH} deep")
        found: Tree = {}
        for number, wire, value, stop in self._fields_in(begin, end):
            name = _FIELDS[kind].get(number, "")
            if not name or wire != (_VARINT if name in _NUMBERS else _BYTES):
                continue
            if name in _FIELDS:
                value = self.message(name, value, stop, depth + 1)
            elif wire == _BYTES:
                value = self._content[value : min(stop, value + _LONGEST_TEXT)].decode(
                    "utf-8", "replace"
                )
            found.setdefault(name, []).append(value)
        return found

    def _fields_in(self, begin: int, end: int) -> Iterator[tuple[int, int, int, int]]:
        """Yield (field number, wire type, value, end) of each field in order.

        A number's value is the number. For other fields it is the position of the first byte.
        """
        at = begin
        while at < end:
            self._fields += 1
            if self._fields > MAX_FIELDS:
                raise NotOnnxError(f"there are more than {MAX_FIELDS} fields")
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
                raise NotOnnxError(f"byte {at} does not fit the format (protocol buffers)")
            if number == 0 or size > end - at:
                raise NotOnnxError(f"ends within a field, at byte {at}: truncated or damaged")
            yield number, wire, at, at + size
            at += size

    def _varint(self, at: int, end: int) -> tuple[int, int]:
        """Return (number, position after it): seven bits a byte, the lowest first.

        The top bit of a byte is set if another byte follows. There are at most ten bytes.
        """
        value = 0
        for shift in range(0, 70, 7):
            if at >= end:
                break
            byte = self._content[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & ((1 << 64) - 1), at
        raise NotOnnxError(f"ends within a number, at byte {at}: truncated or damaged")
