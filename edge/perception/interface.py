"""What a model's file must be before a session is made of it: its format, inputs and outputs."""

from __future__ import annotations

from pathlib import Path

from edge.perception.card_types import DetectCard, FileCard, TextCard
from edge.perception.model_file import ModelError
from edge.perception.onnx_file import NotOnnx, OnnxFile, Value, read_onnx

MAX_IR = 10
MAX_OPSET = 20
"""What the onnxruntime of every supported Python and JetPack loads."""
KNOWN_DOMAINS = {"", "ai.onnx", "ai.onnx.ml", "com.microsoft"}

FLOAT, INT64 = 1, 7
_TYPES = {1: "float32", 7: "int64", 10: "float16", 11: "float64", 6: "int32", 2: "uint8"}
_ANY = -1

Shape = tuple[int | None, ...]


def check_file(path: Path, card: FileCard) -> None:
    """Raise ModelError unless the file is an ONNX model that a session can be made of, and has
    the card's inputs and outputs.
    """
    try:
        model = read_onnx(path)
    except NotOnnx as error:
        raise ModelError(f"{path}: not an ONNX model: {error}; get or make it again") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
    check_format(path, model)
    check_interface(path, model, card)


def check_format(path: Path, model: OnnxFile) -> None:
    """Raise ModelError for weights in other files, and for versions or operators unknown here."""
    if model.external:
        where = model.external[0]
        outside = where.startswith(("/", "\\")) or ".." in Path(where.replace("\\", "/")).parts
        what = "outside its folder" if outside else "that no hash covers"
        raise ModelError(
            f"{path}: keeps weights in another file, {where!r}, {what}; save it as one file"
        )
    if model.ir > MAX_IR:
        raise ModelError(f"{path}: ONNX IR {model.ir}, at most {MAX_IR}: export it again")
    opset = max(model.opsets.get(domain, 0) for domain in ("", "ai.onnx"))
    if not 1 <= opset <= MAX_OPSET:
        raise ModelError(f"{path}: ONNX opset {opset}, must be 1 … {MAX_OPSET}: export it again")
    if strange := sorted(model.domains - KNOWN_DOMAINS - model.functions):
        raise ModelError(
            f"{path}: operators of {strange[0]!r}, which onnxruntime lacks: export it again"
        )


def check_interface(path: Path, model: OnnxFile, card: FileCard) -> None:
    """Raise ModelError unless inputs and outputs are what the card's task asks for."""
    inputs, outputs = wanted(card)
    found = {value.name: value for value in model.inputs}
    names = [value.name for value in model.outputs]
    fits = found.keys() == inputs.keys() and names == list(outputs)
    fits = fits and all(_fits(found[name], *spec) for name, spec in inputs.items())
    fits = fits and all(
        value.dtype == outputs[value.name][0] and _rank_fits(value, outputs[value.name][1])
        for value in model.outputs
    )
    if not fits:
        raise ModelError(
            f"{path}: inputs {_list(model.inputs)}, outputs {_list(model.outputs)}; "
            f"model {card.name} must have inputs {_list(_values(inputs))}, "
            f"outputs {_list(_values(outputs))}: export it again"
        )


def wanted(card: FileCard) -> tuple[dict[str, tuple[int, Shape]], dict[str, tuple[int, Shape]]]:
    """(inputs, outputs) by name as (type, shape); a size that is None must be free."""
    if isinstance(card, TextCard):
        length = card.tokenizer.context if card.tokenizer.kind == "clip" else _ANY
        return {"tokens": (INT64, (None, length))}, {"embeddings": (FLOAT, (_ANY, card.dim))}
    image = (FLOAT, (1, 3, card.input.height, card.input.width))
    if isinstance(card, DetectCard):
        inputs = {"images": image, "txt_feats": (FLOAT, (1, None, card.text_dim))}
        return inputs, {"boxes": (FLOAT, (1, _ANY, 4)), "scores": (FLOAT, (1, _ANY, _ANY))}
    return {"pixels": image}, {"embeddings": (FLOAT, (_ANY, card.dim))}


def _fits(value: Value, dtype: int, shape: Shape) -> bool:
    return (
        value.dtype == dtype
        and value.shape is not None
        and len(value.shape) == len(shape)
        and all(want in (_ANY, size) for want, size in zip(shape, value.shape, strict=True))
    )


def _rank_fits(value: Value, shape: Shape) -> bool:
    """Exporters often leave outputs' sizes open; those that are told must be right."""
    return value.shape is None or (
        len(value.shape) == len(shape)
        and all(
            size is None or want in (_ANY, size)
            for want, size in zip(shape, value.shape, strict=True)
        )
    )


def _values(specs: dict[str, tuple[int, Shape]]) -> list[Value]:
    return [Value(name, dtype, shape) for name, (dtype, shape) in specs.items()]


def _list(values: list[Value]) -> str:
    def size(n: int | None) -> str:
        return {None: "n", _ANY: "?"}.get(n, str(n))

    shown = (
        f"{v.name} {_TYPES.get(v.dtype, f'type {v.dtype}')} "
        f"[{', '.join(map(size, v.shape)) if v.shape is not None else '…'}]"
        for v in values[:8]
    )
    return "(" + ", ".join(shown) + ")"
